"""Backgrounds that are uniform or smooth, with parts of another modulus beyond planes.

The log-modulus is a constant, modes of the bounding box, and a step at each plane. The modes are
products of Legendre polynomials: cosines of any degree have no slope at the sides. All modes are
one at the first corner of the bounding box, and their amplitudes fall with the degree. A step is
across an axis, and adds a log-contrast to the part on one of its sides: a skin, a layer or a base.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from jaxtyping import Float
from numpy.polynomial.legendre import legvander
from scipy.special import expit

from tactorch.inverse.fields.prior import ShapePrior
from tactorch.inverse.fields.sites import Sites


@dataclass(frozen=True)
class Background:
    """A background, uniform by default.

    Attributes:
        degree: Largest sum of the degrees along x, y and z of a mode of a smooth background.
        steps: For each step, the side of the plane that it changes, such as "z-" for what is below.
    """

    degree: int = 0
    steps: tuple[str, ...] = ()
    level: ClassVar[int] = 0  # place of the constant

    @cached_property
    def modes(self) -> Float[np.ndarray, "modes 3"]:
        """Degrees along x, y and z of each mode."""
        corners = np.ndindex(*[self.degree + 1] * 3)
        return np.reshape([k for k in corners if 1 <= sum(k) <= self.degree], (-1, 3)).astype(float)

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters: the constant, amplitudes, and place and contrast of steps."""
        smooth = [f"smooth {mode}" for mode in self.modes.astype(int).tolist()]
        names = (side + "'" * self.steps[:k].count(side) for k, side in enumerate(self.steps))
        steps = [f"step {name} {what}" for name in names for what in ("place", "log_contrast")]
        return "log_youngs", *smooth, *steps

    def step_at(self, step: int) -> slice:
        """Return where place (mm) and log-contrast of a step are among the parameters."""
        begin = 1 + len(self.modes) + 2 * step
        return slice(begin, begin + 2)

    def scale(self, prior: ShapePrior) -> tuple[list[float], list[float]]:
        """Return mean and deviation of the parameters."""
        amplitudes = prior.mode / np.linalg.norm(self.modes, axis=1)
        mean = [prior.log_background, *np.zeros(len(amplitudes))]
        deviation = [prior.background, *amplitudes.tolist()]
        for side in self.steps:
            low, high = (float(end["xyz".index(side[0])]) for end in (prior.low_mm, prior.high_mm))
            mean += [0.5 * (low + high), 0.0]
            deviation += [0.5 * (high - low), prior.log_contrast]
        return mean, deviation

    def log_youngs(
        self, prior: ShapePrior, values: Float[np.ndarray, "*volumes parameters"], sites: Sites
    ) -> Float[np.ndarray, " volumes"]:
        """Return the log-modulus of each volume, whose parameters (mm, logarithms) may differ."""
        smooth = self._smooth(prior, sites)
        out = np.asarray((smooth * values[..., : smooth.shape[1]]).sum(axis=1))
        for k, side in enumerate(self.steps):
            place, contrast = np.moveaxis(values[..., self.step_at(k)], -1, 0)
            out += contrast * beyond(side, place, sites)[0]
        return out

    def jacobian(
        self, prior: ShapePrior, values: Float[np.ndarray, " parameters"], sites: Sites
    ) -> Float[np.ndarray, "volumes parameters"]:
        """Return the derivative of `log_youngs` by the parameters."""
        columns = [self._smooth(prior, sites)]
        for k, side in enumerate(self.steps):
            place, contrast = values[self.step_at(k)]
            inside, slope = beyond(side, place, sites)
            columns.append(np.column_stack([contrast * slope, inside]))
        return np.hstack(columns)

    def _smooth(self, prior: ShapePrior, sites: Sites) -> Float[np.ndarray, "volumes modes"]:
        """Return the constant and the modes at the centre of each volume."""
        relative = (sites.centers - prior.low_mm) / (prior.high_mm - prior.low_mm)
        values, degrees = legvander(1.0 - 2.0 * relative, self.degree), self.modes.astype(int)
        modes = np.prod([values[:, axis, degrees[:, axis]] for axis in range(3)], axis=0)
        return np.hstack([np.ones((len(relative), 1)), modes])


def beyond(
    side: str, place: Float[np.ndarray, " *volumes"] | float, sites: Sites
) -> tuple[Float[np.ndarray, " volumes"], Float[np.ndarray, " volumes"]]:
    """Return the fraction of each volume on a side of a plane, and its derivative by the place."""
    sign = 1.0 if side[1] == "+" else -1.0
    distance = sign * (sites.points[..., "xyz".index(side[0])] - np.asarray(place)[..., None])
    if not sites.width.any():
        inside = (distance > 0.0).mean(axis=1)
        return inside, np.zeros(len(inside))
    inside = expit(2.0 * distance / sites.width[:, None])
    slope = -2.0 * sign / sites.width * (inside * (1.0 - inside)).mean(axis=1)
    return inside.mean(axis=1), slope
