"""Rules that choose the prior's weight without the truth, and without knowing the noise.

`gcv`: generalised cross-validation (Golub, Heath and Wahba, 1979) leaves out each datum in turn
and asks which weight foretells it best. `l_curve`: the corner of log misfit against log prior
(Hansen and O'Leary, 1993). Both look at the linearised problem at the present map.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from tactorch.inverse.optimizers.spectrum import Spectrum

WEIGHT_RULES = ("discrepancy", "l_curve", "gcv")


def gcv_score(spectrum: Spectrum, weights: Float[np.ndarray, " w"]) -> Float[np.ndarray, " w"]:
    """Mean squared residual over (1 - freedom / data)^2, for each weight."""
    left = 1.0 - spectrum.freedom(weights) / spectrum.n_data
    return spectrum.misfits(weights) / spectrum.n_data / np.maximum(left, 1e-9) ** 2


def gcv_weight(spectrum: Spectrum) -> float:
    """Weight with the lowest score of generalised cross-validation."""
    weights = spectrum.weights()
    return float(weights[np.argmin(gcv_score(spectrum, weights))])


def l_curve_weight(spectrum: Spectrum) -> float:
    """Weight where log misfit against log prior bends most, as seen from the origin."""
    weights = spectrum.weights()
    across, up = np.log(spectrum.misfits(weights)), np.log(spectrum.penalties(weights))
    dx, dy = np.gradient(across), np.gradient(up)
    ddx, ddy = np.gradient(dx), np.gradient(dy)
    speed = np.maximum((dx * dx + dy * dy) ** 1.5, 1e-30)
    bend = (dy * ddx - dx * ddy) / speed
    # Where the curve hardly moves, its bend is round-off; the ends have no bend.
    bend[dx * dx + dy * dy < 1e-6] = -np.inf
    inner = slice(2, -2)
    return float(weights[inner][np.argmax(bend[inner])])


RULES: dict[str, Callable[[Spectrum], float]] = {"l_curve": l_curve_weight, "gcv": gcv_weight}
