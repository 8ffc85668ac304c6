import numpy as np
import pytest

from tactorch.inverse import PARAMETERIZATIONS, PRIORS, Bounds, InverseProblem, Objective
from tactorch.inverse.fields import ElementField
from tactorch.recording import Recording

WEIGHT = 50.0


def make(recording: Recording, parameterization: str, prior: str) -> Objective:
    return Objective(
        InverseProblem(recording),
        ElementField(
            PARAMETERIZATIONS[parameterization](Bounds(0.01, 2.0)),
            PRIORS.build(prior).on(recording.mesh),
            recording.mesh.n_tets,
        ),
    )


@pytest.mark.parametrize("prior", PRIORS.names())
@pytest.mark.parametrize("parameterization", sorted(PARAMETERIZATIONS.names()))
def test_gradient_is_the_finite_difference_of_the_value(
    recording: Recording, moduli: np.ndarray, parameterization: str, prior: str
) -> None:
    objective = make(recording, parameterization, prior)
    x = objective.elements.parameterization.parameters(moduli)
    point = objective.at(x)
    gradient = point.data_gradient + WEIGHT * point.penalty_gradient
    direction = np.random.default_rng(0).standard_normal(len(x))
    h = 1e-6
    plus, minus = (objective.at(x + s * h * direction).value(WEIGHT) for s in (1, -1))
    assert gradient @ direction == pytest.approx((plus - minus) / (2 * h), rel=1e-5)
    inner = (objective.at(x + s * h * direction).penalty for s in (1, -1))
    expected = (next(inner) - next(inner)) / (2 * h)
    assert point.penalty_gradient @ direction == pytest.approx(expected, rel=1e-6)
    np.testing.assert_allclose(
        point.jacobian.T @ point.evaluation.residuals, point.data_gradient, rtol=1e-7
    )


def test_curvature_of_the_prior_follows_the_chain_rule(
    recording: Recording, moduli: np.ndarray
) -> None:
    """Priors act on log-moduli: x in MPa only rescales rows and columns."""
    log, plain = (make(recording, name, "total_variation") for name in ("log", "identity"))
    inner = log.at(np.log(moduli)).penalty_curvature.toarray()
    outer = plain.at(moduli).penalty_curvature.toarray()
    np.testing.assert_allclose(outer, inner / np.outer(moduli, moduli), rtol=1e-12)


def test_parameters_beyond_the_bounds_are_evaluated_on_them(recording: Recording) -> None:
    objective = make(recording, "log", "none")
    x = np.full(recording.mesh.n_tets, np.log(0.2))
    x[0] = 3.0
    assert objective.at(x).youngs[0] == 2.0
