"""Ridges of inclusions of uncertain radius and contrast, on models whose posterior is known."""

import json
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactorch.inverse.fields import BALL, ShapeField, ShapePrior, strength
from tactorch.inverse.posterior.ridges import Ridge, RidgePoint, basis_across
from tactorch.inverse.posterior.shapes import ShapePosterior
from tactorch.inverse.result.shapes import ShapeReconstruction
from tactorch.mesh import box_mesh

PRIOR = ShapePrior.of(box_mesh(10.0, 3), 0.2)
FIELD = ShapeField(PRIOR, (BALL,))
CENTER = [np.log(0.2), 5.0, 5.0, 6.0]


class FarField:
    """Data linear in the squared radius and strength of a ball, and in its other parameters.

    Args:
        radius, contrast: Those of the ball without noise.
        errors: Deviations of squared radius (mm^2) and strength (mm^3).
    """

    def __init__(self, radius: float, contrast: float, errors: tuple[float, float]) -> None:
        self._best = self._linear(np.array([*CENTER, np.log(radius), np.log(contrast)]))
        self._scale = np.array([0.01, 0.05, 0.05, 0.05, *errors])
        sign = 1.0 if contrast > 1.0 else -1.0
        self.direction = np.array([0.0, 0.0, 0.0, 0.0, 1.0, -sign]) / np.sqrt(2.0)

    @staticmethod
    def _linear(values: np.ndarray) -> np.ndarray:
        linear = values.copy()
        linear[..., 4:6] = strength.from_logs(values[..., 4:6])
        # A correlation of the depth with the strength.
        linear[..., 3] += 0.05 * linear[..., 5]
        return linear

    def residuals(self, z: np.ndarray) -> np.ndarray:
        return (self._linear(FIELD.physical(z)) - self._best) / self._scale

    def jacobian(self, z: np.ndarray) -> np.ndarray:
        steps = 1e-5 * np.eye(6)
        return ((self.residuals(z + steps) - self.residuals(z - steps)) / 2e-5).T

    def point(self, z: np.ndarray) -> RidgePoint:
        return RidgePoint.of(z, self.residuals(z), self.jacobian(z), self.direction)

    def fitted(self, z: np.ndarray, *, held: bool) -> np.ndarray:
        """Return the optimum from a start, with t held or not."""
        basis = basis_across(self.direction) if held else np.eye(6)
        for _ in range(50):
            columns = self.jacobian(z) @ basis
            gradient = columns.T @ self.residuals(z) + basis.T @ z
            hessian = columns.T @ columns + np.eye(basis.shape[1])
            z = z - 0.5 * basis @ np.linalg.solve(hessian, gradient)
        return z

    def posterior(
        self, rise: float = 2.0, sides: tuple[float, ...] = (-1.0, 1.0)
    ) -> ShapePosterior:
        """Return the posterior about the ridge that is followed from the best fit."""
        best = self.fitted(self._start(), held=False)
        start, others = self.point(best), []
        for sign in sides:
            point = start
            while point.height - start.height < 3.0:
                step = point.step(sign, 2.0, 0.6)
                z = self.fitted(point.z + step, held=True)
                if np.abs(z).max() > 3.9:
                    break
                point = self.point(z)
                others.append(point)
        ridge = Ridge.through(start, others, 0, self.direction)
        jacobian = self.jacobian(best)
        covariance = np.linalg.inv(jacobian.T @ jacobian + np.eye(6))
        return ShapePosterior(FIELD, best, np.zeros(6), covariance, (ridge,))

    def _start(self) -> np.ndarray:
        values = self._best.copy()
        values[3] -= 0.05 * values[5]
        values[4:6] = strength.to_logs(values[4:6])
        return FIELD.standard(values)

    def exact(self, levels: list[float]) -> tuple[np.ndarray, np.ndarray]:
        """Return quantiles of log-radius and log-contrast with Jeffreys' prior, by a grid.

        Background and centre are normal given radius and contrast.
        """
        radius, contrast = np.linspace(-1.5, 1.5, 101), np.linspace(-4.0, 4.0, 201)
        points = np.array(list(product(radius, contrast)))
        z = np.column_stack([np.tile(self._start()[:4], (len(points), 1)), points])
        near = z[:, None] + 1e-5 * np.stack([np.eye(6), -np.eye(6)])[:, None]
        ends = self.residuals(near.reshape(-1, 6)).reshape(near.shape)
        columns, residuals = (ends[0] - ends[1]).mT / 2e-5, self.residuals(z)
        hessian = columns.mT @ columns + np.eye(6)
        gradient = np.einsum("nij,ni->nj", columns, residuals) + z
        step = np.linalg.solve(hessian[:, :4, :4], gradient[:, :4, None])[..., 0]
        height = 0.5 * ((residuals**2 + z**2).sum(axis=1) - (gradient[:, :4] * step).sum(axis=1))
        determinants = [np.linalg.slogdet(h)[1] for h in (hessian, hessian[:, :4, :4])]
        logs = -height + 0.5 * (determinants[0] - determinants[1])
        density = np.exp(logs - logs.max()).reshape(len(radius), len(contrast))
        found = []
        for grid, mass in ((radius, density.sum(axis=1)), (contrast, density.sum(axis=0))):
            found.append(np.interp(levels, (np.cumsum(mass) - 0.5 * mass) / mass.sum(), grid))
        return found[0], found[1]


