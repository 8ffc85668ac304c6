"""The smoothest traction with given nodal forces."""

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactorch.mesh import Refinement, box_mesh, face_nodes, refine
from tactorch.mesh.smooth_tractions import loaded_boundary, smooth_traction
from tactorch.mesh.tractions import LoadedSurface, loaded_triangles

MESH = box_mesh(10.0, 11, tets_per_cell=5)
RADIUS = 2.0
POINTS = 16  # along the edge of a triangle, for integrals


def _pressure(kind: str) -> Callable[[np.ndarray], np.ndarray]:
    return {
        "parabola": lambda squares: np.clip(1.0 - squares, 0.0, None),
        "hertz": lambda squares: np.sqrt(np.clip(1.0 - squares, 0.0, None)),
        "uniform": lambda squares: (squares < 1.0).astype(float),
    }[kind]


def _forces(kind: str, center: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Integrals of a round contact's traction times the hat functions of the top of the box."""
    surface = MESH.surface
    top = surface.normals[:, 2] > 0.9
    corners, out = MESH.points[surface.triangles[top]], np.zeros(MESH.n_points)
    n = POINTS
    lattice = [(i + s, j + s) for s, m in ((1 / 3, n), (2 / 3, n - 1))
               for i in range(m) for j in range(m - i)]  # fmt: skip
    for i, j in lattice:
        weights = np.array([1.0 - (i + j) / n, i / n, j / n])
        offsets = np.einsum("c,tcd->td", weights, corners)[:, :2] - center
        values = _pressure(kind)((offsets**2).sum(axis=1) / RADIUS**2)
        load = values * surface.areas[top] / len(lattice)
        np.add.at(out, surface.triangles[top], load[:, None] * weights)
    return np.outer(out, direction)


@cache
def _refined() -> Refinement:
    """Short edges at the top, within two radii of the middle."""

    def sizing(points: np.ndarray) -> np.ndarray:
        across = np.linalg.norm(points[:, :2] - 5.0, axis=1) - 1.6 * RADIUS
        beyond = np.hypot(np.maximum(across, 0.0), points[:, 2] - 10.0)
        return 0.45 + 2.0 * np.maximum(beyond - 0.3, 0.0)

    return refine(MESH, sizing)


def _loaded(refinement: Refinement, forces: np.ndarray) -> tuple[LoadedSurface, LoadedSurface]:
    surface, fine = refinement.coarse.surface, refinement.mesh.surface
    inside = loaded_triangles(surface, forces)[refinement.surface_parents]
    n = refinement.mesh.n_points
    return LoadedSurface.of(surface, forces), LoadedSurface(
        fine.triangles[inside], fine.areas[inside], n
    )


@settings(max_examples=8, deadline=None)
@given(
    kind=st.sampled_from(["parabola", "hertz", "uniform"]),
    center=st.tuples(*[st.floats(4.5, 5.5)] * 2),
    shear=st.tuples(*[st.floats(-0.5, 0.5)] * 2),
)
def test_the_nodal_forces_are_kept_and_the_rim_is_free(kind, center, shear) -> None:
    center, direction = np.array(center), np.array([*shear, -1.0])
    forces, refinement = _forces(kind, center, direction), _refined()
    coarse, fine = _loaded(refinement, forces)
    traction = smooth_traction(refinement, coarse, fine, forces)
    assert traction is not None
    back = refinement.prolongation.T @ (fine.mass @ traction)
    np.testing.assert_allclose(back, forces, atol=1e-6 * np.abs(forces).max())
    rim = np.unique(loaded_boundary(refinement.mesh.surface, fine.triangles))
    assert len(rim)
    assert not traction[rim].any()
    assert not np.delete(traction, fine.nodes, axis=0).any()


@pytest.mark.parametrize(("kind", "gain"), [("parabola", 1.7), ("hertz", 1.3)])
def test_it_is_closer_to_the_traction_of_a_round_contact(kind: str, gain: float) -> None:
    center = np.array([5.1, 4.9])
    forces, refinement = _forces(kind, center, np.array([0.0, 0.0, -1.0])), _refined()
    coarse, fine = _loaded(refinement, forces)
    squares = ((refinement.mesh.points[:, :2] - center) ** 2).sum(axis=1) / RADIUS**2
    exact = np.zeros((refinement.mesh.n_points, 3))
    exact[fine.nodes, 2] = -_pressure(kind)(squares[fine.nodes])
    smooth = smooth_traction(refinement, coarse, fine, forces)
    assert smooth is not None
    linear = refinement.interpolate(coarse.tractions(forces))

    def error(traction: np.ndarray) -> float:
        difference = traction - exact
        return float(np.sqrt((difference * (fine.mass @ difference)).sum()))

    assert error(smooth) < error(linear) / gain


def test_it_is_smoother_than_any_other_with_the_same_forces() -> None:
    """Of the tractions with these integrals that vanish at the rim, it has the least gradient."""
    center = np.array([5.0, 5.0])
    forces, refinement = _forces("parabola", center, np.array([0.0, 0.0, -1.0])), _refined()
    coarse, fine = _loaded(refinement, forces)
    traction = smooth_traction(refinement, coarse, fine, forces)
    assert traction is not None
    free = np.setdiff1d(fine.nodes, loaded_boundary(refinement.mesh.surface, fine.triangles))
    integrals = (fine.mass @ refinement.prolongation)[free][:, coarse.nodes].toarray()
    corners = refinement.mesh.points[fine.triangles][..., :2]

    def energy(values: np.ndarray) -> float:
        """Integral of the squared gradient, by the plane through each triangle."""
        planes = np.concatenate([corners, np.ones((len(corners), 3, 1))], axis=2)
        slopes = np.linalg.solve(planes, values[fine.triangles][..., None])[:, :2, 0]
        return float((fine.areas * (slopes**2).sum(axis=1)).sum())

    least, rng = energy(traction[:, 2]), np.random.default_rng(0)
    for _ in range(5):
        change = np.zeros(len(traction))
        step = rng.standard_normal(len(free))
        basis = np.linalg.qr(integrals)[0]
        change[free] = 1e-3 * (step - basis @ (basis.T @ step))
        assert energy(traction[:, 2] + change) > least
        assert energy(traction[:, 2] - change) > least


def test_tractions_that_end_at_edges_of_the_mesh_are_left_as_they_are() -> None:
    top = MESH.surface.normals[:, 2] > 0.9
    centers = MESH.points[MESH.surface.triangles[top]].mean(axis=1)
    chosen = MESH.surface.triangles[top][np.abs(centers[:, :2] - 5.0).max(axis=1) < 2.0]
    values = np.zeros((MESH.n_points, 3))
    values[np.unique(chosen), 2] = -1.0
    patch = LoadedSurface.of(MESH.surface, values)
    forces = patch.mass @ values
    refinement = _refined()
    assert smooth_traction(refinement, *_loaded(refinement, forces), forces) is None


def test_whole_sides_and_rims_that_are_not_refined_are_left_as_they_are() -> None:
    whole = np.zeros((MESH.n_points, 3))
    whole[face_nodes(MESH, "z+"), 2] = -1.0
    center = np.array([5.0, 5.0])
    refinement = _refined()
    assert not len(loaded_boundary(MESH.surface, _loaded(refinement, whole)[0].triangles))
    assert smooth_traction(refinement, *_loaded(refinement, whole), whole) is None
    forces = _forces("parabola", center, np.array([0.0, 0.0, -1.0]))
    beside = refine(MESH, lambda p: 0.5 + np.linalg.norm(p - [3.0, 5.0, 10.0], axis=1))
    assert smooth_traction(beside, *_loaded(beside, forces), forces) is None
