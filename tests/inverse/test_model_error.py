"""Against truth from a finer mesh: the correction must take away most of what the mesh adds."""

from dataclasses import replace

import numpy as np
import pytest

from tactorch.errors import ConfigError
from tactorch.inverse import InverseProblem, Settings, best_uniform, invert_map, make_objective
from tactorch.inverse.errors.discretisation import (
    corrected,
    discretisation_error,
    resolve_model_error,
)
from tactorch.metrics import pearson
from tactorch.phantoms import make_phantom
from tactorch.recording import Recording
from tactorch.simulation import PressPlan, simulate


@pytest.fixture(scope="module")
def finer() -> Recording:
    """The paper's cube at the paper's density, pressed on a mesh twice as fine."""
    cube = make_phantom("cube_shallow_sphere")
    meshes = [cube.mesh(relative_edge_length=size) for size in (0.1, 0.05)]
    return simulate(
        cube, PressPlan(("z+",), (0.02,)), mesh=meshes[0], fine_mesh=meshes[1], samples=4
    )


def _distance(problem: InverseProblem, youngs: np.ndarray) -> float:
    return float(np.sqrt(2.0 * problem.evaluate(youngs).misfit_mm2))


def test_the_correction_takes_away_most_of_the_meshs_error(finer: Recording):
    assert finer.truth is not None
    problem = InverseProblem(finer)
    before = _distance(problem, finer.truth)
    problem = corrected(problem, discretisation_error(problem, best_uniform(problem)))
    assert _distance(problem, finer.truth) < 0.5 * before


def test_what_is_left_is_of_the_size_that_it_says(finer: Recording):
    assert finer.truth is not None
    problem = InverseProblem(finer)
    errors = discretisation_error(problem, best_uniform(problem))
    problem = corrected(problem, errors)
    left = _distance(problem, finer.truth) / np.sqrt(problem.n_data)
    assert 0.3 < left / np.mean([error.deviation_mm for error in errors]) < 2.0


def test_deviations_add_up_in_squares(finer: Recording):
    problem = InverseProblem(finer)
    before = 1.0 / problem.data.observations[0].scale
    errors = discretisation_error(problem, 0.3)
    stated, problem = problem.data, corrected(problem, errors)
    np.testing.assert_array_equal(1.0 / stated.observations[0].scale, before)  # untouched
    after = 1.0 / problem.data.observations[0].scale
    assert np.allclose(after**2, before**2 + errors[0].deviation_mm ** 2)
    shares = [(b / a) ** 2 for b, a in zip(before, after, strict=True)]
    assert problem.data.noise_fraction == pytest.approx(np.mean(shares))


def test_what_the_presses_of_one_place_share_is_counted_once(cube: Recording):
    """A shift of a whole contact is worth one datum, whatever the number of nodes and steps."""
    problem = InverseProblem(cube)
    before = problem.evaluate(np.full(problem.n_elements, 0.3)).residuals
    errors = discretisation_error(problem, 0.3)
    problem = corrected(problem, errors)
    assert problem.data.correlated is not None
    shift = np.concatenate(
        [
            0.1 * (observation.index % 3 == 2) * error.deviation_mm * observation.scale
            for observation, error in zip(problem.data.observations, errors, strict=True)
        ]
    )
    assert len(before) == len(shift)
    left = problem.data.whiten(shift)
    assert left @ left < 0.1 * (shift @ shift)


@pytest.mark.slow
def test_an_inversion_without_inverse_crime_gains(finer: Recording):
    assert finer.truth is not None
    blind = replace(finer, truth=None)
    r = {
        name: pearson(
            invert_map(blind, Settings(model_error=name), show_progress=False).youngs, finer.truth
        )
        for name in ("none", "auto")
    }
    assert r["auto"] > r["none"] + 0.05


def test_presses_of_the_same_mesh_are_left_alone(recording: Recording):
    plain = InverseProblem(recording)
    same = make_objective(recording, Settings()).problem
    for a, b in zip(plain.data.observations, same.data.observations, strict=True):
        assert np.array_equal(a.values, b.values)
        assert np.array_equal(a.scale, b.scale)


@pytest.mark.parametrize(
    ("provenance", "element", "expected"),
    [
        ({"inverse_crime": True}, "tet4", "none"),
        ({"inverse_crime": False}, "tet4", "discretisation"),
        ({}, "tet4", "discretisation"),
        ({}, "tet10", "none"),
    ],
)
def test_auto_goes_by_the_provenance(
    recording: Recording, provenance: dict, element: str, expected: str
):
    assert (
        resolve_model_error("auto", replace(recording, provenance=provenance), element) == expected
    )


def test_unusable_settings_are_refused(recording: Recording):
    with pytest.raises(ConfigError, match="model_error='mesh': give auto, none or"):
        Settings(model_error="mesh")
    quadratic = InverseProblem(recording, element="tet10")
    with pytest.raises(ConfigError, match="element=tet10 choose model_error=none"):
        discretisation_error(quadratic, 0.2)


def test_the_share_that_is_left_scales_the_uncertainty(cube: Recording):
    problem = InverseProblem(cube)
    third, none = (discretisation_error(problem, 0.3, remaining=left) for left in (1.0 / 3.0, 0.0))
    assert [error.deviation_mm for error in none] == [0.0] * len(cube.presses)
    for offset, deviation_mm, deviation_n in third:
        assert deviation_mm == pytest.approx(np.sqrt(np.mean(offset**2)) / 3.0)
        assert deviation_n == 0.0  # no force is measured
    with pytest.raises(ConfigError, match=r"residual_model_error_fraction=-0\.1"):
        Settings(residual_model_error_fraction=-0.1)


@pytest.mark.slow
def test_the_error_grows_with_the_displacement_that_is_observed(finer: Recording):
    """A modulus half as large again would lose a third of it, but for large strains."""
    problem = InverseProblem(finer)
    fit = best_uniform(problem)
    right, stiff = (discretisation_error(problem, youngs)[0].offset for youngs in (fit, 1.5 * fit))
    assert np.linalg.norm(stiff - right) < 0.2 * np.linalg.norm(right)
