"""Heterogeneous fields of Young's modulus. Lengths in mm, moduli in MPa."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError
from tactorch.mesh.values import Checked, Real, Vector, checked, positive, unit_vector, vector

_N_WAVES = 128


@runtime_checkable
class Background(Protocol):
    """Field of Young's modulus."""

    def at(self, points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        """Return Young's modulus at points (mm), MPa."""


@dataclass(frozen=True)
class Gradient(Checked):
    """Linear from `low_mpa` at `start_mm` to `high_mpa` at `end_mm`, constant beyond."""

    start_mm: Vector = checked(vector)
    end_mm: Vector = checked(vector)
    low_mpa: Real = checked(positive, 0.1)
    high_mpa: Real = checked(positive, 0.5)

    def __post_init__(self) -> None:
        super().__post_init__()
        unit_vector("end_mm - start_mm", np.subtract(self.end_mm, self.start_mm))

    def at(self, points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        span = np.subtract(self.end_mm, self.start_mm)
        position = np.clip((points - np.array(self.start_mm)) @ span / (span @ span), 0.0, 1.0)
        return self.low_mpa + position * (self.high_mpa - self.low_mpa)


def _levels(name: str, values: Sequence[Real]) -> tuple[float, ...]:
    levels = tuple(float(value) for value in values)
    if not (np.isfinite(levels).all() and (np.diff(levels) > 0).all()):
        raise ConfigError(f"{name}={list(levels)} must increase.")
    return levels


def _moduli(name: str, values: Sequence[Real]) -> tuple[float, ...]:
    return tuple(positive(f"{name}[{i}]", value) for i, value in enumerate(values))


@dataclass(frozen=True)
class Layers(Checked):
    """Homogeneous layers across `axis`, separated at the increasing `levels_mm`.

    Attributes:
        levels_mm: Positions of the interfaces along the axis, increasing.
        youngs_mpa: Young's modulus of each layer, one more than there are interfaces.
        axis: Normal of the layers.
    """

    levels_mm: Sequence[Real] = checked(_levels)
    youngs_mpa: Sequence[Real] = checked(_moduli)
    axis: Vector = checked(unit_vector, (0.0, 0.0, 1.0))

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.youngs_mpa) != len(self.levels_mm) + 1:
            raise ConfigError(
                f"youngs_mpa has {len(self.youngs_mpa)} moduli for {len(self.levels_mm)} levels"
                f" between layers; give {len(self.levels_mm) + 1}."
            )

    def at(self, points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        heights = points @ np.array(self.axis)
        return np.array(self.youngs_mpa)[np.searchsorted(np.array(self.levels_mm), heights)]


@dataclass(frozen=True)
class RandomField(Checked):
    """Smooth log-normal random field with a Gaussian correlation function.

    A sum of 128 random plane waves (random Fourier features, Rahimi and Recht, 2007), defined at
    every point independently of the mesh.

    Attributes:
        median_mpa: Median, MPa.
        spread: Standard deviation of the natural logarithm.
        correlation_mm: Distance at which the correlation is exp(-1/2).
        seed: Seed of the generator.
    """

    median_mpa: Real = checked(positive, 0.2)
    spread: Real = checked(positive, 0.3)
    correlation_mm: Real = checked(positive, 4.0)
    seed: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.seed < 0:
            raise ConfigError(f"seed={self.seed} must not be negative.")

    def at(self, points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        rng = np.random.default_rng(self.seed)
        waves = rng.standard_normal((_N_WAVES, 3)) / self.correlation_mm
        phases = rng.uniform(0.0, 2.0 * np.pi, _N_WAVES)
        field = np.sqrt(2.0 / _N_WAVES) * np.cos(points @ waves.T + phases).sum(axis=1)
        return self.median_mpa * np.exp(self.spread * field)
