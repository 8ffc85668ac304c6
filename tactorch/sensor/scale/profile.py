"""Where, on a profile of change across an edge, the face that is pressed ends.

Beside a flat punch the gel's slope jumps, or even grows beyond all bounds and falls off with the
square root of the distance (Boussinesq, 1885), as soft and thick layers do. Camera and smoothing
blur either, and where a blurred profile rises most is then no edge but up to a pixel inside it. So
both are fitted, blurred, with what falls off behind them.
"""

from functools import cache

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import nnls

_BLURS_PX = (0.6, 0.9, 1.2, 1.6, 2.2)
_MOST_PX = 2.0  # by which the edge may be off
_STEP_PX = 0.05
_FINE_PX, _REACH_PX = 0.05, 30.0
#: Offsets from a line, outward, at which `edge_of` wants a profile, px.
OFFSETS_PX = np.arange(-8.0, 8.01, 0.25)


def edge_of(profile: Float[np.ndarray, " o"]) -> float:
    """Return by how much the face's edge lies farther out than the line, px.

    Args:
        profile: Change of the colours across the line, at `OFFSETS_PX`.
    """
    best, edge = np.inf, 0.0
    for shift in np.arange(-_MOST_PX, _MOST_PX + _STEP_PX / 2, _STEP_PX):
        away = OFFSETS_PX - shift
        behind = np.maximum(away, 0.0)
        free = [np.ones_like(away), np.sqrt(behind), behind]
        for blur in _BLURS_PX:
            rises = [np.interp(away, *pair) for pair in _blurred(blur)]
            # What is level and what falls off may have either sign; rises only rise.
            terms = np.column_stack([*rises, *free, *(-term for term in free)])
            misfit = nnls(terms, profile)[1]
            if misfit < best:
                best, edge = misfit, float(shift)
    return edge


@cache
def _blurred(blur_px: float) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    """A jump, and one that falls off with the square root: places and values."""
    places = np.arange(-_REACH_PX, _REACH_PX, _FINE_PX) + _FINE_PX / 2
    outside = places > 0
    root = np.where(outside, 1.0 / np.sqrt(np.where(outside, places, 1.0)), 0.0)
    return tuple(
        (places, gaussian_filter1d(values, blur_px / _FINE_PX))
        for values in (outside.astype(float), root)
    )
