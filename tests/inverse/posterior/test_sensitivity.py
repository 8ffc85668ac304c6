from collections.abc import Callable

import numpy as np
import pytest

from tactorch.errors import ConfigError
from tactorch.inverse import InverseProblem
from tactorch.inverse.posterior import credibility, layer_profile
from tactorch.mesh import box_mesh

Make = Callable[..., InverseProblem]


def sensitivity_matrix(problem: InverseProblem, moduli: np.ndarray) -> np.ndarray:
    """Return the rows of all observed degrees of freedom, mm/MPa."""
    return np.concatenate([press.matrix() for press in problem.evaluate(moduli).sensitivities])


def test_matrix_against_finite_differences(make_problem: Make, moduli: np.ndarray) -> None:
    problem = make_problem(faces=("z+", "x-"))
    matrix = sensitivity_matrix(problem, moduli)
    assert matrix.shape == (problem.n_data, 40)

    def observed(youngs: np.ndarray) -> np.ndarray:
        found = problem.evaluate(youngs).displacements
        seen = zip(found, problem.data.observations, strict=True)
        return np.concatenate([u.ravel()[data.index] for u, data in seen])

    for element in (0, 17, 39):
        step = np.zeros(40)
        step[element] = 1e-4
        expected = (observed(moduli + step) - observed(moduli - step)) / 2e-4
        np.testing.assert_allclose(
            matrix[:, element], expected, rtol=1e-3, atol=1e-4 * np.abs(expected).max()
        )


def test_blocks_give_the_maximum_of_the_whole(make_problem: Make, moduli: np.ndarray) -> None:
    problem = make_problem(faces=("z+", "x-"))
    expected = np.abs(sensitivity_matrix(problem, moduli)).max(axis=0)
    np.testing.assert_allclose(credibility(problem.evaluate(moduli)), expected)


def test_falls_with_depth_and_rises_with_pressure_and_softness(make_problem: Make) -> None:
    def profile(pressure: float, youngs: float) -> np.ndarray:
        problem = make_problem(pressure, 4)
        mesh = problem.recording.mesh
        found = credibility(problem.evaluate(np.full(mesh.n_tets, youngs)))
        return layer_profile(mesh, found / mesh.volumes, 2, 4)[1]

    base = profile(0.01, 0.2)
    assert np.all(np.diff(base) > 0)  # upwards, to the pressed face
    assert np.all(profile(0.015, 0.2) > base)
    assert np.all(profile(0.01, 0.15) > base)


def test_layers_share_the_volume() -> None:
    mesh = box_mesh(10.0, 3)
    centres, sums = layer_profile(mesh, np.full(mesh.n_tets, 2.0), 2, 5)
    np.testing.assert_allclose(centres, [1, 3, 5, 7, 9])
    np.testing.assert_allclose(sums.sum(), 2000.0)
    np.testing.assert_allclose(sums, 400.0, rtol=0.1)
    with pytest.raises(ConfigError, match="layers is 0"):
        layer_profile(mesh, np.ones(mesh.n_tets), 2, 0)
