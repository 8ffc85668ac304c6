"""Change of the light between two images, which is no deformation of the gel."""

import numpy as np
from jaxtyping import Float

#: Unit of changes of colors, gray values.
COLOUR_UNIT = 50.0
_BANDWIDTH = 0.15  # of the colors, in their unit
_STRIDE = 3  # of the pixels
_MAX_ITERATIONS = 50
_TOLERANCE = 1e-4


def light_drift(change: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "3"]:
    """Return the change of the colors where the gel is not deformed, in units of 50 gray values.

    It is the most frequent change, found by mean shift (Comaniciu and Meer, 2002) from no change,
    from the median of the image and from that of its border.
    """
    border = np.concatenate([change[0], change[-1], change[:, 0], change[:, -1]])
    pixels = change[::_STRIDE, ::_STRIDE].reshape(-1, 3)
    starts = np.zeros(3), np.median(pixels, axis=0), np.median(border, axis=0)
    modes = [_mode(pixels, start) for start in starts]
    return modes[int(np.argmax([_weights(pixels, mode).sum() for mode in modes]))]


def _mode(pixels: Float[np.ndarray, "n 3"], start: np.ndarray) -> Float[np.ndarray, "3"]:
    mode = start
    for _ in range(_MAX_ITERATIONS):
        weights = _weights(pixels, mode)
        if weights.sum() < 1e-9 * len(pixels):
            break
        shifted = weights @ pixels / weights.sum()
        step = float(np.abs(shifted - mode).max())
        mode = shifted
        if step < _TOLERANCE:
            break
    return mode


def _weights(pixels: Float[np.ndarray, "n 3"], mode: np.ndarray) -> Float[np.ndarray, " n"]:
    return np.exp(-0.5 * ((pixels - mode) ** 2).sum(axis=1) / _BANDWIDTH**2)
