"""Samples of the posterior of shapes: their covariance, their skewness and their limits."""

import json

import numpy as np
import pytest

from tactorch.inverse.shapes import strength
from tactorch.inverse.shapes.field import ShapeField, ShapePrior
from tactorch.inverse.shapes.posterior import ShapePosterior
from tactorch.mesh import box_mesh

PRIOR = ShapePrior.of(box_mesh(10.0, 3), 0.2)
FIELD = ShapeField(PRIOR, (False, True))


def parameters(contrast: float, field: ShapeField = FIELD) -> np.ndarray:
    """Return inclusions of 2 mm radius and one contrast."""
    parts = [np.array([np.log(0.2)])]
    for distorted in field.distorted:
        ball = [5.0, 5.0, 6.0, np.log(2.0), np.log(contrast)]
        parts.append(np.array([*ball, *[0.1] * (5 * distorted)]))
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
    """The likelihood is normal in the squared radius, and the prior in its logarithm."""
    field = ShapeField(PRIOR, (False,))
    z = parameters(0.4, field)
    index = field.parts[0].start + 3
    covariance = 1e-6 * np.eye(len(z))
    covariance[index, index] = (0.15 / field.deviation[index]) ** 2
    samples = draw(field, z, covariance, 20_000)[:, index]
    change = np.linspace(-0.5, 1.0, 30_001)[1:-1]  # of the logarithm of the radius, linearised
    rows, at = slice(index, index + 2), field.physical(z)[index : index + 2]
    line = strength.from_logs(at) + change[:, None] * strength.derivative(at)[:, 0]
    with np.errstate(invalid="ignore"):
        values = np.tile(field.physical(z), (len(change), 1))
        values[:, rows] = strength.to_logs(line)
        points = field.standard(values)
    linear = z + change[:, None] * np.eye(len(z))[index] / field.deviation[index]
    # Across the line, the likelihood is of constant width in squared radius and strength.
    with np.errstate(invalid="ignore"):
        widths = 1.0 / np.linalg.det(strength.derivative(values[:, rows]))
    priors = 0.5 * (linear**2).sum(axis=1) - 0.5 * (points**2).sum(axis=1)
    density = np.exp(-0.5 * (change / 0.15) ** 2 + priors) * widths
    density[~(np.abs(points) < 4.0).all(axis=1)] = 0.0
    bounds = np.cumsum(density) / density.sum()
    expected = np.interp([0.05, 0.5, 0.95], bounds, points[:, index])
    found = np.quantile(samples, [0.05, 0.5, 0.95])
    np.testing.assert_allclose(found, expected, atol=0.04 * np.ptp(expected))
    assert expected[1] - expected[0] > 1.4 * (expected[2] - expected[1])


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
