from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from tactorch.errors import ConfigError, ConvergenceError
from tactorch.inverse import (
    Bounds,
    GaussNewton,
    InverseProblem,
    NuisancePrior,
    Settings,
    best_uniform,
    homogeneous,
    invert_map,
    make_objective,
    monte_carlo,
)
from tactorch.inverse.fit.starts import start_map
from tactorch.phantoms import make_phantom
from tactorch.recording import Recording
from tactorch.simulation import PressPlan, perturb_recording, simulate


@pytest.fixture(scope="module")
def uniform(tiny) -> Recording:
    cube = make_phantom("uniform_cube", youngs_mpa=0.37)
    return simulate(cube, PressPlan(("z+", "x-"), (0.01,)), mesh=tiny)


@pytest.mark.parametrize("first", [0.02, 0.2, 5.0])
def test_best_uniform_finds_the_modulus_of_a_uniform_object(uniform: Recording, first: float):
    found = best_uniform(InverseProblem(uniform), first_mpa=first)
    assert found == pytest.approx(0.37, rel=1e-3)


def test_best_uniform_is_a_minimum_where_no_uniform_map_fits(recording: Recording):
    problem = InverseProblem(recording)
    found = best_uniform(problem)
    chi2 = [
        problem.evaluate(np.full(problem.n_elements, found * factor)).chi2
        for factor in (0.98, 1.0, 1.02)
    ]
    assert chi2[1] < min(chi2[0], chi2[2])


def test_best_uniform_stays_within_the_bounds(uniform: Recording):
    found = best_uniform(InverseProblem(uniform), Bounds(0.5, 2.0))
    assert found == pytest.approx(0.5)


def test_best_uniform_refuses_forces_that_nothing_carries(recording: Recording):
    heavy = [replace(press, forces=1e4 * press.forces) for press in recording.presses]
    problem = InverseProblem(replace(recording, presses=tuple(heavy), check_units=False))
    with pytest.raises(ConvergenceError, match="With no uniform modulus up to 1 MPa"):
        best_uniform(problem, Bounds(0.01, 1.0))


def test_jacobian_times_is_the_jacobian_times(recording: Recording):
    at = InverseProblem(recording).evaluate(np.full(recording.mesh.n_tets, 0.3))
    change = np.random.default_rng(0).normal(size=recording.mesh.n_tets)
    assert np.allclose(at.jacobian_times(change), at.jacobian() @ change, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("presses", [1, 2])
def test_monte_carlo_keeps_the_draw_that_fits_best(uniform: Recording, presses: int):
    """One press leaves cores for draws side by side."""
    problem, m = InverseProblem(uniform.select(range(presses))), uniform.mesh.n_tets

    def draw(rng: np.random.Generator) -> np.ndarray:
        return np.full(m, rng.uniform(0.1, 1.0))

    found = monte_carlo(draw, draws=8, seed=3)(problem, Bounds())
    drawn = [draw(np.random.default_rng([3, i]))[0] for i in range(8)]
    fits = [problem.evaluate(np.full(m, e)).chi2 for e in drawn]
    assert found[0] == drawn[int(np.argmin(fits))]


@pytest.mark.slow
def test_monte_carlo_passes_over_draws_that_collapse(uniform: Recording):
    problem, m = InverseProblem(uniform), uniform.mesh.n_tets
    soft_first = iter([1e-3, 0.4])
    start = monte_carlo(lambda _: np.full(m, next(soft_first)), draws=2)
    assert start(problem, Bounds())[0] == 0.4
    with pytest.raises(ConvergenceError, match="None of 2 random starts"):
        monte_carlo(lambda _: np.full(m, 1e-3), draws=2)(problem, Bounds())
    with pytest.raises(ConfigError, match="draws=0"):
        monte_carlo(lambda _: np.full(m, 1.0), draws=0)


def test_a_start_may_be_a_function_of_the_problem(uniform: Recording):
    settings = Settings(optimizer=GaussNewton(max_iterations=1))
    found = invert_map(uniform, settings, start_mpa=homogeneous, show_progress=False)
    assert found.config["start_mpa"] == "homogeneous"
    assert found.history[0]["chi2"] < 1.0


@pytest.mark.parametrize(
    ("start", "words"),
    [
        (np.ones(3), "shape (3,)"),
        (lambda problem, bounds: np.full(problem.n_elements, 500.0), "outside the bounds"),
    ],
)
def test_starts_that_cannot_be_used_are_refused(
    uniform: Recording, start: Callable | np.ndarray, words: str
):
    with pytest.raises(ConfigError) as caught:
        start_map(start, InverseProblem(uniform), Bounds())
    assert words in str(caught.value)


def test_every_iteration_is_shown_with_its_map(recording: Recording):
    seen: list[tuple[dict, np.ndarray]] = []
    found = invert_map(
        recording,
        Settings(optimizer=GaussNewton(max_iterations=3)),
        show_progress=False,
        on_iteration=lambda record, youngs: seen.append((record, youngs)),
    )
    assert [record["iteration"] for record, _ in seen] == list(range(len(found.history)))
    assert np.array_equal(seen[-1][1], found.youngs)
    assert np.allclose(seen[0][1], 0.2)


def test_what_is_free_beside_the_map_is_fitted_with_the_modulus(uniform: Recording):
    """A shape that is believed a tenth too large would be taken for another modulus."""
    large = perturb_recording(uniform, size=1.1)
    free = Settings(nuisance=NuisancePrior(rest_scale=0.2), model_error="none")
    beside, alone = (
        homogeneous(make_objective(large, settings).problem, Bounds())[0]
        for settings in (free, Settings(model_error="none"))
    )
    assert beside == pytest.approx(0.37, rel=0.01)
    assert alone < 0.2


def test_a_map_on_a_bound_may_miss_it_by_rounding(uniform: Recording):
    problem, bounds = InverseProblem(uniform), Bounds(0.003, 100.0)
    found = np.exp(np.log(np.full(problem.n_elements, [bounds.upper])))
    found[0] = np.exp(np.log(bounds.lower))
    assert found.max() > bounds.upper  # which is why
    start = start_map(found, problem, bounds)
    assert bounds.lower <= start.min() < start.max() <= bounds.upper
    with pytest.raises(ConfigError, match="outside the bounds"):
        start_map(found * (1 + 1e-6), problem, bounds)
