"""Slopes by the differentiable camera: those whose rendered colours fit the measured ones.

The light is fitted to the contacts that another map has found. The slopes of a pixel minimize the
squared residuals of its colours plus a prior of zero mean, from the best of a grid of slopes.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from tactorch.config import option
from tactorch.errors import ConfigError
from tactorch.sensor.calibration.maps import Arrays, Features, SensorMap, SlopeMap, Slopes
from tactorch.sensor.camera.light_fit import LightFit, fit_light
from tactorch.sensor.camera.shading import Shading

_STARTS = (-0.9, -0.4, 0.0, 0.4, 0.9)  # slopes along x and y
_STEPS, _MAX_STEP = 8, 0.5
_DAMPING, _MIN_DAMPING, _MAX_DAMPING = 1e-4, 1e-8, 1e3
_CHUNK = 100_000  # pixels
_DEVIATION = "deviation"


@dataclass(frozen=True)
class CameraLight(SensorMap):
    """Inverse of the differentiable camera; its contacts are those of the map `mlp_colour`."""

    contacts_by: ClassVar[str | None] = "mlp_colour"
    automatic: ClassVar[bool] = False
    iterations: int = option(150, "Largest number of iterations of the fit of the light", ge=1)
    slope_deviation: float = option(
        1.0, "Standard deviation of slopes before their colours are seen", gt=0
    )

    def create(self, seed: int) -> SlopeMap:
        """Return a map without light, to be fitted."""
        return CameraMap(self)


class CameraMap:
    """Slope map of `CameraLight`; `light` is the fitted light."""

    def __init__(self, options: CameraLight) -> None:
        self.options = options
        self.light: LightFit | None = None

    def fit(self, features: Features, slopes: Slopes, seed: int) -> None:
        """Fit the light to pixels of known slope."""
        colours, places = features[:, :3], features[:, 3:]
        self.light = fit_light(colours, slopes, places, seed, self.options.iterations)

    def __call__(self, features: Features) -> Slopes:
        """Return the slopes whose colours fit."""
        chunks = torch.from_numpy(np.ascontiguousarray(features, dtype=float)).split(_CHUNK)
        with torch.no_grad():
            return torch.cat([self._slopes(rows) for rows in chunks]).numpy()

    def arrays(self) -> Arrays:
        """Return the parameters of the light."""
        return light_arrays(self._fitted())

    def restore(self, arrays: Arrays) -> None:
        """Set the parameters of the light."""
        self.light = restore_light(arrays)

    def _fitted(self) -> LightFit:
        if self.light is None:
            raise ConfigError("the camera has no light yet; fit it to presses of a ball.")
        return self.light

    def _slopes(self, features: Float[Tensor, "n 5"]) -> Float[Tensor, "n 2"]:
        light, (colours, places) = self._fitted(), features.split((3, 2), dim=1)
        weight = (light.deviation / self.options.slope_deviation) ** 2

        def cost(slopes: Tensor) -> Tensor:
            residual = light.shading.change(slopes, places) - colours
            return residual.square().sum(dim=1) + weight * slopes.square().sum(dim=1)

        axis = torch.tensor(_STARTS, dtype=features.dtype)
        starts = torch.cartesian_prod(axis, axis)
        costs = torch.stack([cost(start.expand(len(features), 2)) for start in starts])
        slopes = starts[costs.argmin(dim=0)]
        damping, current = torch.full_like(costs[0], _DAMPING), cost(slopes)
        for _ in range(_STEPS):
            trial = slopes - self._step(slopes, colours, places, weight, damping)
            new = cost(trial)
            better = new < current
            slopes = torch.where(better[:, None], trial, slopes)
            current = torch.where(better, new, current)
            damping = torch.where(better, damping / 3, damping * 10)
            damping = damping.clamp(_MIN_DAMPING, _MAX_DAMPING)
        return slopes

    def _step(
        self, slopes: Tensor, colours: Tensor, places: Tensor, weight: float, damping: Tensor
    ) -> Float[Tensor, "n 2"]:
        """Damped Gauss-Newton step of each pixel, of a limited length."""
        rendered, jacobian = self._fitted().shading.linearize(slopes, places)
        identity = torch.eye(2, dtype=slopes.dtype)
        hessian = jacobian.mT @ jacobian + (weight + damping)[:, None, None] * identity
        gradient = (jacobian * (rendered - colours)[..., None]).sum(dim=1) + weight * slopes
        step = torch.linalg.solve(hessian, gradient)
        length = step.norm(dim=1, keepdim=True).clamp_min(1e-12)
        return step * (_MAX_STEP / length).clamp(max=1.0)


def light_arrays(light: LightFit) -> Arrays:
    """Return the parameters of a light as arrays."""
    parameters = light.shading.state_dict()
    arrays = {name: value.numpy() for name, value in parameters.items()}
    return {**arrays, _DEVIATION: np.array(light.deviation)}


def restore_light(arrays: Arrays) -> LightFit:
    """Return the light of arrays.

    Raises:
        ValueError, KeyError, RuntimeError: The arrays are no light.
    """
    deviation = float(arrays[_DEVIATION])
    if not deviation > 0:
        raise ValueError(f"deviation of colours {deviation}")
    count = len(arrays["azimuth"])
    shading = Shading([0.0] * count, 0.0, np.zeros((count, 3)).tolist())
    parameters = {name: torch.from_numpy(v) for name, v in arrays.items() if name != _DEVIATION}
    shading.load_state_dict(parameters)
    return LightFit(shading, deviation)
