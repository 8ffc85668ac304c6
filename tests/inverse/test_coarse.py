"""Clusters of elements, the Jacobian by their moduli, and the start they give."""

from collections.abc import Callable

import numpy as np
import pytest
import scipy.sparse as sp

from tactorch.errors import ConfigError
from tactorch.inverse import (
    Bounds,
    InverseProblem,
    Log,
    NewtonCG,
    Objective,
    Quadratic,
    Settings,
    invert_map,
)
from tactorch.inverse.fields import ElementField
from tactorch.inverse.fit.starts import CoarseStart, clusters
from tactorch.mesh import TetMesh, box_mesh
from tactorch.recording import Recording


@pytest.fixture(scope="module")
def mesh() -> TetMesh:
    return box_mesh((40.0, 10.0, 10.0), (8, 2, 2))


@pytest.mark.parametrize("count", [1, 4, 30])
def test_clusters_are_compact_and_none_is_empty(mesh: TetMesh, count: int) -> None:
    labels = clusters(mesh, count)
    assert set(labels) == set(range(count))
    volumes = np.bincount(labels, mesh.volumes)
    assert volumes.max() < 5.0 * volumes.mean()
    spread = [np.ptp(mesh.centroids[labels == k], axis=0).max() for k in range(count)]
    assert max(spread) <= 40.0 / count + 15.0
    np.testing.assert_array_equal(labels, clusters(mesh, count))


@pytest.mark.parametrize("count", [0, 10_000])
def test_impossible_counts_are_refused(mesh: TetMesh, count: int) -> None:
    with pytest.raises(ConfigError, match=f"groups={count}"):
        clusters(mesh, count)


def test_the_grouped_jacobian_is_the_sum_of_columns(
    recording: Recording, moduli: np.ndarray
) -> None:
    labels = clusters(recording.mesh, 5)
    shared = np.array([moduli[labels == k].mean() for k in range(5)])
    zero = Quadratic(sp.csr_matrix((5, 5)))
    objective = Objective(
        InverseProblem(recording), ElementField(Log(), zero, recording.mesh.n_tets, labels)
    )
    point = objective.at(np.log(shared))
    np.testing.assert_allclose(point.youngs, shared[labels])
    columns = point.evaluation.jacobian() * point.youngs
    expected = np.column_stack([columns[:, labels == k].sum(axis=1) for k in range(5)])
    np.testing.assert_allclose(point.jacobian, expected, rtol=1e-8, atol=1e-10)
    change, weights = np.arange(5.0), np.linspace(-1.0, 1.0, len(point.jacobian))
    np.testing.assert_allclose(point.jacobian_times(change), expected @ change, rtol=1e-8)
    np.testing.assert_allclose(point.transpose_times(weights), expected.T @ weights, rtol=1e-7)


def test_a_coarse_start_is_nearer_than_a_uniform_one(make_cube: Callable[..., Recording]) -> None:
    cube = make_cube(snr_db=30.0, seed=1)
    problem, bounds = InverseProblem(cube), Bounds()
    one, many = (CoarseStart(groups)(problem, bounds) for groups in (1, 12))
    assert len(np.unique(one)) == 1
    assert len(np.unique(many)) == 12
    truth = cube.truth
    assert truth is not None
    errors = [np.sqrt(np.mean(np.log(start / truth) ** 2)) for start in (one, many)]
    assert errors[1] < errors[0]
    chi2 = [problem.evaluate(start).chi2 for start in (one, many)]
    assert chi2[1] < 0.5 * chi2[0]


@pytest.mark.slow
def test_it_starts_an_inversion(make_cube: Callable[..., Recording]) -> None:
    cube = make_cube(snr_db=30.0, seed=1)
    settings = Settings(optimizer=NewtonCG())
    found, plain = (invert_map(cube, settings, start_mpa=s) for s in (CoarseStart(12), 0.2))
    assert found.history[0]["chi2"] < 0.5 * plain.history[0]["chi2"]
    assert found.config["start_mpa"] == "CoarseStart"
    assert np.corrcoef(found.youngs, plain.youngs)[0, 1] > 0.98
