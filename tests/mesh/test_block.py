"""Blocks below a surface that is known at scattered points."""

import numpy as np
import pytest

from tactorch.errors import MeshError
from tactorch.mesh.block import HeightField, block_below


def scattered(count: int = 200, seed: int = 0, noise: float = 0.0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    xy = rng.uniform([0.0, -10.0], [40.0, 20.0], (count, 2))
    z = 3.0 * np.sin(xy[:, 0] / 10.0) + 0.1 * xy[:, 1] - 50.0
    return np.column_stack([xy, z + noise * rng.standard_normal(count)])


def test_the_height_is_that_of_the_surface_between_its_points() -> None:
    height = HeightField(scattered())
    inside = scattered(50, seed=1)
    inside = inside[(np.abs(inside[:, :2] - [20.0, 5.0]) < [17.0, 12.0]).all(axis=1)]
    assert height(inside[:, :2]) == pytest.approx(inside[:, 2], abs=0.1)
    assert height.error_mm < 0.1


def test_noise_of_the_points_is_smoothed() -> None:
    height, noisy = HeightField(scattered(noise=0.3)), scattered(noise=0.3)
    exact = scattered()
    error = np.sqrt(np.mean((height(exact[:, :2]) - exact[:, 2]) ** 2))
    assert error < 0.7 * np.sqrt(np.mean((noisy - exact)[:, 2] ** 2))
    assert height.error_mm == pytest.approx(0.3, rel=0.4)


def test_far_from_the_points_the_height_is_that_of_the_nearest() -> None:
    points = scattered()
    far = np.array([[-500.0, 0.0], [40.0, 900.0]])
    heights = HeightField(points)(far)
    assert (np.abs(heights - points[:, 2].mean()) < 8.0).all()


def test_a_block_has_the_surface_a_flat_bottom_and_the_margin() -> None:
    points = scattered()
    height = HeightField(points)
    block = block_below(height, depth_mm=12.0, margin_mm=5.0, edge_mm=3.0)
    nodes = block.mesh.points
    low, high = points.min(axis=0), points.max(axis=0)
    assert nodes[:, :2].min(axis=0) == pytest.approx(low[:2] - 5.0)
    assert nodes[:, :2].max(axis=0) == pytest.approx(high[:2] + 5.0)
    bottom = nodes[block.bottom]
    assert np.ptp(bottom[:, 2]) < 1e-9
    top = np.array([nodes[(nodes[:, :2] == xy).all(axis=1), 2].max() for xy in bottom[:, :2]])
    assert top == pytest.approx(height(bottom[:, :2]))
    assert top.min() - bottom[0, 2] == pytest.approx(12.0)
    assert block.mesh.volumes.min() > 0.0
    edges = np.linalg.norm(np.diff(nodes[block.mesh.edges], axis=1)[:, 0], axis=1)
    assert np.median(edges) < 5.0
    x = nodes[block.sides][:, :2]
    on_side = (np.abs(x - (low[:2] - 5.0)) < 1e-9) | (np.abs(x - (high[:2] + 5.0)) < 1e-9)
    assert on_side.any(axis=1).all()


def test_surfaces_that_are_not_known_are_refused() -> None:
    with pytest.raises(MeshError, match="at least 3"):
        HeightField(scattered(2))
    line = np.column_stack([np.arange(20.0), 2.0 * np.arange(20.0), np.zeros(20)])
    with pytest.raises(MeshError, match="in line"):
        HeightField(line)
    with pytest.raises(MeshError, match="choose a larger"):
        block_below(HeightField(scattered()), depth_mm=12.0, margin_mm=5.0, edge_mm=0.02)


def test_few_points_give_a_plane() -> None:
    points = scattered(6)
    points[:, 2] = 1.0 + 0.1 * points[:, 0] - 0.05 * points[:, 1]
    height = HeightField(points)
    assert height.is_plane
    assert height.error_mm < 1e-6
    inside = points[:, :2].mean(axis=0)[None]
    assert height(inside) == pytest.approx(1.0 + inside @ [0.1, -0.05], abs=1e-6)
    assert not HeightField(scattered()).is_plane
