"""Backgrounds that are uniform, smooth or layered.

The log-modulus is a constant and modes of the bounding box: those of a smooth background are
products of Legendre polynomials, those of layers cosines along one axis. The polynomials of a
smooth function fall faster than the cosines, which have no slope at the sides. All modes are one at
the first corner of the bounding box, and their amplitudes fall with the wave number.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from jaxtyping import Float
from numpy.polynomial.legendre import legvander

from tactorch.inverse.fields.prior import ShapePrior


@dataclass(frozen=True)
class Background:
    """A background, uniform by default.

    Attributes:
        degree: Largest sum of the degrees along x, y and z of a mode of a smooth background.
        layers: Largest wave numbers of modes along x, y or z alone, for layers across that axis.
    """

    degree: int = 0
    layers: tuple[int, int, int] = (0, 0, 0)
    level: ClassVar[int] = 0  # place of the constant

    @cached_property
    def _degrees(self) -> Float[np.ndarray, "smooth 3"]:
        corners = np.ndindex(*[self.degree + 1] * 3)
        return np.reshape([k for k in corners if 1 <= sum(k) <= self.degree], (-1, 3)).astype(float)

    @cached_property
    def waves(self) -> Float[np.ndarray, "modes 3"]:
        """Wave numbers of the modes along x, y and z; the degrees of polynomials are first."""
        axes = zip(np.eye(3), self.layers, strict=True)
        layers = [np.outer(np.arange(1, largest + 1), axis) for axis, largest in axes]
        return np.concatenate([self._degrees, *layers])

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters: the constant, and the amplitude of each mode."""
        count = len(self._degrees)
        kinds = ("layer" if k >= count else "smooth" for k in range(len(self.waves)))
        modes = zip(kinds, self.waves.astype(int).tolist(), strict=True)
        return "log_youngs", *(f"{kind} {wave}" for kind, wave in modes)

    def scale(self, prior: ShapePrior) -> tuple[list[float], list[float]]:
        """Return mean and deviation of the parameters."""
        amplitudes = prior.mode / np.linalg.norm(self.waves, axis=1)
        mean = [prior.log_background, *np.zeros(len(amplitudes))]
        return mean, [prior.background, *amplitudes.tolist()]

    def derivative(
        self, prior: ShapePrior, points: Float[np.ndarray, "n 3"]
    ) -> Float[np.ndarray, "n parameters"]:
        """Return the derivative of the log-modulus at points (mm) by the parameters."""
        relative = (points - prior.low_mm) / (prior.high_mm - prior.low_mm)
        values, degrees = legvander(1.0 - 2.0 * relative, self.degree), self._degrees.astype(int)
        smooth = np.prod([values[:, axis, degrees[:, axis]] for axis in range(3)], axis=0)
        waves = self.waves[len(degrees) :]
        layers = np.cos(np.pi * waves * relative[:, None, :]).prod(axis=2)
        return np.hstack([np.ones((len(points), 1)), smooth, layers])
