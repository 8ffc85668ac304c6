"""Smooth errors of the forces of a palpation, and rods of the matched filter."""

from dataclasses import replace

import numpy as np
import pytest

from tactorch.inverse.data.plain import to_plain, with_arrays
from tactorch.inverse.errors.smooth_forces import (
    border_distances,
    correlation_length,
    smooth_error_patterns,
)
from tactorch.inverse.fields import BALL, ELLIPSOID, Candidate, ShapeField, ShapePrior
from tactorch.inverse.fit.shapes import ShapeFit
from tactorch.inverse.search.matched import Balls
from tactorch.inverse.search.model import with_ball
from tactorch.mesh import box_mesh


def places(width: float = 40.0, length: float = 90.0) -> np.ndarray:
    axes = np.arange(1.0, width, 2.0), np.arange(1.0, length, 2.0)
    flat = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    return np.column_stack([flat, np.full(len(flat), 5.0)])


def test_the_correlation_length_is_a_quarter_of_the_palpated_size() -> None:
    assert correlation_length(places()) == pytest.approx(0.25 * np.sqrt(40.0 * 90.0), rel=0.01)
    one = np.array([[1.0, 2.0, 3.0]])
    assert correlation_length(one) == 1.0
    line = np.column_stack([np.arange(50.0), np.zeros((50, 2))])
    assert 0.0 < correlation_length(line) < 10.0


