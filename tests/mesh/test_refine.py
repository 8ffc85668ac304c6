import importlib
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactorch.errors import ConfigError
from tactorch.mesh import Refinement, TetMesh, box_mesh, refine
from tactorch.mesh.refine import edge_lengths

CENTER = np.array([2.0, 0.0, 1.0])


def _near(points: np.ndarray, size: float = 0.3, growth: float = 0.4) -> np.ndarray:
    return size + growth * np.linalg.norm(points - CENTER, axis=1)


@pytest.fixture(scope="module")
def refinement(mesh: TetMesh) -> Refinement:
    return refine(mesh, _near)


def _check_nested(refinement: Refinement) -> None:
    """Check all that a conforming nested refinement promises."""
    coarse, fine = refinement.coarse, refinement.mesh
    n = coarse.n_points
    np.testing.assert_array_equal(fine.points[:n], coarse.points)
    middles = fine.points[refinement.ends].mean(axis=1)
    np.testing.assert_allclose(fine.points[n:], middles, rtol=0, atol=1e-12)
    assert (refinement.ends < np.arange(n, fine.n_points)[:, None]).all()
    assert fine.volumes.min() > 0
    volumes = np.bincount(refinement.parents, fine.volumes, minlength=coarse.n_tets)
    np.testing.assert_allclose(volumes, coarse.volumes, rtol=1e-12)
    # A face that does not match its neighbours' would count as boundary.
    areas = np.bincount(
        refinement.surface_parents, fine.surface.areas, minlength=len(coarse.surface.areas)
    )
    np.testing.assert_allclose(areas, coarse.surface.areas, rtol=1e-12)
    normals = coarse.surface.normals[refinement.surface_parents]
    np.testing.assert_allclose(fine.surface.normals, normals, atol=1e-9)
    # Barycentric coordinates of the corners of each element in its parent.
    corners = coarse.points[coarse.tets[refinement.parents]]
    sides = (corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1)
    offsets = fine.points[fine.tets] - corners[:, :1]
    within = np.linalg.solve(sides, offsets.transpose(0, 2, 1))
    assert within.min() > -1e-9
    assert within.sum(axis=1).max() < 1 + 1e-9


def test_bisections_around_few_elements_are_those_of_all(monkeypatch: pytest.MonkeyPatch) -> None:
    module, found = importlib.import_module("tactorch.mesh.refine"), []
    for few in (0.0, 1.0):
        monkeypatch.setattr(module, "_FEW", few)
        found.append(refine(box_mesh(10.0, 4), _near).mesh)
    np.testing.assert_array_equal(found[0].points, found[1].points)
    np.testing.assert_array_equal(found[0].tets, found[1].tets)


def test_refinement_is_nested_and_as_fine_as_wanted(refinement: Refinement) -> None:
    _check_nested(refinement)
    fine = refinement.mesh
    assert fine.n_tets > 3 * refinement.coarse.n_tets
    longest = edge_lengths(fine.points, fine.tets).max(axis=1)
    assert (longest <= _near(fine.centroids)).all()
    assert longest.max() > 2 * longest.min()


@settings(max_examples=25)
@given(
    center=st.tuples(*[st.floats(-1.0, 4.0)] * 3),
    size=st.floats(0.25, 3.0),
    growth=st.floats(0.0, 2.0),
    cells=st.tuples(*[st.integers(1, 3)] * 3),
    per_cell=st.sampled_from([5, 6]),
)
def test_any_sizing_gives_a_conforming_mesh(
    center: Any, size: float, growth: float, cells: Any, per_cell: Any
) -> None:
    def sizing(points: np.ndarray) -> np.ndarray:
        return size + growth * np.linalg.norm(points - np.array(center), axis=1)

    refinement = refine(box_mesh((3.0, 2.0, 1.0), cells, tets_per_cell=per_cell), sizing)
    fine = refinement.mesh
    _check_nested(refinement)
    assert (edge_lengths(fine.points, fine.tets).max(axis=1) <= sizing(fine.centroids)).all()


def test_elements_far_from_the_fine_region_are_unchanged(mesh: TetMesh) -> None:
    refinement = refine(mesh, lambda p: np.where(p[:, 0] > 2.6, 0.4, np.inf))
    unchanged = np.bincount(refinement.parents, minlength=mesh.n_tets) == 1
    assert unchanged.mean() > 0.3
    kept = np.flatnonzero(unchanged[refinement.parents])
    np.testing.assert_array_equal(refinement.mesh.tets[kept], mesh.tets[refinement.parents[kept]])


def test_infinite_lengths_change_nothing(mesh: TetMesh) -> None:
    refinement = refine(mesh, lambda points: np.full(len(points), np.inf))
    assert refinement.mesh is mesh
    assert refinement.ends.shape == (0, 2)
    np.testing.assert_array_equal(refinement.parents, np.arange(mesh.n_tets))
    values = np.arange(mesh.n_points, dtype=float)
    np.testing.assert_array_equal(refinement.interpolate(values), values)
    np.testing.assert_array_equal(
        refinement.surface_parents, np.arange(len(mesh.surface.triangles))
    )


def test_interpolation_is_linear_and_passes_through_the_midpoints(
    refinement: Refinement,
) -> None:
    rng = np.random.default_rng(0)
    n = refinement.coarse.n_points
    values = rng.normal(size=(n, 3))
    fine = refinement.interpolate(values)
    np.testing.assert_array_equal(fine[:n], values)
    np.testing.assert_allclose(fine[n:], fine[refinement.ends].mean(axis=1), atol=1e-14)
    np.testing.assert_allclose(
        refinement.interpolate(refinement.coarse.points), refinement.mesh.points, atol=1e-12
    )
    np.testing.assert_array_equal(refinement.interpolate(values[:, 0]), fine[:, 0])
    # A midpoint of a midpoint depends on more than two nodes, none on more than an element's.
    counts = np.diff(refinement.prolongation.indptr)
    assert set(counts) >= {1, 2, 3}
    assert counts.max() <= 4
    values[7] = np.nan
    affected = np.isnan(refinement.interpolate(values)).any(axis=1)
    np.testing.assert_array_equal(affected, refinement.prolongation[:, [7]].toarray()[:, 0] > 0)


@pytest.mark.parametrize(
    ("sizing", "says"),
    [
        (lambda p: np.full((len(p), 3), 1.0), r"shape \(\d+, 3\) for"),
        (lambda p: np.full(len(p), np.nan), "returned nan mm"),
        (lambda p: np.zeros(len(p)), "returned 0 mm; return edge lengths of at least 0.000374 mm"),
        (lambda p: 0.5 * np.linalg.norm(p - CENTER, axis=1), "of the mesh's diagonal"),
    ],
)
def test_refuses_other_sizings(mesh: TetMesh, sizing: Any, says: str) -> None:
    with pytest.raises(ConfigError, match=says):
        refine(mesh, sizing)


def test_refuses_more_elements_than_a_mesh_may_have(
    mesh: TetMesh, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = importlib.import_module("tactorch.mesh.refine")  # the package has the function
    monkeypatch.setattr(module, "MAX_ELEMENTS", 500)
    with pytest.raises(ConfigError, match="more than 5e\\+02 elements"):
        refine(mesh, lambda points: np.full(len(points), 0.1))


def test_interpolation_refuses_a_field_of_another_mesh(refinement: Refinement) -> None:
    with pytest.raises(ConfigError, match="one row per node of the coarse mesh"):
        refinement.interpolate(np.zeros((refinement.mesh.n_points, 3)))
