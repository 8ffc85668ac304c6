"""What a residual costs: its square, less where it is an outlier, or by its press's own noise.

All optimizers minimise half the sum of squares. Another cost is brought into that form by a map
from white residuals r to others, phi(r), with half of |phi(r)|^2 the cost; its derivative is
symmetric, so one function serves the Jacobian and its transpose.
"""

from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int
from scipy.special import ndtri

from tactorch.errors import ConfigError

_MEDIAN = float(ndtri(0.75))  # median of the size of a standard normal number


@runtime_checkable
class Misfit(Protocol):
    """A cost of white residuals; presses are told apart by where each begins."""

    name: str

    def residuals(
        self, white: Float[np.ndarray, " data"], begins: Int[np.ndarray, " presses"]
    ) -> Float[np.ndarray, " data"]:
        """Return phi: half its square is the cost."""
        ...

    def derivative(
        self,
        white: Float[np.ndarray, " data"],
        begins: Int[np.ndarray, " presses"],
        values: Float[np.ndarray, "data *k"],
    ) -> Float[np.ndarray, "data *k"]:
        """Return d phi / dr, symmetric, times values."""
        ...

    def chi2(self, white: Float[np.ndarray, " data"], begins: Int[np.ndarray, " presses"]) -> float:
        """Return what is one where the data are fitted to their noise."""
        ...


class Squares:
    """Least squares: right for normal noise whose size is known."""

    name = "squares"

    def residuals(
        self, white: Float[np.ndarray, " data"], begins: Int[np.ndarray, " presses"]
    ) -> Float[np.ndarray, " data"]:
        """Return the residuals themselves."""
        return white

    def derivative(
        self,
        white: Float[np.ndarray, " data"],
        begins: Int[np.ndarray, " presses"],
        values: Float[np.ndarray, "data *k"],
    ) -> Float[np.ndarray, "data *k"]:
        """Return the values themselves."""
        return values

    def chi2(self, white: Float[np.ndarray, " data"], begins: Int[np.ndarray, " presses"]) -> float:
        """Return the mean square."""
        return float(np.mean(white**2))


class Huber:
    """Squares of small residuals, sizes of large ones (Huber, 1964): for markers gone astray.

    Args:
        edge: Standard deviations at which a residual becomes an outlier; 1.345 costs 5 % of the
            efficiency where there are none.
    """

    name = "huber"

    def __init__(self, edge: float = 1.345) -> None:
        """Take the edge."""
        if not edge > 0:
            raise ConfigError(f"misfit.edge={edge} must be above 0 standard deviations.")
        self._edge = edge

    def residuals(
        self, white: Float[np.ndarray, " data"], begins: Int[np.ndarray, " presses"]
    ) -> Float[np.ndarray, " data"]:
        """Return sign(r) sqrt(2 rho(r))."""
        size = np.abs(white)
        outer = np.sqrt(np.maximum(self._edge * (2.0 * size - self._edge), self._edge**2))
        return np.where(size <= self._edge, white, np.sign(white) * outer)

    def derivative(
        self,
        white: Float[np.ndarray, " data"],
        begins: Int[np.ndarray, " presses"],
        values: Float[np.ndarray, "data *k"],
    ) -> Float[np.ndarray, "data *k"]:
        """Return the values, those of outliers made smaller."""
        outer = np.abs(self.residuals(white, begins))
        slope = np.where(np.abs(white) <= self._edge, 1.0, self._edge / outer)
        return (slope * values.T).T

    def chi2(self, white: Float[np.ndarray, " data"], begins: Int[np.ndarray, " presses"]) -> float:
        """Return the squared median size over that of normal noise: outliers do not count."""
        return float((np.median(np.abs(white)) / _MEDIAN) ** 2)


class Adaptive:
    """Each press weighs by how well it is fitted: Huber's cost of whole presses.

    With q the mean square of a press's n residuals the cost is n q / 2 up to q = 1 and
    n (sqrt(q) - 1/2) beyond, which is convex: a press that no map fits then pulls with the force
    of one that is off by its noise, however far it is off. (The profile likelihood, n/2 log q, is
    not convex: far from the solution, where no press is fitted, it leads astray.)
    """

    name = "adaptive"

    def residuals(
        self, white: Float[np.ndarray, " data"], begins: Int[np.ndarray, " presses"]
    ) -> Float[np.ndarray, " data"]:
        """Return each press's residuals times a(q), 1 or sqrt((2 sqrt(q) - 1) / q)."""
        return np.concatenate([_shrink(r) * r for r in _presses(white, begins)])

    def derivative(
        self,
        white: Float[np.ndarray, " data"],
        begins: Int[np.ndarray, " presses"],
        values: Float[np.ndarray, "data *k"],
    ) -> Float[np.ndarray, "data *k"]:
        """Return the values shrunk, and changed along the residuals as these grow."""
        parts = []
        for r, v in zip(_presses(white, begins), _presses(values, begins), strict=True):
            shrink, q = _shrink(r), _mean_square(r)
            part = shrink * v
            if q > 1.0:
                # phi = a(q) r, so d phi = a dr + 2 a'/n r (r . dr).
                slope = (1.0 - np.sqrt(q)) / (2.0 * shrink * q * q)
                part = part + (2.0 * slope / len(r)) * np.multiply.outer(r, r @ v)
            parts.append(part)
        return np.concatenate(parts)

    def chi2(self, white: Float[np.ndarray, " data"], begins: Int[np.ndarray, " presses"]) -> float:
        """Return the median press's mean square: most presses are as good as stated."""
        return float(np.median([_mean_square(r) for r in _presses(white, begins)]))


def _presses(
    values: Float[np.ndarray, "data *k"], begins: Int[np.ndarray, " presses"]
) -> list[np.ndarray]:
    return np.split(values, begins[1:])


def _mean_square(r: Float[np.ndarray, " p"]) -> float:
    return float(r @ r) / len(r)


def _shrink(r: Float[np.ndarray, " p"]) -> float:
    q = _mean_square(r)
    return 1.0 if q <= 1.0 else float(np.sqrt((2.0 * np.sqrt(q) - 1.0) / q))


MISFITS = ("squares", "huber", "adaptive")


def make_misfit(name: str) -> Misfit:
    """Make a misfit by name.

    Raises:
        ConfigError: the name is unknown.
    """
    if name == "squares":
        return Squares()
    if name == "huber":
        return Huber()
    if name == "adaptive":
        return Adaptive()
    raise ConfigError(f"misfit={name} is unknown; choose one of {', '.join(MISFITS)}.")
