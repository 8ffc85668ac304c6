"""Calibration of light and colour response by gradients, from pixels of known slope.

The start is the linear fit of the colours to the slopes: one lamp for each colour. All parameters
of `Shading` are then fitted together to the change of the colours. `refine_contacts` also fits the
centers of the contacts of a ball and the size of a pixel through the rendered colours. Colours of a
ball determine the ratio of the sizes along x and y well, and their mean hardly: a larger ball under
flatter lamps has nearly the same colours.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.func import functional_call

from tactorch.errors import ConfigError
from tactorch.sensor.camera.optimize import Parameters, minimize
from tactorch.sensor.camera.shading import Shading
from tactorch.sensor.light import COLOUR_UNIT

_ELEVATION_DEG, _AMBIENT, _FALLOFF = 35.0, 45.0, 0.1  # of the start
#: Typical changes of the parameters from their start; `mixing` follows from the colours of lamps.
SCALES = {
    "azimuth": 0.3, "elevation": 0.3, "colours": 50.0, "ambient": 50.0, "falloff": 0.3,
    "diffuse": 20.0, "gamma": 0.3,
}  # fmt: skip
_RIDGE = 1e-3  # of the squared changes over their scales, on average
_OUTLIER = 0.1  # change of a colour from which its residual counts linearly
_PIXELS = 20_000  # drawn for the fit
_MIN_PIXELS = 200
_STEEPEST = 0.2  # least depth of a ball's surface below its center, over the radius, as in `Ball`
_CENTER_PX, _SCALE = 1.0, 0.02  # typical changes of centers, and relative ones of pixel sizes

Rows = Float[Tensor, "n 3"]


@dataclass(frozen=True, eq=False)
class LightFit:
    """Fitted light.

    Attributes:
        shading: Light and colour response.
        deviation: Root mean square residual of the colours, in units of 50 gray values.
        centers_px: Centers of the contacts (column, row), if they were fitted.
        mm_per_px: Size of a pixel along x and y, mm, if it was fitted.
    """

    shading: Shading
    deviation: float
    centers_px: Float[np.ndarray, "presses 2"] | None = None
    mm_per_px: tuple[float, float] | None = None


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
    start = dict(shading.named_parameters())

    def loss(parameters: Parameters) -> Tensor:
        residual = _rendered_change(shading, parameters, known, where) - colours
        return _robust(residual) + _ridge(parameters, start)

    fitted, _ = minimize(loss, start, SCALES, iterations)
    _set_parameters(shading, fitted)
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


@dataclass(frozen=True, eq=False)
class ContactPixels:
    """Pixels of the contact of a ball, and of the level face around it.

    Attributes:
        change: Change of the colours, in units of 50 gray values.
        pixels: Columns and rows.
        places: Positions from -1 to 1 across the image.
        inside: Whether a pixel is in the contact; the others have no slope.
        center_px: Approximate center of the contact (column, row).
    """

    change: Float[np.ndarray, "n 3"]
    pixels: Float[np.ndarray, "n 2"]
    places: Float[np.ndarray, "n 2"]
    inside: Float[np.ndarray, " n"]
    center_px: tuple[float, float]


def refine_contacts(
    shading: Shading,
    contacts: Sequence[ContactPixels],
    radius_mm: float,
    mm_per_px: tuple[float, float],
    *,
    fit_scale: bool = True,
    iterations: int = 100,
) -> LightFit:
    """Fit light, colour response, centers of contacts and the size of a pixel together.

    Args:
        shading: Start of the light, see `fit_light`; it is changed.
        contacts: Pixels of each press of the ball.
        radius_mm: Radius of the ball, mm.
        mm_per_px: Start of the size of a pixel along x and y, mm.
        fit_scale: Whether to fit the size of a pixel.
        iterations: Largest number of iterations.
    """
    change, pixels, places, inside = (
        torch.from_numpy(np.concatenate([getattr(c, name) for c in contacts]).astype(float))
        for name in ("change", "pixels", "places", "inside")
    )
    press = torch.from_numpy(np.repeat(np.arange(len(contacts)), [len(c.change) for c in contacts]))
    start = {
        **dict(shading.named_parameters()),
        "centers": torch.tensor([c.center_px for c in contacts], dtype=torch.float64),
        "log_scale": torch.tensor(mm_per_px, dtype=torch.float64).log(),
    }
    scales = {**SCALES, "centers": _CENTER_PX}
    if fit_scale:
        scales["log_scale"] = _SCALE

    def residual(parameters: Parameters) -> Rows:
        offsets = (pixels - parameters["centers"][press]) * parameters["log_scale"].exp()
        slopes = ball_slopes(offsets, radius_mm) * inside[:, None]
        return _rendered_change(shading, parameters, slopes, places) - change

    def loss(parameters: Parameters) -> Tensor:
        return _robust(residual(parameters)) + _ridge(parameters, start)

    fitted, _ = minimize(loss, start, scales, iterations)
    _set_parameters(shading, fitted)
    deviation = float(residual(fitted).square().mean().sqrt())
    x, y = fitted["log_scale"].exp().tolist()
    return LightFit(shading, deviation, fitted["centers"].numpy(), (x, y))


def ball_slopes(offsets_mm: Float[Tensor, "n 2"], radius_mm: float) -> Float[Tensor, "n 2"]:
    """Return the slopes of a ball at offsets from its center, see `Ball.slopes_at`."""
    squared = radius_mm**2 - offsets_mm.square().sum(dim=-1, keepdim=True)
    return offsets_mm / squared.clamp_min((_STEEPEST * radius_mm) ** 2).sqrt()


def _rendered_change(
    shading: Shading, parameters: Parameters, slopes: Tensor, places: Tensor
) -> Tensor:
    names = dict(shading.named_parameters())
    own = {name: value for name, value in parameters.items() if name in names}
    colours = functional_call(shading, own, (slopes, places))
    level = functional_call(shading, own, (torch.zeros_like(slopes), places))
    return (colours - level) / COLOUR_UNIT


def _robust(residual: Tensor) -> Tensor:
    """Mean pseudo-Huber loss, about half the mean square for small residuals."""
    return _OUTLIER**2 * (torch.sqrt(1.0 + (residual / _OUTLIER) ** 2) - 1.0).mean()


def _ridge(parameters: Parameters, start: Parameters) -> Tensor:
    changes = [
        ((parameters[name] - start[name].detach()) / scale).flatten()
        for name, scale in SCALES.items()
    ]
    return _RIDGE * _OUTLIER**2 * torch.cat(changes).square().mean()


def _set_parameters(shading: Shading, values: Parameters) -> None:
    with torch.no_grad():
        for name, parameter in shading.named_parameters():
            parameter.copy_(values[name])