LEVELS = [0.05, 0.5, 0.95]
STIFF = FarField(1.7, 6.0, (0.6, 0.3))


@pytest.mark.parametrize(
    "model",
    [
        FarField(2.0, 2.0, (0.4, 0.1)),  # nearly normal
        STIFF,  # the contrast saturates
        FarField(2.5, 0.3, (1.5, 0.5)),  # soft
    ],
)
def test_samples_are_those_of_the_posterior_with_jeffreys_prior(model):
    samples = model.posterior().samples(4_000)
    for quantiles, values in zip(model.exact(LEVELS), samples[:, 4:6].T, strict=True):
        width = quantiles[2] - quantiles[0]
        np.testing.assert_allclose(np.quantile(values, LEVELS), quantiles, atol=0.04 * width)


def test_the_normal_posterior_has_too_wide_an_interval_where_the_contrast_saturates():
    posterior = STIFF.posterior()
    normal = replace(posterior, ridges=()).samples(4_000)
    _, exact = STIFF.exact(LEVELS)
    assert np.quantile(normal[:, 5], 0.95) > exact[2] + 0.12 * (exact[2] - exact[0])


def test_a_ridge_of_a_linear_model_is_the_normal_posterior():
    rng = np.random.default_rng(3)
    jacobian, offset = 3.0 * rng.standard_normal((20, 6)), rng.standard_normal(20)
    hessian = jacobian.T @ jacobian + np.eye(6)
    best = -np.linalg.solve(hessian, jacobian.T @ offset)
    direction = STIFF.direction
    # The points are found from parameters beside the ridge.
    points = [
        RidgePoint.of(z, jacobian @ z + offset, jacobian, direction)
        for z in best + 0.3 * np.arange(-2, 3)[:, None] * direction + 0.1 * rng.random((5, 6))
    ]
    ridge = Ridge.through(points[1], [points[0], *points[2:]], 0, direction)
    covariance = np.linalg.inv(hessian)
    deviation = np.sqrt(direction @ covariance @ direction)
    heights = [0.5 * ((t - best @ direction) / deviation) ** 2 for t in ridge.t]
    lowest = 0.5 * (np.sum((jacobian @ best + offset) ** 2) + best @ best)
    np.testing.assert_allclose([p.height - lowest for p in ridge.points], heights, atol=1e-10)
    slopes = (ridge.t - best @ direction) / deviation**2
    np.testing.assert_allclose([p.slope for p in ridge.points], slopes, atol=1e-9)
    draws = rng.multivariate_normal(best, covariance, 200)
    # Within the points the samples remain; beyond them the slope is at least 0.5.
    inside = np.abs(draws @ direction - ridge.t.mean()) < 0.5 * np.ptp(ridge.t)
    assert inside.sum() > 150
    np.testing.assert_allclose(ridge.transported(draws)[inside], draws[inside], atol=2e-3)


def test_the_point_of_linearisation_needs_not_be_the_best():
    """A normal posterior that is linearised off the optimum, with its step to it."""
    posterior = STIFF.posterior()
    (ridge,) = posterior.ridges
    other = replace(ridge, start=ridge.start + 1)
    point = other.points[other.start]
    jacobian, residuals = STIFF.jacobian(point.z), STIFF.residuals(point.z)
    covariance = np.linalg.inv(jacobian.T @ jacobian + np.eye(6))
    step = -covariance @ (jacobian.T @ residuals + point.z)
    moved = ShapePosterior(FIELD, point.z, step, covariance, (other,))
    expected = np.quantile(posterior.samples(4_000)[:, 5], LEVELS)
    found = np.quantile(moved.samples(4_000)[:, 5], LEVELS)
    np.testing.assert_allclose(found, expected, atol=0.05 * np.ptp(expected))


def test_one_point_is_the_normal_distribution_of_the_logarithms():
    posterior = STIFF.posterior(sides=())
    samples = posterior.samples(4_000)
    deviation = np.sqrt(np.diag(posterior.covariance))
    np.testing.assert_allclose(samples[:, 5].mean(), posterior.z[5], atol=0.1 * deviation[5])
    np.testing.assert_allclose(samples[:, 5].std(), deviation[5], rtol=0.1)


