"""The curved surface through the nodes of round and flat bodies."""

import numpy as np
import pytest

from tactorch.mesh import Box, Cylinder, Shape, Sphere, TetMesh, box_mesh, refine
from tactorch.mesh.curved import curved_offsets, onto_curved_surface
from tactorch.mesh.lattice import lattice_mesh


def placed(shape: Shape, count: int = 500) -> tuple[np.ndarray, np.ndarray]:
    """Points in random triangles of the surface of a shape, and their offsets."""
    points, triangles = shape.surface(24)
    rng = np.random.default_rng(0)
    chosen = rng.integers(len(triangles), size=count)
    shares = rng.dirichlet(np.ones(3), size=count)
    flat = np.einsum("qc,qcd->qd", shares, points[triangles[chosen]])
    return flat, curved_offsets(points, triangles, chosen, shares)


def test_ball_of_few_triangles_is_nearly_round() -> None:
    ball = Sphere((1.0, 2.0, -3.0), 30.0)
    flat, offsets = placed(ball)
    before, after = (np.abs(ball.signed_distance(at)).max() for at in (flat, flat + offsets))
    assert before > 0.4
    assert after < 0.05 * before


@pytest.mark.parametrize("axis", [(0.0, 0.0, 1.0), (1.0, 1.0, 0.0)])
def test_cylinder_is_round_and_its_ends_are_flat(axis: tuple[float, float, float]) -> None:
    cylinder = Cylinder((0.0, 0.0, 0.0), 10.0, 20.0, axis)
    flat, offsets = placed(cylinder)
    along = flat @ np.array(axis) / np.linalg.norm(axis)
    end = np.abs(along) > 10.0 - 1e-9
    assert end.sum() > 50
    np.testing.assert_allclose(offsets[end], 0.0, atol=1e-12)
    moved = cylinder.signed_distance((flat + offsets)[~end])
    assert np.abs(cylinder.signed_distance(flat[~end])).max() > 0.08
    assert np.abs(moved).max() < 0.01


def test_box_remains_a_box() -> None:
    _, offsets = placed(Box((0.0, 0.0, 0.0), (3.0, 4.0, 5.0)))
    assert (offsets == 0.0).all()


def test_nodes_that_a_refinement_adds_are_on_the_ball() -> None:
    ball = Sphere((0.0, 0.0, 0.0), 10.0)
    mesh = lattice_mesh(ball, 3.0)  # whose nodes near the box of the ball are on the box
    points, nodes = mesh.points.copy(), mesh.surface.nodes()
    points[nodes] *= 10.0 / np.linalg.norm(points[nodes], axis=1)[:, None]
    coarse = TetMesh.create(points, mesh.tets)
    fine = refine(coarse, lambda points: np.full(len(points), 2.5)).mesh
    moved = onto_curved_surface(fine, coarse)
    added = moved.surface.nodes()
    added = added[added >= coarse.n_points]
    before, after = (ball.signed_distance(mesh.points[added]) for mesh in (fine, moved))
    assert len(added) > 100
    assert np.sqrt(np.mean(after**2)) < 0.25 * np.sqrt(np.mean(before**2))
    assert moved.volumes.min() > 0.0
    kept = np.setdiff1d(np.arange(fine.n_points), added)
    np.testing.assert_array_equal(moved.points[kept], fine.points[kept])


def test_refined_box_remains_the_same() -> None:
    coarse = box_mesh(10.0, 3)
    fine = refine(coarse, lambda points: np.full(len(points), 2.0)).mesh
    np.testing.assert_array_equal(onto_curved_surface(fine, coarse).points, fine.points)
