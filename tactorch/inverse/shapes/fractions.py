"""Fractions of volumes inside an ellipsoid with a boundary of a width, and their derivatives.

An ellipsoid has its centre c (mm) and its log-radius, and if it is no ball five distortions, which
are coefficients of symmetric matrices without trace. The sum S of those and of the log-radius times
the unit matrix is the logarithm of the matrix that maps the unit ball to the ellipsoid. The level
at x is L = |A (x - c)| with A = exp(-S), and the distance to the boundary (L - 1) / |grad L|, to
first order; it is exact for a ball.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.linalg import expm, expm_frechet
from scipy.special import expit

# Orthonormal basis of symmetric matrices without trace: distortions of the same volume.
_DIAGONALS = (
    np.diag([1.0, -1.0, 0.0]) / np.sqrt(2.0),
    np.diag([1.0, 1.0, -2.0]) / np.sqrt(6.0),
)
_SHEARS = tuple(
    (np.outer(a, b) + np.outer(b, a)) / np.sqrt(2.0)
    for a, b in ((np.eye(3)[i], np.eye(3)[j]) for i, j in ((0, 1), (0, 2), (1, 2)))
)
_BASIS = np.stack([*_DIAGONALS, *_SHEARS])
_VARIANCE = np.pi**2 / 12.0  # of the logistic distribution whose density is a boundary of width one
_TINY = 1e-12  # mm2, for the derivative of a length at zero


class Geometry(NamedTuple):
    """Parameters of an ellipsoid.

    Attributes:
        center: Centre, mm.
        log_radius: Logarithm of the radius (mm) of the ball of the same volume.
        distortions: The five distortions; none for a ball.
    """

    center: Float[np.ndarray, "3"]
    log_radius: float
    distortions: Float[np.ndarray, " k"]

    @staticmethod
    def of(center: Float[np.ndarray, "3"], log_stretch: Float[np.ndarray, "3 3"]) -> "Geometry":
        """Return the ellipsoid of a centre (mm) and a symmetric matrix, see `log_stretch`."""
        distortions = np.tensordot(_BASIS, log_stretch, 2)
        return Geometry(center, float(np.trace(log_stretch)) / 3.0, distortions)

    @property
    def log_stretch(self) -> Float[np.ndarray, "3 3"]:
        """Logarithm of the matrix that maps the unit ball to the ellipsoid (mm)."""
        isotropic = self.log_radius * np.eye(3)
        if not len(self.distortions):
            return isotropic
        return isotropic + np.tensordot(self.distortions, _BASIS, 1)

    def fraction(
        self, points: Float[np.ndarray, "volumes samples 3"], width: Float[np.ndarray, " volumes"]
    ) -> Float[np.ndarray, " volumes"]:
        """Return the fraction of each volume inside, by its sample points (mm).

        The boundary is sharp where its width (mm) is zero.
        """
        distance = self._distance(points)
        if not width.any():
            return np.asarray((distance < 0.0).mean(axis=1))
        return np.asarray(expit(self._scaled(distance, width)).mean(axis=1))

    def derivative(
        self, points: Float[np.ndarray, "volumes samples 3"], width: Float[np.ndarray, " volumes"]
    ) -> tuple[Float[np.ndarray, " volumes"], Float[np.ndarray, "volumes parameters"]]:
        """Return the fractions and their derivatives by centre, log-radius and distortions."""
        distance, slopes = self._distance_derivative(points)
        slopes[3] -= self._shift(width)[:, None]
        inside = expit(self._scaled(distance, width))
        weights = inside * (1.0 - inside) * (-2.0 / width / points.shape[1])[:, None]
        return inside.mean(axis=1), np.einsum("vs,kvs->vk", weights, slopes)

    def _scaled(
        self, distance: Float[np.ndarray, "volumes samples"], width: Float[np.ndarray, " volumes"]
    ) -> Float[np.ndarray, "volumes samples"]:
        return -2.0 * (distance + self._shift(width)[:, None]) / width[:, None]

    def _shift(self, width: Float[np.ndarray, " volumes"]) -> Float[np.ndarray, " volumes"]:
        """Shift of a smooth boundary (mm), which would enlarge a ball by its curvature."""
        return _VARIANCE * width * width / np.exp(self.log_radius)

    def _distance(
        self, points: Float[np.ndarray, "volumes samples 3"]
    ) -> Float[np.ndarray, "volumes samples"]:
        offset = points - self.center
        if not len(self.distortions):
            return _length(offset) - np.exp(self.log_radius)
        inverse = expm(-self.log_stretch)
        unit = offset @ inverse
        level = _length(unit)
        return (level - 1.0) * level / _length(unit @ inverse)

    def _distance_derivative(
        self, points: Float[np.ndarray, "volumes samples 3"]
    ) -> tuple[Float[np.ndarray, "volumes samples"], Float[np.ndarray, "k volumes samples"]]:
        offset = points - self.center
        if not len(self.distortions):
            length, radius = _length(offset), float(np.exp(self.log_radius))
            centers = -np.moveaxis(offset / length[..., None], -1, 0)
            return length - radius, np.concatenate([centers, np.full((1, *length.shape), -radius)])
        stretch = self.log_stretch
        inverse = expm(-stretch)
        unit = offset @ inverse
        slope = unit @ inverse
        level, steepness = _length(unit), _length(slope)
        distance = (level - 1.0) * level / steepness
        by_level = (2.0 * level - 1.0) / steepness / level
        by_slope = -distance / steepness**2
        changes = [np.eye(3), *_BASIS]
        inverses = [expm_frechet(-stretch, -change, compute_expm=False) for change in changes]
        units = [-row for row in inverse] + [offset @ change for change in inverses]
        slopes = [-row for row in inverse @ inverse] + [
            moved @ inverse + unit @ change
            for moved, change in zip(units[3:], inverses, strict=True)
        ]
        return distance, np.stack([
            by_level * (unit * moved).sum(axis=-1) + by_slope * (slope * turned).sum(axis=-1)
            for moved, turned in zip(units, slopes, strict=True)
        ])  # fmt: skip


def _length(vectors: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, " *n"]:
    return np.asarray(np.sqrt((vectors * vectors).sum(axis=-1) + _TINY))
