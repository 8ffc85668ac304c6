"""Nodal forces of tractions that end within a face, or at an edge of the body."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactorch.importers.loads import consistent_loads
from tactorch.mesh import TetMesh, box_mesh

MESH: TetMesh = box_mesh((12.0, 12.0, 4.0), 12)
TRIANGLES = MESH.surface.triangles
TOP = MESH.points[:, 2] > 3.99


def patch(center: tuple[float, float], radius_mm: float) -> np.ndarray:
    """Nodes of the top within a circle."""
    return TOP & (np.linalg.norm(MESH.points[:, :2] - center, axis=1) < radius_mm)


@settings(max_examples=30, deadline=None)
@given(st.floats(4.0, 8.0), st.floats(4.0, 8.0), st.floats(2.0, 3.5))
def test_the_total_of_a_patch_is_that_of_its_nodes(x: float, y: float, radius_mm: float) -> None:
    on = patch((x, y), radius_mm)
    forces = consistent_loads(MESH.points, TRIANGLES, np.where(on, 0.02, 0.0))
    # Each node within the top stands for a square of 1 mm; no force acts elsewhere.
    np.testing.assert_allclose(forces.sum(axis=0), [0.0, 0.0, -0.02 * on.sum()], atol=1e-12)
    tractions = np.where(on[:, None], (0.01, 0.0, -0.02), 0.0)
    loads = consistent_loads(MESH.points, TRIANGLES, tractions)
    np.testing.assert_allclose(loads.sum(axis=0), np.array([0.01, 0.0, -0.02]) * on.sum())


def test_the_mean_total_of_uniform_patches_is_pressure_times_area() -> None:
    rng, totals = np.random.default_rng(0), []
    for _ in range(200):
        on = patch(tuple(rng.uniform(5.0, 7.0, 2)), 3.0)
        totals.append(-consistent_loads(MESH.points, TRIANGLES, 1.0 * on)[:, 2].sum())
    assert np.mean(totals) == pytest.approx(np.pi * 9.0, rel=0.02)


def test_a_contact_ends_at_sharp_edges() -> None:
    forces = consistent_loads(MESH.points, TRIANGLES, np.where(TOP, 0.02, 0.0))
    np.testing.assert_allclose(forces.sum(axis=0), [0.0, 0.0, -0.02 * 144.0], atol=1e-12)
    assert not forces[~TOP].any()
    half = TOP & (MESH.points[:, 0] < 6.5)
    forces = consistent_loads(MESH.points, TRIANGLES, np.where(half, 0.02, 0.0))
    np.testing.assert_allclose(forces.sum(axis=0), [0.0, 0.0, -0.02 * 6.5 * 12.0], atol=1e-12)


def test_one_node_of_a_face_has_its_own_share() -> None:
    node = int(np.linalg.norm(MESH.points - (6.0, 6.0, 4.0), axis=1).argmin())
    loads = consistent_loads(
        MESH.points, TRIANGLES, np.eye(MESH.n_points)[node][:, None] * np.array([0.0, 0.0, -2.0])
    )
    assert loads[:, 2].sum() == pytest.approx(-2.0 * MESH.vertex_areas[node])
    assert -loads[node, 2] > np.delete(-loads[:, 2], node).max()
