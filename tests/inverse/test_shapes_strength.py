"""Squared radius and strength of inclusions: inverse, derivative, and steps that are straight."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactorch.inverse.fields import BALL, ELLIPSOID, ShapeField, ShapePrior, strength
from tactorch.mesh import box_mesh

LOGS = st.tuples(st.floats(-2.0, 4.0), st.floats(-4.0, 4.0)).map(np.array)


@given(LOGS)
def test_logarithms_return(logs):
    np.testing.assert_allclose(strength.to_logs(strength.from_logs(logs)), logs, atol=1e-9)


@given(LOGS)
def test_the_derivative_is_that_of_differences(logs):
    step = 1e-6 * np.eye(2)
    ends = [strength.from_logs(logs + s) - strength.from_logs(logs - s) for s in step]
    differences = np.stack(ends, axis=1) / 2e-6
    scale = np.exp(3.0 * logs[0]) + np.exp(2.0 * logs[0])
    np.testing.assert_allclose(strength.derivative(logs) / scale, differences / scale, atol=1e-7)


def test_there_is_no_contrast_beyond_that_of_a_hole_and_of_a_rigid_ball():
    radius = np.full(2, 4.0)
    assert np.isnan(strength.to_logs(np.column_stack([radius, [8.1, -5.4]]))[:, 1]).all()
    assert np.isfinite(strength.to_logs(np.column_stack([radius, [7.9, -5.3]]))).all()


@given(LOGS, st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0)).map(np.array))
def test_steps_are_those_of_the_logarithms_to_first_order(logs, step):
    moved = strength.moved(logs, 1e-5 * step)
    np.testing.assert_allclose((moved - logs) / 1e-5, step, atol=1e-3)
    far = strength.moved(logs, 10.0 * step) - logs
    assert np.isfinite(far).all()
    assert np.abs(far).max() < 0.75


def test_a_step_of_a_field_keeps_the_other_parameters():
    field = ShapeField(ShapePrior.of(box_mesh(10.0, 3), 0.2), (BALL, ELLIPSOID))
    rng = np.random.default_rng(0)
    z, step = 0.3 * rng.standard_normal((2, field.size))
    moved, logs = field.moved(z, 0.6 * step), [4, 5, 9, 10]
    others = np.setdiff1d(np.arange(field.size), logs)
    np.testing.assert_allclose(moved[others], (z + 0.6 * step)[others])
    change = strength.from_logs(field.physical(moved)[logs].reshape(2, 2))
    before = strength.from_logs(field.physical(z)[logs].reshape(2, 2))
    slopes = [strength.derivative(pair) for pair in field.physical(z)[logs].reshape(2, 2)]
    steps = (field.deviation * 0.6 * step)[logs].reshape(2, 2)
    expected = [slope @ pair for slope, pair in zip(slopes, steps, strict=True)]
    assert np.abs(moved[logs] - (z + 0.6 * step)[logs]).max() > 1e-3
    np.testing.assert_allclose(change - before, expected, rtol=1e-6)


@pytest.mark.parametrize("contrast", [0.2, 6.0])
def test_a_straight_step_follows_the_valley(contrast):
    """The strength remains, where a step of the logarithms changes it."""
    logs = np.log([2.0, contrast])
    step = np.linalg.solve(strength.derivative(logs), [-0.5, 0.0])
    moved = strength.moved(logs, step)
    assert strength.from_logs(moved)[1] == pytest.approx(strength.from_logs(logs)[1], rel=1e-9)
    straight = strength.from_logs(logs + step)[1]
    assert abs(straight / strength.from_logs(logs)[1] - 1.0) > 0.01
