"""One colour scale for all panels of a picture."""

import numpy as np
from matplotlib.colors import LogNorm, Normalize

from tactorch.errors import ConfigError

# Lone elements above this multiple of nearly all others do not stretch the colour scale.
_OUTLIER = 4.0


def colour_scale(
    maps: dict[str, np.ndarray], scale: str, limits: tuple[float, float] | None
) -> Normalize:
    """Choose the colours' range for a reconstruction and, where known, its truth.

    Args:
        maps: Moduli, MPa, under the names "reconstruction" and "truth".
        scale: "linear" or "log".
        limits: Ends of the range, MPa; by the values when None.

    Raises:
        ConfigError: An unknown scale, or limits that it cannot show.
    """
    if scale not in ("linear", "log"):
        raise ConfigError(f"scale '{scale}' is not known; choose linear or log.")
    low, high = limits if limits is not None else _limits(maps, scale)
    if not low < high:
        raise ConfigError(f"limits_mpa ({low}, {high}): the first must be less than the second.")
    if scale == "linear":
        return Normalize(low, high)
    if low <= 0:
        raise ConfigError(f"scale 'log' needs moduli above zero, but the lowest is {low} MPa.")
    return LogNorm(low, high)


def _limits(maps: dict[str, np.ndarray], scale: str) -> tuple[float, float]:
    """Span the truth and nearly all of the reconstruction."""
    values = maps["reconstruction"]
    high = min(float(values.max()), _OUTLIER * float(np.percentile(values, 99.5)))
    low = float(values.min())
    if low > 0:
        low = max(low, float(np.percentile(values, 0.5)) / _OUTLIER)
    if "truth" in maps:
        high = max(float(np.percentile(values, 99.5)), float(maps["truth"].max()))
        low = min(float(np.percentile(values, 0.5)), float(maps["truth"].min()))
    if scale == "linear":
        low = min(low, 0.0)
    return (low, high) if high > low else (0.5 * low, 1.5 * low or 1.0)