@given(
    st.floats(0.8, 3.0),
    st.floats(1.5, 25.0),
    st.booleans(),
    st.tuples(st.floats(0.05, 1.5), st.floats(0.03, 0.6)),
    st.booleans(),
)
@pytest.mark.slow
def test_estimates_are_within_their_intervals(radius, ratio, soft, errors, has_ridge):
    """Also where the best fit is elsewhere, as that of a ball beside those of ellipsoids."""
    posterior = FarField(radius, 1.0 / ratio if soft else ratio, errors).posterior()
    if not has_ridge:
        posterior = replace(posterior, ridges=())
    best = posterior.z + np.array([0.0, 0.0, 0.0, 0.0, -1.0, 1.0])
    result = ShapeReconstruction(FIELD, best, posterior, 1.0, (9.0,), 9.0)
    (found,) = result.inclusions
    estimates = found.shape.radius_mm, found.youngs_mpa, found.shape.contrast
    intervals = found.radius_90_mm, found.youngs_90_mpa, found.contrast_90
    for value, interval in zip(estimates, intervals, strict=True):
        assert interval.low <= value <= interval.high


def test_samples_are_within_the_limits_of_the_prior():
    samples = FarField(1.5, 25.0, (0.3, 0.3)).posterior().samples(2_000)
    assert np.abs(samples).max() < 4.0
    assert samples[:, 5].max() > 3.0


def test_plain_values_are_inverted():
    posterior = STIFF.posterior()
    again = ShapePosterior.of(json.loads(json.dumps(posterior.plain())))
    np.testing.assert_array_equal(again.samples(500), posterior.samples(500))
    without = {name: value for name, value in posterior.plain().items() if name != "ridges"}
    assert ShapePosterior.of(without).ridges == ()


def embedded(ridge: Ridge, rows: np.ndarray, best: np.ndarray, rest: np.ndarray) -> Ridge:
    """Return a ridge of some of the parameters, where the others are independent of them.

    Args:
        ridge: The ridge of the parameters `rows`.
        rows: Numbers of its parameters.
        best: The most probable parameters, all of them.
        rest: Covariance of all parameters, of which that of the others is used.
    """
    direction = np.zeros(len(best))
    direction[rows] = ridge.direction
    basis, own = basis_across(direction), basis_across(ridge.direction)
    points = []
    for point in ridge.points:
        z, along, covariance = best.copy(), np.zeros(len(best)), rest.copy()
        z[rows], along[rows] = point.z, point.along
        covariance[rows] = covariance[:, rows] = 0.0
        covariance[np.ix_(rows, rows)] = own @ point.root @ point.root.T @ own.T
        root = np.linalg.cholesky(basis.T @ covariance @ basis)
        points.append(replace(point, z=z, along=along, root=root))
    return replace(ridge, direction=direction, points=tuple(points))


def test_two_inclusions_have_a_ridge_each():
    """The samples of each are those that it has alone, up to the background that they share."""
    one, two = STIFF.posterior(), FarField(2.5, 0.3, (1.5, 0.5)).posterior()
    field = ShapeField(PRIOR, (BALL, BALL))
    first, second = np.arange(6), np.arange(6, 11)
    best, covariance = np.r_[one.z, two.z[1:]], np.zeros((11, 11))
    covariance[:6, :6], covariance[6:, 6:] = one.covariance, two.covariance[1:, 1:]
    (ridge,), (other,) = one.ridges, two.ridges
    cut = [
        replace(p, z=p.z[1:], along=p.along[1:], root=without_first(p, other.direction))
        for p in other.points
    ]
    other = replace(other, direction=other.direction[1:], points=tuple(cut))
    ridges = tuple(
        embedded(each, rows, best, covariance) for each, rows in ((ridge, first), (other, second))
    )
    samples = ShapePosterior(field, best, np.zeros(11), covariance, ridges).samples(4_000)
    for alone, rows in ((one, first[4:]), (two, second[3:])):
        expected = np.quantile(alone.samples(4_000)[:, 4:6], LEVELS, axis=0)
        found = np.quantile(samples[:, rows], LEVELS, axis=0)
        assert (np.abs(found - expected) < 0.06 * np.ptp(expected, axis=0)).all()


def without_first(point: RidgePoint, direction: np.ndarray) -> np.ndarray:
    """Return the factor of the covariance without the first parameter, the background."""
    basis, fewer = basis_across(direction), basis_across(direction[1:])
    covariance = basis @ point.root @ point.root.T @ basis.T
    return np.linalg.cholesky(fewer.T @ covariance[1:, 1:] @ fewer)
