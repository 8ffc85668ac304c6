"""Newton by conjugate gradients: products, second derivatives, and the map of Gauss-Newton."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tactorch.errors import ConfigError
from tactorch.inverse import (
    OPTIMIZERS,
    GaussNewton,
    InverseProblem,
    NewtonCG,
    NuisancePrior,
    Objective,
    Settings,
    TotalVariation,
    invert_map,
    make_objective,
)
from tactorch.inverse.fit.optimizers.damped import PriorSolver
from tactorch.inverse.fit.optimizers.newton_cg import data_trace
from tactorch.inverse.fit.optimizers.schedule import RegularizationSchedule
from tactorch.recording import Recording

Make = Callable[..., Recording]


@pytest.fixture(scope="module")
def noisy(make_cube: Make) -> Recording:
    return make_cube(snr_db=30.0, seed=1)


@pytest.fixture
def objective(recording: Recording) -> Objective:
    return make_objective(recording, Settings())


def correlation(first: np.ndarray, second: np.ndarray) -> float:
    return float(np.corrcoef(first, second)[0, 1])


@pytest.mark.parametrize(
    "prior", ["total_variation", pytest.param("smoothness", marks=pytest.mark.slow)]
)
def test_the_map_is_that_of_gauss_newton(noisy: Recording, prior: str) -> None:
    maps = [
        invert_map(
            noisy, Settings(optimizer=name, regularization={"name": prior, "weight": 3.0})
        ).youngs
        for name in ("gauss_newton", "newton_cg")
    ]
    assert correlation(*maps) > 0.9999
    np.testing.assert_allclose(maps[0], maps[1], rtol=0.02)


@pytest.mark.slow
def test_with_a_cooled_weight_too(noisy: Recording) -> None:
    ours, theirs = (invert_map(noisy, Settings(optimizer=o)) for o in (NewtonCG(), GaussNewton()))
    assert correlation(ours.youngs, theirs.youngs) > 0.99
    assert ours.stop_reason == theirs.stop_reason == "the data are fitted to their noise"


def test_no_sensitivity_matrix_is_formed(noisy: Recording, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any) -> None:
        raise AssertionError("the sensitivity matrix was asked for")

    monkeypatch.setattr("tactorch.fem.linearization.Sensitivity.matrix", refuse)
    found = invert_map(noisy, Settings(optimizer=NewtonCG(max_iterations=3)))
    assert found.misfit_mm2 < 0.1 * found.history[0]["misfit"]


def test_one_set_of_factors_serves_all_iterates(noisy: Recording) -> None:
    """Each press's search takes over the last one's solver instead of analysing another."""
    objective = make_objective(noisy, Settings())
    near = objective.at(objective.start(np.full(noisy.mesh.n_tets, 0.2)))
    gradient = near.data_gradient
    leases = [near.evaluation.search(i).lease for i in range(3)]
    solvers = {id(lease._solver) for lease in leases}
    step = np.full(noisy.mesh.n_tets, 0.01)
    there = objective.at(near.x + step, near, take_over=True)
    assert {id(there.evaluation.search(i).lease._solver) for i in range(3)} == solvers
    assert all(lease._solver is None for lease in leases)
    alone = objective.at(near.x + step)
    np.testing.assert_allclose(
        there.evaluation.residuals, alone.evaluation.residuals, rtol=1e-6, atol=1e-6
    )
    np.testing.assert_allclose(there.data_gradient, alone.data_gradient, rtol=1e-6)
    # What was handed over is made anew where it is wanted again.
    np.testing.assert_allclose(near.evaluation.gradient() * near.youngs, gradient, rtol=1e-9)


@pytest.mark.parametrize(
    ("after", "hessian"),
    [
        (0, "gauss_newton"),
        pytest.param(5, "gauss_newton", marks=pytest.mark.slow),
        pytest.param(2, "true", marks=pytest.mark.slow),
    ],
)
def test_a_resumed_run_ends_with_the_same_map(
    noisy: Recording, tmp_path: Path, after: int, hessian: str
) -> None:
    def stop(record: dict[str, Any], youngs: np.ndarray) -> None:
        if record["iteration"] == after:
            raise KeyboardInterrupt

    settings = Settings(optimizer=NewtonCG(hessian=hessian, max_iterations=after + 3))
    checkpoint = tmp_path / "checkpoint.npz"
    whole = invert_map(noisy, settings)
    first = invert_map(noisy, settings, checkpoint=checkpoint, on_iteration=stop)
    found = invert_map(noisy, settings, resume=checkpoint)
    assert first.iterations == after < whole.iterations == found.iterations
    np.testing.assert_allclose(found.youngs, whole.youngs, rtol=1e-6)


@pytest.mark.parametrize("parameterization", ["log", "scaled"])
def test_true_products_are_differences_of_the_gradient(
    recording: Recording, moduli: np.ndarray, parameterization: str
) -> None:
    objective = make_objective(recording, Settings(parameterization=parameterization))
    x = objective.start(moduli)
    change = np.random.default_rng(0).standard_normal(len(x))
    change *= 1.0 if parameterization == "log" else 0.002
    point = objective.at(x)
    gauss_newton = point.transpose_times(point.jacobian_times(change))
    product = gauss_newton + point.second_order_times(change)
    h = 1e-4
    ahead, behind = (objective.at(x + side * h * change).data_gradient for side in (1, -1))
    difference = (ahead - behind) / (2.0 * h)
    size = np.abs(difference).max()
    np.testing.assert_allclose(product, difference, atol=1e-5 * size)
    assert np.abs(gauss_newton - difference).max() > 1e-2 * size  # there is a second order


def test_true_products_are_symmetric(objective: Objective, moduli: np.ndarray) -> None:
    point = objective.at(objective.start(moduli))
    one, other = np.random.default_rng(1).standard_normal((2, len(moduli)))
    products = (point.second_order_times(change) for change in (other, one))
    first, second = (a @ b for a, b in zip((one, other), products, strict=True))
    assert first == pytest.approx(second, rel=1e-8)


@pytest.mark.slow
def test_the_true_hessian_ends_at_the_same_minimum(make_tiny: Make) -> None:
    noisy = make_tiny(faces=("z+",), snr_db=30.0)
    prior = TotalVariation(weight=3.0)
    maps = [
        invert_map(
            noisy, Settings(NewtonCG(hessian=h, tolerance=1e-6), regularization=prior)
        ).youngs
        for h in ("gauss_newton", "true")
    ]
    np.testing.assert_allclose(maps[0], maps[1], rtol=5e-3)


def test_the_true_hessian_refuses_nuisance_parameters(recording: Recording) -> None:
    settings = Settings(optimizer=NewtonCG(hessian="true"), nuisance=NuisancePrior(poisson=0.02))
    with pytest.raises(ConfigError, match="hessian=true"):
        invert_map(recording, settings)


@pytest.mark.slow
def test_nuisance_parameters_are_estimated(make_cube: Make) -> None:
    wrong = make_cube(snr_db=40.0, seed=1)
    prior, free = TotalVariation(weight=3.0), NuisancePrior(force_scale=0.2)
    ours, theirs = (
        invert_map(wrong, Settings(optimizer=name, regularization=prior, nuisance=free)).nuisance
        for name in ("newton_cg", "gauss_newton")
    )
    assert ours["force_scale"].value == pytest.approx(theirs["force_scale"].value, rel=1e-2)


def test_the_trace_is_estimated(objective: Objective, moduli: np.ndarray) -> None:
    point = objective.at(objective.start(moduli))
    exact = float((point.jacobian**2).sum())
    assert data_trace(point, probes=200) == pytest.approx(exact, rel=0.1)
    assert data_trace(point) == data_trace(point)
    rough = RegularizationSchedule.start(point, {}, trace=data_trace(point))
    assert rough.weight == pytest.approx(RegularizationSchedule.start(point, {}).weight, rel=0.6)


def test_the_preconditioner_holds_what_is_fixed(objective: Objective, moduli: np.ndarray) -> None:
    prior = objective.at(objective.start(moduli)).prior_curvature(2.0)
    rng = np.random.default_rng(2)
    shift, rhs = rng.uniform(0.5, 1.0, len(moduli)), rng.standard_normal(len(moduli))
    fixed = rng.random(len(moduli)) < 0.3
    solver = PriorSolver()
    assert solver.factor(prior, shift, fixed)
    found = solver.solve(rhs)
    assert not found[fixed].any()
    dense = prior.toarray() + np.diag(shift)
    expected = np.linalg.solve(dense[~fixed][:, ~fixed], rhs[~fixed])
    np.testing.assert_allclose(found[~fixed], expected, rtol=1e-9)
    assert not solver.factor(prior, -1e3 * shift, fixed)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"forcing": 0.0}, "forcing=0.0: give a number above 0, below 1"),
        ({"forcing": 1.0}, "forcing=1.0: give a number above 0, below 1"),
        ({"cg_iterations": 0}, "cg_iterations=0"),
        ({"hessian": "bfgs"}, "hessian='bfgs': give gauss_newton or true"),
    ],
)
def test_settings_are_checked(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        OPTIMIZERS.build({"name": "newton_cg", **settings})


def test_a_problem_counts_its_evaluations(noisy: Recording) -> None:
    problem = InverseProblem(noisy)
    youngs = np.full(noisy.mesh.n_tets, 0.2)
    near = problem.evaluate(youngs)
    problem.evaluate(1.01 * youngs, near, take_over=True)
    assert problem.evaluations == 2
