import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from tactorch.errors import ConfigError, MeshError
from tactorch.metrics import normalised_correlation, pearson, psnr, rmse_mpa, ssim_1d

TRUTH = np.array([1.0, 2.0, 3.0, 4.0])
POSITIVE = hnp.arrays(np.float64, 7, elements=st.floats(0.01, 10), unique=True)


def test_rmse() -> None:
    assert rmse_mpa(TRUTH, TRUTH) == 0
    # Errors 1, 1, 1, 3: the mean square is 12 / 4.
    assert rmse_mpa(np.array([2.0, 1.0, 4.0, 1.0]), TRUTH) == pytest.approx(math.sqrt(3))


def test_pearson() -> None:
    assert pearson(2 * TRUTH + 5, TRUTH) == pytest.approx(1)
    assert pearson(TRUTH[::-1].copy(), TRUTH) == pytest.approx(-1)
    # Deviations (-.5, -.5, .5, .5) and (-1.5, -.5, .5, 1.5): 2 / sqrt(1 * 5).
    assert pearson(np.array([1.0, 1.0, 2.0, 2.0]), TRUTH) == pytest.approx(2 / math.sqrt(5))


def test_normalised_correlation_is_the_magnitude() -> None:
    falling = np.array([2.0, 2.0, 1.0, 1.0])
    assert pearson(falling, TRUTH) == pytest.approx(-2 / math.sqrt(5))
    assert normalised_correlation(falling, TRUTH) == pytest.approx(2 / math.sqrt(5))


@given(POSITIVE, POSITIVE, st.floats(0.1, 10))
def test_correlation_ignores_scale(a: np.ndarray, b: np.ndarray, scale: float) -> None:
    assert pearson(scale * a, b) == pytest.approx(pearson(a, b), abs=1e-9)
    assert -1 <= pearson(a, b) <= 1


def test_correlation_with_a_constant_is_nan() -> None:
    # 0.1 three times has a mean that is not 0.1 to the last bit.
    constant = np.full(3, 0.1)
    assert math.isnan(pearson(constant, np.array([1.0, 2.0, 3.0])))
    assert math.isnan(normalised_correlation(np.array([1.0, 2.0, 3.0]), constant))


def test_psnr() -> None:
    off = TRUTH + 0.1
    assert psnr(off, TRUTH) == pytest.approx(20)
    assert psnr(off, TRUTH, range_mpa=10.0) == pytest.approx(40)
    assert psnr(off, TRUTH, range_mpa="truth") == pytest.approx(20 * math.log10(30))
    assert psnr(TRUTH, TRUTH) == math.inf


def test_ssim_1d_of_one_window() -> None:
    """A window of the whole list has one centre, so SSIM is the formula itself."""
    found = np.array([1.0, 2.0, 4.0])
    truth = np.array([1.0, 3.0, 5.0])
    c1, c2 = 0.04**2, 0.12**2  # (0.01 R)^2 and (0.03 R)^2 with R = 4
    mean_f, mean_t = found.mean(), truth.mean()
    covariance = np.cov(found, truth)
    expected = (
        (2 * mean_f * mean_t + c1)
        * (2 * covariance[0, 1] + c2)
        / ((mean_f**2 + mean_t**2 + c1) * (covariance[0, 0] + covariance[1, 1] + c2))
    )
    assert ssim_1d(found, truth, window=3) == pytest.approx(expected)
    assert ssim_1d(found, truth, window=3, range_mpa=8.0) > expected


@pytest.mark.parametrize("window", [2, 1, 5])
def test_ssim_1d_refuses_windows(window: int) -> None:
    with pytest.raises(ConfigError, match=f"window is {window}"):
        ssim_1d(TRUTH, TRUTH, window=window)


@pytest.mark.parametrize("range_mpa", [0.0, -1.0, math.nan, "truth"])
def test_refuses_ranges(range_mpa: float) -> None:
    flat = np.ones(4)
    for metric in (psnr, lambda *a, **k: ssim_1d(*a, window=3, **k)):
        with pytest.raises(ConfigError, match="range_mpa is"):
            metric(TRUTH, flat, range_mpa=range_mpa)


@pytest.mark.parametrize("metric", [rmse_mpa, pearson, normalised_correlation, psnr, ssim_1d])
def test_refuses_what_is_no_modulus(metric: Callable[..., float]) -> None:
    for wrong in (np.nan, 0.0, -1.0, np.inf):
        with pytest.raises(MeshError, match=f"youngs is {wrong} at element 2"):
            metric(np.array([1.0, 1.0, wrong, 1.0]), TRUTH)
    with pytest.raises(MeshError, match="truth is nan at element 0"):
        metric(TRUTH, np.full(4, np.nan))
    with pytest.raises(MeshError, match=r"youngs has shape \(0,\)"):
        metric(np.zeros(0), np.zeros(0))
