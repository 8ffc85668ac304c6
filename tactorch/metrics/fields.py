"""Metrics over the list of elements: each element counts once, regardless of its volume.

The paper (section IV-A, Metrics) and its authors count so too. The scores published with their
cases (RMSE, SSIM, PSNR, "Cosine Similarity") are reproduced to all six digits by `rmse_mpa`,
`ssim_1d(..., range_mpa=R)`, `psnr(..., range_mpa=R)` and `pearson`, where R is 1.499 MPa for
box-3 and 3.999 MPa for box-torus: a fixed scale of 0.001 to 1.5 (4.0) MPa, slightly wider than
the range of the true moduli. With `range_mpa="truth"` both differ in the second digit. Table II
of the paper has a range of 1 MPa, the default here.
"""

from typing import Literal

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError
from tactorch.metrics.checks import check_pair

Range = float | Literal["truth"]


def rmse_mpa(youngs: Float[np.ndarray, " m"], truth: Float[np.ndarray, " m"]) -> float:
    """Return the root mean square error over the elements, MPa."""
    check_pair(youngs, truth)
    return float(np.sqrt(np.mean((youngs - truth) ** 2)))


def pearson(youngs: Float[np.ndarray, " m"], truth: Float[np.ndarray, " m"]) -> float:
    """Return Pearson's correlation over the elements, -1 to 1; NaN if a field is constant.

    It is invariant under scaling and shift. The authors call it cosine similarity.
    """
    check_pair(youngs, truth)
    a, b = _centred(youngs), _centred(truth)
    length = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(np.clip(a @ b / length, -1.0, 1.0)) if length > 0 else float("nan")


def normalised_correlation(
    youngs: Float[np.ndarray, " m"], truth: Float[np.ndarray, " m"]
) -> float:
    """Return the normalised correlation s (section IV-A), 0 to 1; NaN if a field is constant.

    s = |<e_gt - mean e_gt, e - mean e>| / (||e_gt - mean e_gt|| ||e - mean e||), the magnitude of
    Pearson's correlation: a map with hard and soft exchanged scores as high as the correct one.
    """
    return abs(pearson(youngs, truth))


def psnr(
    youngs: Float[np.ndarray, " m"],
    truth: Float[np.ndarray, " m"],
    range_mpa: Range = 1.0,
) -> float:
    """Return the peak signal-to-noise ratio 20 log10(range / RMSE), dB; infinite if RMSE is 0.

    Args:
        youngs: Moduli, (m,), MPa.
        truth: True moduli, (m,), MPa.
        range_mpa: Range of the data, MPa (1 in Table II), or "truth" for max - min of the truth.

    Raises:
        ConfigError: The range is not above 0.
    """
    check_pair(youngs, truth)
    peak = _range(range_mpa, truth)
    error = rmse_mpa(youngs, truth)
    return float(20 * np.log10(peak / error)) if error > 0 else float("inf")


def ssim_1d(
    youngs: Float[np.ndarray, " m"],
    truth: Float[np.ndarray, " m"],
    window: int = 401,
    range_mpa: Range = "truth",
) -> float:
    """Return the structural similarity of the two lists of elements, as the paper's authors do.

    The window slides over elements in mesh order, which has no spatial meaning: use it only to
    compare with the published numbers, and `tactorch.metrics.ssim` otherwise.

    Args:
        youngs: Moduli, (m,), MPa.
        truth: True moduli, (m,), MPa.
        window: Length of the window, odd and at most m.
        range_mpa: Range of the data, MPa, or "truth" for max - min of the truth.

    Raises:
        ConfigError: The window does not fit, or the range is not above 0.
    """
    from skimage.metrics import structural_similarity

    check_pair(youngs, truth)
    if window % 2 == 0 or not 3 <= window <= len(truth):
        raise ConfigError(
            f"window is {window}; it must be odd, and from 3 to the {len(truth)} elements"
        )
    peak = _range(range_mpa, truth)
    return float(structural_similarity(youngs, truth, win_size=window, data_range=peak))


def _range(range_mpa: Range, truth: Float[np.ndarray, " m"]) -> float:
    peak = float(np.ptp(truth)) if range_mpa == "truth" else float(range_mpa)
    if not (np.isfinite(peak) and peak > 0):
        raise ConfigError(
            f"range_mpa is {range_mpa!r}, that is {peak:g} MPa; give a range above 0 "
            "(a homogeneous truth has none)"
        )
    return peak


def _centred(values: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
    """Remove the mean; the round-off that is left of a constant field is set to zero."""
    centred = values - values.mean()
    return centred if np.ptp(values) > 1e-12 * np.abs(values).max() else np.zeros_like(values)
