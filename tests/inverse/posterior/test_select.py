"""The posterior of a reconstruction, from what a user has in hand."""

from dataclasses import replace

import numpy as np
import pytest

from tactorch.errors import ConfigError
from tactorch.inverse import (
    NuisancePrior,
    Point,
    Settings,
    ShiftedPrior,
    compute_posterior,
    invert_map,
    make_objective,
)
from tactorch.inverse.invert import solution
from tactorch.inverse.posterior import (
    LaplacePosterior,
    LowRankPosterior,
    VariationalPosterior,
    select,
    variational_posterior,
)
from tactorch.mesh import box_mesh
from tactorch.phantoms import make_phantom
from tactorch.recording import Recording
from tactorch.simulation import PressPlan, simulate


@pytest.fixture(scope="module")
def noisy() -> Recording:
    ball = make_phantom("cube_sphere", radius=0.3)
    plan = PressPlan(("z+",), (0.01,))
    return simulate(ball, plan, mesh=box_mesh(10.0, 2, tets_per_cell=5), samples=2, snr_db=40.0)


def test_it_is_that_of_the_point_where_the_inversion_ended(noisy: Recording) -> None:
    found = invert_map(noisy)
    objective = make_objective(noisy, Settings())
    point = objective.at(objective.start(found.youngs))
    expected = variational_posterior(point, found.history[-1]["weight"])
    actual = compute_posterior(noisy, found)
    assert isinstance(actual, VariationalPosterior)
    np.testing.assert_allclose(actual.deviation(), expected.deviation(), rtol=1e-6)
    low, high = actual.interval(0.9)
    assert ((low < found.youngs) & (found.youngs < high)).all()


def test_other_priors_and_larger_meshes_have_their_own(
    noisy: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = Settings(regularization="smoothness")
    found = invert_map(noisy, settings)
    assert type(compute_posterior(noisy, found, settings)) is LaplacePosterior
    monkeypatch.setattr(select, "MAX_DENSE", 10)
    told: list[tuple[int, float]] = []

    def at(point: Point, weight: float) -> LaplacePosterior:
        told.append((point.objective.size, weight))
        return LaplacePosterior.at(point, weight)

    monkeypatch.setattr(LowRankPosterior, "at", at)
    select.posterior_at(solution(noisy, found, settings), 2.0)
    assert told == [(noisy.mesh.n_tets, 2.0)]


def test_nuisance_parameters_stay_where_they_were_found(noisy: Recording) -> None:
    settings = Settings(nuisance=NuisancePrior(poisson=0.02, rest_scale=0.1))
    found = invert_map(noisy, settings)
    point = solution(noisy, found, settings)
    assert point.evaluation.nuisance.poisson == pytest.approx(found.nuisance["poisson"].value[0])
    np.testing.assert_allclose(
        point.evaluation.nuisance.rest_scale, found.nuisance["rest_scale"].value
    )
    assert point.evaluation.misfit_mm2 == pytest.approx(found.misfit_mm2, rel=1e-6)
    with pytest.raises(ConfigError, match="give those of the inversion"):
        solution(noisy, found, Settings())
    with pytest.raises(ConfigError, match="the result has 3 moduli"):
        solution(noisy, replace(found, youngs=np.ones(3)), settings)


def test_prior_with_a_mean_has_the_laplace_posterior_around_it(noisy: Recording) -> None:
    """Total variation of the distance from a mean map is not total variation of the map."""
    mean = np.full(noisy.mesh.n_tets, 0.2)
    objective = make_objective(noisy, Settings(regularization=ShiftedPrior(mean_mpa=mean)))
    uniform = objective.at(objective.start(mean))
    actual, expected = select.posterior_at(uniform, 1.0), LaplacePosterior.at(uniform, 1.0)
    assert type(actual) is LaplacePosterior
    np.testing.assert_array_equal(actual.deviation(), expected.deviation())
    with pytest.raises(ConfigError, match="total variation without a mean"):
        variational_posterior(uniform, 1.0)