def test_the_covariance_is_that_of_a_smooth_factor_and_its_slope_with_depth() -> None:
    points = places()
    of, depths = np.repeat(np.arange(len(points)), 2), np.tile([1.0, 3.0], len(points))
    forces = np.tile([2.0, 5.0], len(points))
    patterns = smooth_error_patterns(points, of, depths, forces, border_mm=6.0)
    covariance = patterns @ patterns.T
    length, border = correlation_length(points), border_distances(points)
    near = np.exp(-0.5 * (border / 6.0) ** 2)
    for i, j in ((0, 0), (0, 3), (1, 200), (8, 901), (900, 900), (900, 905)):
        apart = np.linalg.norm(points[of[i]] - points[of[j]])
        smooth = np.exp(-0.5 * (apart / length) ** 2)
        slopes, borders = (depths[[i, j]] / 2.0 - 1.0).prod(), near[of[[i, j]]].prod()
        expected = forces[i] * forces[j] * smooth * (1.0 + slopes + borders)
        assert covariance[i, j] == pytest.approx(expected, abs=0.3 * forces[i] * forces[j])
    assert patterns.shape[1] < 0.15 * len(points)
    # The mean factor over the places is the modulus, and no error.
    assert patterns[::2, : patterns.shape[1] // 3].sum(axis=0) == pytest.approx(0.0, abs=1e-8)


def test_distances_are_from_the_border_of_the_palpated_area() -> None:
    points = places()
    points = points[~((points[:, 0] < 20.0) & (points[:, 1] > 60.0))]  # an area that is not convex
    expected = np.minimum.reduce([
        points[:, 0] - 1.0, 39.0 - points[:, 0], points[:, 1] - 1.0, 89.0 - points[:, 1],
        np.hypot(np.maximum(points[:, 0] - 19.0, 0.0), np.maximum(61.0 - points[:, 1], 0.0)),
    ])  # fmt: skip
    assert np.abs(border_distances(points) - expected).max() < 3.0
    assert border_distances(points)[expected > 6.0].min() > 3.0
    assert not border_distances(points[:5]).any()


def test_rods_of_the_matched_filter_have_their_volume() -> None:
    mesh = box_mesh((60.0, 40.0, 20.0), (18, 12, 6), tets_per_cell=5)
    low, high = mesh.points.min(axis=0), mesh.points.max(axis=0)
    size, halves, checked = float(np.cbrt(60.0 * 40.0 * 20.0)), set(), 0
    for rods in Balls.rods(mesh, lambda points: np.ones(len(points), dtype=bool)):
        assert np.ptp(rods.halves, axis=0).max(initial=0.0) == 0.0
        assert np.abs(rods.halves[:, 2]).max(initial=0.0) < 1e-12  # along the two longest sides
        halves |= set(np.round(np.linalg.norm(rods.halves, axis=1) / size, 3).tolist())
        volumes = rods.fractions.T @ mesh.volumes
        for center, radius, half, volume in zip(
            rods.centers, rods.radii, rods.halves, volumes, strict=True
        ):
            reach = np.abs(half) + 1.3 * radius
            if (center - reach > low).all() and (center + reach < high).all():
                length = 2.0 * np.linalg.norm(half) + 4.0 / 3.0 * radius
                assert volume == pytest.approx(np.pi * radius**2 * length, rel=0.15)
                checked += 1
    assert halves == {0.2, 0.4}
    assert checked > 5


def test_a_rod_starts_as_an_ellipsoid_of_its_length_and_width() -> None:
    mesh = box_mesh((60.0, 40.0, 20.0), (6, 4, 2), tets_per_cell=5)
    field = ShapeField(ShapePrior.of(mesh, 0.1))
    zeros = np.zeros(1)
    fit = ShapeFit(zeros, 0.0, field, zeros, np.eye(1), np.zeros((1, 1)), zeros)
    half = 15.0 * np.array([0.6, 0.8, 0.0])
    what, longer, z = with_ball(fit, Candidate(np.array([3.0, 2.0, 1.0]), 3.0, 0.8, 50.0, half))
    assert what == "rod at [3.0, 2.0, 1.0] mm"
    assert longer.families == (ELLIPSOID,)
    (shape,) = longer.shapes(z)
    assert shape.semi_axes_mm == pytest.approx((18.0, 3.0, 3.0))
    assert abs(np.array(shape.axes[0]) @ half) == pytest.approx(15.0)
    assert shape.contrast == pytest.approx(np.exp(0.8))


def test_inclusions_are_kept_in_the_object() -> None:
    mesh = box_mesh((60.0, 40.0, 20.0), (6, 4, 2), tets_per_cell=5)
    low, high = mesh.bounds
    prior = ShapePrior.of(mesh, 0.1)
    assert prior.outside_mm == pytest.approx(0.1 * np.cbrt(60.0 * 40.0 * 20.0))
    prior = replace(prior, outside_mm=2.0)
    field = ShapeField(prior, (ELLIPSOID, BALL))
    # An ellipsoid of 14 x 3.5 x 3.5 mm along z, 1 mm above the middle, and a ball that touches y+.
    middle = 0.5 * (low + high)
    rod = [*middle[:2], middle[2] + 1.0]
    stretch = np.diag(np.log([3.5, 3.5, 14.0]))
    ball = [middle[0], high[1] - 5.0, middle[2], np.log(5.0), 1.0]
    values = np.array([np.log(0.1), *ELLIPSOID.values(np.array(rod), stretch, 1.0), *ball])
    z = field.standard(values)
    excess = field.excess(z).reshape(2, 2, 3)
    np.testing.assert_allclose(excess[0, 0], [0.0, 0.0, 2.5], atol=1e-9)  # (1 + 14 - 10) / 2
    np.testing.assert_allclose(excess[0, 1], [0.0, 0.0, 1.5], atol=1e-9)
    np.testing.assert_allclose(excess[1], 0.0, atol=1e-6)
    assert field.penalty(z) == pytest.approx(0.5 * (z @ z + 2.5**2 + 1.5**2))
    step = 1e-3 * np.eye(field.size)[3]
    slope = field.excess_jacobian(z)[:, 3].reshape(2, 2, 3)
    quotient = (field.excess(z + step) - field.excess(z)).reshape(2, 2, 3) / 1e-3
    np.testing.assert_allclose(slope[0, :, 2], quotient[0, :, 2], rtol=1e-5)
    free = ShapeField(replace(prior, outside_mm=None), (ELLIPSOID, BALL))
    assert len(free.excess(z)) == 0
    assert free.excess_jacobian(z).shape == (0, field.size)
    assert ShapePrior(**with_arrays(to_plain(prior))).outside_mm == 2.0
