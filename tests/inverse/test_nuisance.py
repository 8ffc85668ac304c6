"""Nuisance parameters: derivatives against finite differences, recovery, and their files."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tactorch.errors import ConfigError
from tactorch.fem import ELEMENTS
from tactorch.inverse import (
    Bounds,
    InverseProblem,
    NoiseModel,
    Nuisance,
    NuisancePrior,
    Reconstruction,
    Settings,
    invert_map,
    make_objective,
)
from tactorch.inverse.fit.starts import uniform_fit
from tactorch.recording import Recording
from tactorch.simulation import perturb_recording

Make = Callable[..., Recording]
ALL = NuisancePrior(
    poisson=0.02, force_scale=0.2, rest_scale=0.1, translation_mm=0.3, rotation_rad=0.05
)
NAMES = ("poisson", "force_scale", "rest_scale", "translation_mm", "rotation_rad")
EXACT = NoiseModel(relative=1e-4)


@pytest.fixture(scope="module")
def heavy(make_tiny: Make) -> Recording:
    """Two presses on a cube whose own weight matters."""
    return make_tiny(density=1e-9, gravity=(0.0, 0.0, -9810.0))


@pytest.mark.parametrize("element", ELEMENTS.names())
@pytest.mark.parametrize("k", range(ALL.size))
def test_each_column_is_the_finite_difference(
    heavy: Recording, moduli: np.ndarray, element: str, k: int
) -> None:
    problem = InverseProblem(heavy, element=element)
    z = np.random.default_rng(1).uniform(-0.5, 0.5, ALL.size)

    def residuals(z: np.ndarray) -> np.ndarray:
        values = ALL.nuisance(z, problem.assumed)
        return problem.evaluate(moduli, nuisance=values).residuals

    at = problem.evaluate(moduli, nuisance=ALL.nuisance(z, problem.assumed))
    column = (at.nuisance_jacobian(ALL.names) * ALL.slopes())[:, k]
    step = np.zeros(ALL.size)
    step[k] = 1e-4
    expected = (residuals(z + step) - residuals(z - step)) / 2e-4
    np.testing.assert_allclose(column, expected, rtol=0, atol=1e-6 * np.abs(expected).max())


def test_the_moduli_s_columns_are_right_in_a_turned_frame(
    recording: Recording, moduli: np.ndarray
) -> None:
    problem = InverseProblem(recording)
    values = replace(problem.assumed, rotation_rad=np.array([0.2, -0.3, 0.1]))
    at = problem.evaluate(moduli, nuisance=values)
    direction = np.random.default_rng(0).standard_normal(len(moduli))
    plus, minus = (
        problem.evaluate(moduli + s * 1e-5 * direction, nuisance=values).residuals for s in (1, -1)
    )
    expected = (plus - minus) / 2e-5
    tolerance = 1e-6 * np.abs(expected).max()
    np.testing.assert_allclose(at.jacobian() @ direction, expected, rtol=0, atol=tolerance)
    np.testing.assert_allclose(at.jacobian_times(direction), expected, rtol=0, atol=tolerance)
    weights = np.random.default_rng(1).standard_normal(len(expected))
    np.testing.assert_allclose(at.transpose_times(weights), at.jacobian().T @ weights, rtol=1e-8)


def test_assumed_values_change_nothing(recording: Recording, moduli: np.ndarray) -> None:
    problem = InverseProblem(recording)
    plain = problem.evaluate(moduli)
    same = problem.evaluate(moduli, nuisance=ALL.nuisance(np.zeros(ALL.size), problem.assumed))
    np.testing.assert_array_equal(plain.residuals, same.residuals)


def test_parameters_of_the_objective_have_all_derivatives(recording: Recording) -> None:
    objective = make_objective(recording, Settings(nuisance=ALL))
    rng = np.random.default_rng(2)
    x = objective.start(rng.uniform(0.15, 0.6, recording.mesh.n_tets))
    x[-ALL.size :] = rng.uniform(-0.5, 0.5, ALL.size)
    point = objective.at(x)
    direction = rng.standard_normal(len(x))
    plus, minus = (objective.at(x + s * 1e-6 * direction) for s in (1, -1))
    slope = point.data_gradient + point.prior_gradient(3.0)
    assert slope @ direction == pytest.approx((plus.value(3.0) - minus.value(3.0)) / 2e-6, rel=1e-5)
    np.testing.assert_allclose(
        point.jacobian_times(direction), point.jacobian @ direction, rtol=0, atol=1e-6
    )
    curvature = point.prior_curvature(3.0).toarray()
    assert curvature.shape == (objective.size, objective.size)
    np.testing.assert_array_equal(curvature[-ALL.size :, -ALL.size :], np.eye(ALL.size))


@pytest.mark.parametrize(
    ("wrong", "name", "expected"),
    [
        ({"poisson": 0.02}, "poisson", [0.45]),
        ({"force_scale": 1.2}, "force_scale", [1 / 1.2]),
        ({"size": (1.1, 0.95, 1.05)}, "rest_scale", [1 / 1.1, 1 / 0.95, 1 / 1.05]),
    ],
)
def test_what_was_wrong_is_found(
    cube: Recording, wrong: dict[str, float], name: str, expected: list[float]
) -> None:
    deviation = {"poisson": 0.05, "force_scale": 0.3, "rest_scale": 0.15}[name]
    settings = Settings(nuisance=NuisancePrior(**{name: deviation}), noise=EXACT)
    found = invert_map(perturb_recording(cube, **wrong), settings)
    estimate = found.nuisance[name]
    off = np.abs(estimate.value / np.array(expected) - 1.0)
    before = (
        np.abs(1.0 / np.array(expected) - 1.0) if name != "poisson" else np.array([0.02 / 0.45])
    )
    assert np.all(off < 0.25 * before)
    assert np.all(estimate.deviation < 0.5 * estimate.prior_deviation)


def test_an_offset_and_a_turn_of_the_sensor_are_found(cube: Recording) -> None:
    problem = InverseProblem(cube)
    truth = cube.truth
    assert truth is not None
    moved = replace(
        problem.assumed,
        translation_mm=np.array([0.1, -0.2, 0.15]),
        rotation_rad=np.array([0.02, 0.01, -0.03]),
    )
    reported = problem.evaluate(truth, nuisance=moved).reported
    presses = tuple(
        replace(press, displacement=u) for press, u in zip(cube.presses, reported, strict=True)
    )
    seen = replace(cube, presses=presses, check_units=False)
    settings = Settings(nuisance=NuisancePrior(translation_mm=0.3, rotation_rad=0.05), noise=EXACT)
    found = invert_map(seen, settings).nuisance
    np.testing.assert_allclose(found["translation_mm"].value, moved.translation_mm, atol=0.02)
    np.testing.assert_allclose(found["rotation_rad"].value, moved.rotation_rad, atol=0.003)


def test_without_a_known_stiffness_the_force_scale_stays_open(make_tiny: Make) -> None:
    free = make_tiny(support="fixed")
    settings = Settings(nuisance=NuisancePrior(force_scale=0.2), noise=EXACT)
    estimate = invert_map(free, settings).nuisance["force_scale"]
    assert estimate.deviation[0] == pytest.approx(0.2, rel=0.05)


def test_the_uniform_fit_finds_both(make_tiny: Make) -> None:
    from tactorch.phantoms import make_phantom
    from tactorch.simulation import PressPlan, simulate

    mesh = make_tiny().mesh
    uniform = simulate(make_phantom("uniform_cube"), PressPlan(("z+", "x-"), (0.01,)), mesh=mesh)
    assert uniform.truth is not None
    fit = uniform_fit(
        InverseProblem(perturb_recording(uniform, size=1.1)),
        Bounds(),
        NuisancePrior(rest_scale=1.0),
    )
    assert fit.youngs_mpa == pytest.approx(float(uniform.truth[0]), rel=1e-2)
    np.testing.assert_allclose(fit.nuisance.rest_scale, 1 / 1.1, rtol=1e-3)


def test_estimates_survive_the_file(recording: Recording, tmp_path: Path) -> None:
    settings = Settings(nuisance=NuisancePrior(poisson=0.02, rest_scale=0.1), max_seconds=1e-9)
    found = invert_map(recording, settings)
    again = Reconstruction.load(found.save(tmp_path / "r.h5"))
    assert set(again.nuisance) == {"poisson", "rest_scale"}
    for name, estimate in found.nuisance.items():
        np.testing.assert_array_equal(again.nuisance[name].value, estimate.value)
        np.testing.assert_array_equal(again.nuisance[name].deviation, estimate.deviation)
        assert again.nuisance[name].prior_deviation == estimate.prior_deviation


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
def test_a_deviation_that_cannot_be_is_refused(name: str, value: float) -> None:
    with pytest.raises(ConfigError, match=f"nuisance.{name}"):
        NuisancePrior(**{name: value})


def test_poissons_ratio_stays_where_materials_exist() -> None:
    low, high = NuisancePrior(poisson=0.1).limits(Nuisance(0.45))
    assert 0.45 + 0.1 * high[0] < 0.5
    assert low[0] == pytest.approx(-8.0)
