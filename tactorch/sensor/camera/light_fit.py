"""Calibration of light and colour response by gradients, from pixels of known slope.

The start is the linear fit of the colours to the slopes: one lamp for each colour. All parameters
of `Shading` are then fitted together to the change of the colours. The size of a pixel is not
fitted: colours of balls in pixels of another size or another ratio of the sides are those of other
lamps. Markers of known pitch determine it, see `fit_lens`.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from tactorch.errors import ConfigError
from tactorch.sensor.camera.optimize import fit_parameters
from tactorch.sensor.camera.shading import Shading
from tactorch.sensor.light import COLOUR_UNIT

_ELEVATION_DEG, _AMBIENT, _FALLOFF = 35.0, 45.0, 0.1  # of the start
#: Typical changes of the parameters from their start; `mixing` follows from the colours of lamps.
SCALES = {
    "azimuth": 0.3, "elevation": 0.3, "colours": 50.0, "ambient": 50.0, "falloff": 0.3,
    "diffuse": 20.0, "gamma": 0.3,
}  # fmt: skip
_RIDGE = 0.05  # of the squared changes over their scales, on average
_OUTLIER = 0.1  # change of a colour from which its residual counts linearly
_PIXELS = 20_000  # drawn for the fit
_MIN_PIXELS = 200

Rows = Float[Tensor, "n 3"]


@dataclass(frozen=True, eq=False)
class LightFit:
    """Fitted light.

    Attributes:
        shading: Light and colour response.
        deviation: Root mean square residual of the colours, in units of 50 gray values.
    """

    shading: Shading
    deviation: float


def fit_light(
    change: Float[np.ndarray, "n 3"],
    slopes: Float[np.ndarray, "n 2"],
    places: Float[np.ndarray, "n 2"],
    seed: int = 0,
    iterations: int = 150,
) -> LightFit:
    """Fit the shading to pixels of known slope.

    Args:
        change: Change of the colours against the level face, in units of 50 gray values.
        slopes: dz/dx and dz/dy.
        places: Positions from -1 to 1 across the image along x and y.
        seed: Seed of the drawn pixels.
        iterations: Largest number of iterations.

    Raises:
        ConfigError: There are too few pixels.
    """
    if len(change) < _MIN_PIXELS:
        raise ConfigError(f"{len(change)} pixels are too few to fit lamps; give {_MIN_PIXELS}.")
    drawn = np.random.default_rng(seed).permutation(len(change))[:_PIXELS]
    colours, known, where = (torch.from_numpy(v[drawn]) for v in (change, slopes, places))
    shading = initial_shading(colours, known)
    count = sum(shading.get_parameter(name).numel() for name in SCALES)

    def loss() -> Tensor:
        """Mean pseudo-Huber loss, about half the mean square for small residuals."""
        squares = ((shading.change(known, where) - colours) / _OUTLIER).square()
        return _OUTLIER**2 * (torch.sqrt(1.0 + squares) - 1.0).mean()

    fit_parameters(shading, loss, SCALES, iterations, _RIDGE * _OUTLIER**2 / count)
    with torch.no_grad():
        residual = shading.change(known, where) - colours
    return LightFit(shading, float(residual.square().mean().sqrt()))


def initial_shading(change: Rows, slopes: Float[Tensor, "n 2"]) -> Shading:
    """Return the shading of the linear fit of colours to slopes: one lamp for each colour."""
    by_slope = torch.linalg.lstsq(slopes, change).solution  # 2 x 3
    azimuths = torch.rad2deg(torch.atan2(by_slope[1], by_slope[0])).tolist()
    strength = COLOUR_UNIT * by_slope.norm(dim=0) / np.cos(np.deg2rad(_ELEVATION_DEG))
    colours = torch.diag(strength).tolist()
    return Shading(azimuths, _ELEVATION_DEG, colours, (_AMBIENT,) * 3, _FALLOFF)
