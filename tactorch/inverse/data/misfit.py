"""Misfits: the cost of residuals, quadratic or robust to outlying markers or presses.

All optimizers minimise half a sum of squares. Another cost has that form by a map phi from white
residuals r to others, with |phi(r)|^2 / 2 the cost. The derivative of phi is symmetric, so that one
function serves the Jacobian and its transpose.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float, Int
from scipy.special import ndtri

from tactorch.config import Options, Registry, option

NORMAL_MEDIAN = float(ndtri(0.75))  # median of the size of a standard normal number
_Data = Float[np.ndarray, " data"]
_Columns = Float[np.ndarray, "data *k"]
_Begins = Int[np.ndarray, " presses"]


class Misfit(Options, ABC):
    """Settings of a misfit: a cost of white residuals.

    In all methods `white` holds the residuals of all presses in standard deviations, and `begins`
    the index at which each press begins.
    """

    section: ClassVar[str] = "misfit"

    @abstractmethod
    def residuals(self, white: _Data, begins: _Begins) -> _Data:
        """Return phi(r): half its square is the cost."""

    @abstractmethod
    def derivative(self, white: _Data, begins: _Begins, values: _Columns) -> _Columns:
        """Return d phi / dr, which is symmetric, times values."""

    @abstractmethod
    def chi2(self, white: _Data, begins: _Begins) -> float:
        """Return a mean squared residual that is one where the data are fitted to their noise."""


@dataclass(frozen=True)
class Squares(Misfit):
    """Least squares: for normal noise of known size."""

    def residuals(self, white: _Data, begins: _Begins) -> _Data:
        return white

    def derivative(self, white: _Data, begins: _Begins, values: _Columns) -> _Columns:
        return values

    def chi2(self, white: _Data, begins: _Begins) -> float:
        return float(np.mean(white**2))


@dataclass(frozen=True)
class Huber(Misfit):
    """Squares of small residuals, sizes of large ones (Huber, 1964): robust to marker outliers.

    The default edge loses 5 % of the efficiency on normal noise.
    """

    edge: float = option(1.345, "Standard deviations at which a residual is an outlier", gt=0)

    def residuals(self, white: _Data, begins: _Begins) -> _Data:
        """Return sign(r) sqrt(2 rho(r))."""
        size = np.abs(white)
        outer = np.sqrt(np.maximum(self.edge * (2.0 * size - self.edge), self.edge**2))
        return np.where(size <= self.edge, white, np.sign(white) * outer)

    def derivative(self, white: _Data, begins: _Begins, values: _Columns) -> _Columns:
        outer = np.abs(self.residuals(white, begins))
        slope = np.where(np.abs(white) <= self.edge, 1.0, self.edge / outer)
        return (slope * values.T).T

    def chi2(self, white: _Data, begins: _Begins) -> float:
        """Return the squared median size over that of normal noise, which outliers do not move."""
        return float((np.median(np.abs(white)) / NORMAL_MEDIAN) ** 2)


@dataclass(frozen=True)
class Adaptive(Misfit):
    """Each press weighs by how well it is fitted: robust to presses noisier than stated.

    Huber's cost of whole presses. With q the mean square of a press's n residuals the cost is
    n q / 2 up to q = 1 and n (sqrt(q) - 1/2) beyond. It is convex: a press that no map fits pulls
    with the force of one that deviates by its noise. (The profile likelihood, n/2 log q, is not
    convex, and misleads far from the solution.)
    """

    def residuals(self, white: _Data, begins: _Begins) -> _Data:
        """Return each press's residuals times a(q), 1 or sqrt((2 sqrt(q) - 1) / q)."""
        return np.concatenate(
            [_shrinkage(_mean_square(r)) * r for r in np.split(white, begins[1:])]
        )

    def derivative(self, white: _Data, begins: _Begins, values: _Columns) -> _Columns:
        parts = []
        for r, v in zip(*(np.split(x, begins[1:]) for x in (white, values)), strict=True):
            q = _mean_square(r)
            shrinkage = _shrinkage(q)
            part = shrinkage * v
            if q > 1.0:
                # phi = a(q) r, so d phi = a dr + 2 a'/n r (r . dr).
                slope = (1.0 - np.sqrt(q)) / (2.0 * shrinkage * q * q)
                part = part + (2.0 * slope / len(r)) * np.multiply.outer(r, r @ v)
            parts.append(part)
        return np.concatenate(parts)

    def chi2(self, white: _Data, begins: _Begins) -> float:
        """Return the mean square of the median press: most presses are as good as stated."""
        return float(np.median([_mean_square(r) for r in np.split(white, begins[1:])]))


def _mean_square(r: Float[np.ndarray, " p"]) -> float:
    return float(r @ r) / len(r)


def _shrinkage(q: float) -> float:
    return 1.0 if q <= 1.0 else float(np.sqrt((2.0 * np.sqrt(q) - 1.0) / q))


_HERE = "tactorch.inverse.data.misfit"
#: Settings of the misfits by name.
MISFITS = Registry(
    "misfit",
    {"squares": f"{_HERE}:Squares", "huber": f"{_HERE}:Huber", "adaptive": f"{_HERE}:Adaptive"},
)
