"""Meshes whose faces follow closed surfaces."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactorch.mesh import box_mesh, refine
from tactorch.mesh.conform import ClosedSurface, Conforming, conform

MESH = box_mesh(10.0, 6, tets_per_cell=5)


def _ball(center: tuple[float, ...], radius: float) -> ClosedSurface:
    def level(points: np.ndarray) -> np.ndarray:
        return np.asarray(np.linalg.norm(points - center, axis=1) - radius)

    return ClosedSurface(level, 4.0 / 3.0 * np.pi * radius**3)


def _conform(*balls: ClosedSurface, edge: float = 0.5) -> Conforming:
    def sizing(points: np.ndarray) -> np.ndarray:
        radii = [np.cbrt(0.75 * ball.volume_mm3 / np.pi) for ball in balls]
        pairs = zip(balls, radii, strict=True)
        return np.min([edge * r + 0.7 * np.abs(b.level(points)) for b, r in pairs], axis=0)

    return conform(refine(MESH, sizing), balls)


def _check(result: Conforming) -> None:
    """Check the bisections, the moves, and that the mesh's own surface remains."""
    nested, mesh, n = result.refinement.mesh, result.mesh, MESH.n_points
    ends = result.refinement.ends
    np.testing.assert_allclose(nested.points[n:], nested.points[ends].mean(axis=1), atol=1e-12)
    assert (ends < np.arange(n, nested.n_points)[:, None]).all()
    volumes = np.bincount(result.refinement.parents, nested.volumes, minlength=MESH.n_tets)
    np.testing.assert_allclose(volumes, MESH.volumes, rtol=1e-12)
    np.testing.assert_array_equal(mesh.tets, nested.tets)
    assert mesh.volumes.min() > 0
    np.testing.assert_allclose(mesh.volumes.sum(), 1000.0, rtol=1e-12)
    outer = np.unique(mesh.surface.triangles)
    np.testing.assert_array_equal(mesh.points[outer], nested.points[outer])
    assert result.sides.shape[1] == mesh.n_tets


@settings(max_examples=5, deadline=None)
@given(
    center=st.tuples(*[st.floats(3.5, 6.5)] * 3),
    radius=st.floats(0.8, 2.8),
    edge=st.floats(0.4, 0.6),
)
def test_faces_follow_a_ball(
    center: tuple[float, float, float], radius: float, edge: float
) -> None:
    ball = _ball(center, radius)
    result = _conform(ball, edge=edge)
    _check(result)
    (side,), mesh = result.sides, result.mesh
    assert (side != 0).all()
    assert mesh.volumes[side < 0].sum() == pytest.approx(ball.volume_mm3, rel=0.01)
    # Nodes of the interface have one distance from the centre, but for the few that would be near
    # the end of an edge: they are off by at most a tenth of its length.
    shared = np.intersect1d(mesh.tets[side < 0], mesh.tets[side > 0])
    level = ball.level(mesh.points[shared])
    off = np.abs(level - np.median(level))
    assert np.median(off) < 0.02 * edge * radius
    assert off.max() < 0.15 * edge * radius
    inside = mesh.points[np.setdiff1d(mesh.tets[side < 0], shared)]
    assert (ball.level(inside) < 0).all()


def test_two_balls() -> None:
    balls = _ball((3.2, 5.0, 5.0), 1.5), _ball((6.8, 5.0, 5.0), 1.5)
    result = _conform(*balls)
    _check(result)
    for ball, side in zip(balls, result.sides, strict=True):
        assert (side != 0).all()
        inside = result.mesh.volumes[side < 0].sum()
        assert inside == pytest.approx(ball.volume_mm3, rel=0.01)


def test_a_ball_that_leaves_the_body_keeps_crossed_elements() -> None:
    """The surface of the mesh has loads and observations, and remains."""
    result = _conform(_ball((5.0, 5.0, 9.3), 2.0))
    _check(result)
    crossed = result.sides[0] == 0
    assert crossed.any()
    outer = np.isin(result.mesh.tets, np.unique(MESH.surface.triangles))
    outer |= np.isclose(result.mesh.points[result.mesh.tets][..., 2], 10.0)
    assert outer[crossed].any(axis=1).all()


def test_no_surface_leaves_the_mesh() -> None:
    result = conform(refine(MESH, lambda points: np.full(len(points), np.inf)), [])
    assert result.mesh.n_tets == MESH.n_tets
    assert result.sides.shape == (0, MESH.n_tets)
