"""Heterogeneous fields of Young's modulus. Lengths in mm, moduli in MPa."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from tactorch.config import Options, option
from tactorch.errors import ConfigError
from tactorch.mesh.values import unit_vector

_N_WAVES = 128
_Point = tuple[float, float, float]


@runtime_checkable
class Background(Protocol):
    """Field of Young's modulus."""

    def at(self, points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        """Return Young's modulus at points (mm), MPa."""


@dataclass(frozen=True)
class Gradient(Options):
    """Linear from `low_mpa` at `start_mm` to `high_mpa` at `end_mm`, constant beyond."""

    start_mm: _Point = option(help="Start of the gradient", unit="mm")
    end_mm: _Point = option(help="End of the gradient", unit="mm")
    low_mpa: float = option(0.1, "Young's modulus at the start", unit="MPa", gt=0)
    high_mpa: float = option(0.5, "Young's modulus at the end", unit="MPa", gt=0)

    def __post_init__(self) -> None:
        super().__post_init__()
        unit_vector("end_mm - start_mm", np.subtract(self.end_mm, self.start_mm))

    def at(self, points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        span = np.subtract(self.end_mm, self.start_mm)
        position = np.clip((points - np.array(self.start_mm)) @ span / (span @ span), 0.0, 1.0)
        return self.low_mpa + position * (self.high_mpa - self.low_mpa)


@dataclass(frozen=True)
class Layers(Options):
    """Homogeneous layers across `axis`, separated at the increasing `levels_mm`."""

    levels_mm: tuple[float, ...] = option(
        help="Positions of the interfaces along the axis, increasing", unit="mm"
    )
    youngs_mpa: tuple[float, ...] = option(
        help="Young's modulus of each layer, one more than there are interfaces", unit="MPa", gt=0
    )
    axis: _Point = option((0.0, 0.0, 1.0), "Normal of the layers")

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "axis", unit_vector("axis", self.axis))
        if any(upper <= lower for lower, upper in pairwise(self.levels_mm)):
            raise ConfigError(f"levels_mm={list(self.levels_mm)} must increase.")
        if len(self.youngs_mpa) != len(self.levels_mm) + 1:
            raise ConfigError(
                f"youngs_mpa has {len(self.youngs_mpa)} moduli for {len(self.levels_mm)} levels"
                f" between layers; give {len(self.levels_mm) + 1}."
            )

    def at(self, points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        heights = points @ np.array(self.axis)
        return np.array(self.youngs_mpa)[np.searchsorted(np.array(self.levels_mm), heights)]


@dataclass(frozen=True)
class RandomField(Options):
    """Smooth log-normal random field with a Gaussian correlation function.

    A sum of 128 random plane waves (random Fourier features, Rahimi and Recht, 2007), defined at
    every point independently of the mesh.
    """

    median_mpa: float = option(0.2, "Median", unit="MPa", gt=0)
    spread: float = option(0.3, "Standard deviation of the natural logarithm", gt=0)
    correlation_mm: float = option(
        4.0, "Distance at which the correlation is exp(-1/2)", unit="mm", gt=0
    )
    seed: int = option(0, "Seed of the generator", ge=0)

    def at(self, points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        rng = np.random.default_rng(self.seed)
        waves = rng.standard_normal((_N_WAVES, 3)) / self.correlation_mm
        phases = rng.uniform(0.0, 2.0 * np.pi, _N_WAVES)
        field = np.sqrt(2.0 / _N_WAVES) * np.cos(points @ waves.T + phases).sum(axis=1)
        return self.median_mpa * np.exp(self.spread * field)
