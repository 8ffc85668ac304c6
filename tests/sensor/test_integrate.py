"""From slopes to heights: exact for what it should be, and no bow where it is told what is flat."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactorch.errors import ConfigError
from tactorch.sensor.depth import fill_masked, integrate_slopes

SIZE = (0.1, 0.08)


def grid(rows: int = 60, columns: int = 80) -> tuple[np.ndarray, np.ndarray]:
    """x and y in mm."""
    y, x = np.mgrid[:rows, :columns]
    return (x - columns / 2) * SIZE[0], (y - rows / 2) * SIZE[1]


@given(a=st.floats(-1, 1), b=st.floats(-1, 1), c=st.floats(-1, 1), d=st.floats(-1, 1))
def test_quadratics_are_exact(a: float, b: float, c: float, d: float) -> None:
    x, y = grid(12, 15)
    z = a * x + b * y + c * x * y + d * (x**2 - 0.5 * y**2)
    found = integrate_slopes(a + c * y + 2 * d * x, b + c * x - d * y, SIZE)
    np.testing.assert_allclose(found, z - z.mean(), atol=1e-9)


def dent(rows: int = 60, columns: int = 80) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A smooth dent 0.5 mm deep, and its slopes."""
    x, y = grid(rows, columns)
    z = -0.5 * np.exp(-(x**2 + y**2))
    return z, -2 * x * z, -2 * y * z


def test_the_known_plane_takes_constant_and_bow_away() -> None:
    z, slope_x, slope_y = dent()
    x, y = grid()
    flat = np.hypot(x, y) > 1.8
    bowed = slope_x + 0.03 * x, slope_y + 0.03 * y
    free, held = integrate_slopes(*bowed, SIZE), integrate_slopes(*bowed, SIZE, zero=flat)
    assert np.abs(free - z).max() > 0.2
    assert np.abs(held - z).max() < 0.05


def test_it_meets_the_known_plane_as_firmly_as_told() -> None:
    _, slope_x, slope_y = dent()
    x, y = grid()
    flat = np.hypot(x, y) > 1.8
    firm = integrate_slopes(slope_x + 0.05, slope_y, SIZE, zero=flat, zero_deviation_mm=1e-4)
    loose = integrate_slopes(slope_x + 0.05, slope_y, SIZE, zero=flat, zero_deviation_mm=1.0)
    assert np.abs(firm[flat]).mean() < 0.05 * np.abs(loose[flat]).mean()


def test_what_markers_hide_is_filled_in_smoothly() -> None:
    x, y = grid()
    field = 0.3 * x - 0.2 * y + 0.1 * x * y  # harmonic: its own smoothest filling
    known = np.ones(field.shape, dtype=bool)
    known[10:16, 20:27] = known[40:46, :5] = known[33, 50] = False
    damaged = np.where(known, field, 99.0)
    found = fill_masked(damaged, known)
    np.testing.assert_array_equal(found[known], field[known])
    inner = np.zeros_like(known)
    inner[10:16, 20:27] = inner[33, 50] = True
    np.testing.assert_allclose(found[inner], field[inner], atol=1e-9)
    assert np.abs(found - field).max() < 0.3  # at the edge, which is free


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"slope_x": np.full((6, 7), np.nan)}, "not finite"),
        ({"mm_per_px": (0.0, 0.1)}, "mm_per_px"),
        ({"zero_deviation_mm": 0.0, "zero": np.ones((6, 7), dtype=bool)}, "zero_deviation_mm"),
    ],
)
def test_wrong_slopes_are_refused(changes: dict, message: str) -> None:
    settings = {"slope_x": np.zeros((6, 7)), "slope_y": np.zeros((6, 7)), "mm_per_px": SIZE}
    with pytest.raises(ConfigError, match=message):
        integrate_slopes(**{**settings, **changes})


def test_nothing_known_is_refused() -> None:
    with pytest.raises(ConfigError, match="no pixel is known"):
        fill_masked(np.zeros((4, 4)), np.zeros((4, 4), dtype=bool))
