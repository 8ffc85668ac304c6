"""Samples of the posterior of shapes: their covariance, their skewness and their limits."""

import json

import numpy as np
import pytest

from tactorch.inverse.fields import BALL, ELLIPSOID, ShapeField, ShapePrior
from tactorch.inverse.posterior.shapes import ShapePosterior
from tactorch.mesh import box_mesh

PRIOR = ShapePrior.of(box_mesh(10.0, 3), 0.2)
FIELD = ShapeField(PRIOR, (BALL, ELLIPSOID))


def parameters(contrast: float, field: ShapeField = FIELD) -> np.ndarray:
    """Return inclusions of 2 mm radius and one contrast."""
    parts = [np.array([np.log(0.2)])]
    for family in field.families:
        ball = [5.0, 5.0, 6.0, np.log(2.0), np.log(contrast)]
        parts.append(np.array([*ball, *[0.1] * len(family.distortions)]))
    return field.standard(np.concatenate(parts))


def draw(field: ShapeField, z: np.ndarray, covariance: np.ndarray, count: int) -> np.ndarray:
    return ShapePosterior(field, z, np.zeros(len(z)), covariance).samples(count)


@pytest.mark.parametrize("contrast", [0.25, 1.0, 6.0])
def test_small_deviations_are_those_of_the_covariance(contrast):
    z, rng = parameters(contrast), np.random.default_rng(0)
    root = 2e-3 * rng.standard_normal((len(z), len(z)))
    covariance = root @ root.T
    samples = draw(FIELD, z, covariance, 20_000)
    assert samples.shape == (20_000, len(z))
    deviation = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(samples.mean(axis=0), z, atol=0.1 * deviation.max())
    scale = np.outer(deviation, deviation)
    np.testing.assert_allclose(np.cov(samples.T) / scale, covariance / scale, atol=0.05)


def test_a_radius_may_be_further_below_than_above():
    field = ShapeField(PRIOR, (BALL,))
    z = parameters(0.4, field)
    index = field.parts[0].start + 3
    covariance = 1e-6 * np.eye(len(z))
    covariance[index, index] = (0.15 / field.deviation[index]) ** 2
    radii = np.exp(field.physical(draw(field, z, covariance, 20_000))[:, index])
    low, high = np.log(np.quantile(radii, [0.05, 0.95]) / 2.0)
    assert low == pytest.approx(0.5 * np.log(1.0 - 1.645 * 0.3), abs=0.02)
    assert high == pytest.approx(0.5 * np.log(1.0 + 1.645 * 0.3), abs=0.02)


def test_impossible_radii_and_contrasts_are_left_out():
    z = parameters(6.0)
    samples = draw(FIELD, z, 0.3 * np.eye(len(z)), 500)
    assert samples.shape == (500, len(z))
    assert np.isfinite(samples).all()
    assert np.abs(samples).max() <= max(4.0, np.abs(z).max() + 0.1)
    again = draw(FIELD, z, 0.3 * np.eye(len(z)), 500)
    np.testing.assert_array_equal(samples, again)


def test_without_any_data_samples_are_those_of_the_logarithms():
    z = parameters(6.0)
    samples = draw(FIELD, z, 40.0 * np.eye(len(z)), 5_000)
    np.testing.assert_allclose(samples.std(axis=0), np.sqrt(40.0), rtol=0.05)


def test_the_step_is_to_the_optimum_of_the_linearised_model():
    z, covariance = parameters(6.0), 1e-6 * np.eye(11 + 5)
    step = 0.01 * np.random.default_rng(1).standard_normal(len(z))
    samples = ShapePosterior(FIELD, z, step, covariance).samples(20_000)
    np.testing.assert_allclose(samples.mean(axis=0), z + step, atol=5e-4)
    plain = json.loads(json.dumps(ShapePosterior(FIELD, z, step, covariance).plain()))
    np.testing.assert_array_equal(ShapePosterior.of(plain).samples(20_000), samples)
