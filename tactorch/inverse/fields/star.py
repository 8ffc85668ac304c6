"""Irregular lumps: bodies whose boundary is at one distance from the centre in each direction.

The logarithm of this distance is that of the radius plus spherical harmonics of degree 2 to 4, such
as three lobes, corners or a waist. Their prior deviations fall with the degree, and the evidence
decides whether they are needed. The distance of a point to the boundary is that along the radius.
"""

from dataclasses import dataclass
from functools import reduce

import numpy as np
from jaxtyping import Float, Int

from tactorch.inverse.fields.family import Distances, Family, Samples, Slopes, Values, length
from tactorch.inverse.fields.inclusion import COMMON, Cloud, InclusionShape, Parameters
from tactorch.inverse.fields.prior import ShapePrior
from tactorch.mesh import Sphere
from tactorch.mesh.surfaces import TriangleSurface

#: Harmonic polynomials of the direction, by degree; "xxz" is x squared times z.
_HARMONICS: dict[int, list[dict[str, float]]] = {
    2: [{"xy": 1}, {"yz": 1}, {"xz": 1}, {"zz": 2, "xx": -1, "yy": -1}, {"xx": 1, "yy": -1}],
    3: [
        {"zzz": 2, "xxz": -3, "yyz": -3},
        {"xzz": 4, "xxx": -1, "xyy": -1},
        {"yzz": 4, "xxy": -1, "yyy": -1},
        {"xxz": 1, "yyz": -1},
        {"xyz": 1},
        {"xxx": 1, "xyy": -3},
        {"xxy": 3, "yyy": -1},
    ],
    4: [
        {"zzzz": 8, "xxzz": -24, "yyzz": -24, "xxxx": 3, "xxyy": 6, "yyyy": 3},
        {"xzzz": 4, "xxxz": -3, "xyyz": -3},
        {"yzzz": 4, "xxyz": -3, "yyyz": -3},
        {"xxzz": 6, "yyzz": -6, "xxxx": -1, "yyyy": 1},
        {"xyzz": 6, "xxxy": -1, "xyyy": -1},
        {"xxxz": 1, "xyyz": -3},
        {"xxyz": 3, "yyyz": -1},
        {"xxxx": 1, "xxyy": -6, "yyyy": 1},
        {"xxxy": 1, "xyyy": -1},
    ],
}
# Prior deviations of the coefficients, by their degree.
_DEVIATIONS = np.repeat([0.15, 0.08, 0.05], [len(rows) for rows in _HARMONICS.values()])
_SPHERE = 12  # rows of directions, by which a body is integrated
_FINE = 40  # the same for its extents
_BEYOND = 1.003  # extents, over those in these directions
_DIRECTIONS = 96  # in which the points of a cloud are counted
_NOISE = 0.05  # of the logarithm of their distance, in each direction
_MAX_START = 2.0  # of a start, in prior deviations
_NEARER = 0.6  # least distance to the boundary, over that along the radius

Directions = Float[np.ndarray, "n 3"]
Coefficients = Float[np.ndarray, "*draws harmonics"]


def _directions(rows: int) -> tuple[Directions, Float[np.ndarray, " n"]]:
    """Return directions and weights of a mean over the sphere, Gauss-Legendre by rows."""
    z, weights = np.polynomial.legendre.leggauss(rows)
    angles = 2.0 * np.pi * np.arange(2 * rows) / (2 * rows)
    across = np.sqrt(1.0 - z**2)[:, None]
    parts = (
        across * np.cos(angles),
        across * np.sin(angles),
        np.broadcast_to(z[:, None], (rows, 2 * rows)),
    )
    return np.stack(parts, axis=-1).reshape(-1, 3), np.repeat(weights, 2 * rows) / (4.0 * rows)


class _Harmonics:
    """Harmonics of degree 2 to 4, of mean square one over the sphere, and their gradients.

    They are polynomials, as functions of angles have no derivative at the poles.
    """

    def __init__(self) -> None:
        rows = [row for group in _HARMONICS.values() for row in group]
        names = sorted({name for row in rows for name in row})
        self._powers = np.array([[name.count(axis) for axis in "xyz"] for name in names])
        self._factors = np.array([[row.get(name, 0.0) for name in names] for row in rows])
        directions, weights = _directions(_SPHERE)
        self._factors /= np.sqrt(self.of(directions) ** 2 @ weights)[:, None]

    def of(self, directions: Directions) -> Float[np.ndarray, "harmonics n"]:
        """Return the values in directions."""
        table = _table(directions)
        return np.asarray(self._factors @ [_product(table, row) for row in self._powers])

    def gradient(
        self, directions: Directions, coefficients: Float[np.ndarray, " harmonics"]
    ) -> Float[np.ndarray, "3 n"]:
        """Return the gradient of a sum over the sphere, per radian."""
        table, weights = _table(directions), coefficients @ self._factors
        gradient = np.zeros((3, len(directions)))
        for weight, row in zip(weights, self._powers, strict=True):
            for axis in np.flatnonzero(row):
                lower = row - np.eye(3, dtype=int)[axis]
                gradient[axis] += weight * row[axis] * _product(table, lower)
        # Euler's theorem: the radial part of a homogeneous polynomial is its degree times it.
        return gradient - (gradient * directions.T).sum(axis=0) * directions.T


def _table(directions: Directions) -> Float[np.ndarray, "3 5 n"]:
    """Return the powers 0 to 4 of the components."""
    powers = np.ones((3, 5, len(directions)))
    for k in range(1, 5):
        powers[:, k] = powers[:, k - 1] * directions.T
    return powers


def _product(
    table: Float[np.ndarray, "3 5 n"], powers: Int[np.ndarray, "3"]
) -> Float[np.ndarray, " n"]:
    parts = [table[axis, power] for axis, power in enumerate(powers) if power]
    product: np.ndarray = reduce(np.multiply, parts)
    return product


_SUMS = _Harmonics()
_AROUND, _WEIGHTS = _directions(_SPHERE)
_AT_AROUND = _SUMS.of(_AROUND)
_FINELY = _directions(_FINE)[0]
_AT_FINELY = _SUMS.of(_FINELY)


def _log_mean_cube(coefficients: Coefficients) -> Float[np.ndarray, " *draws"]:
    """Return a third of the logarithm of the mean cube of the distances, for radius one."""
    return np.asarray(np.log(np.exp(3.0 * coefficients @ _AT_AROUND) @ _WEIGHTS) / 3.0)


def _offset(
    log_radius: Float[np.ndarray, " *draws"], coefficients: Coefficients
) -> Float[np.ndarray, "*draws 3"]:
    """Return the centre of volume, from the centre, mm."""
    logs = coefficients @ _AT_AROUND - _log_mean_cube(coefficients)[..., None]
    return 0.75 * np.exp(log_radius)[..., None] * ((np.exp(4.0 * logs) * _WEIGHTS) @ _AROUND)


@dataclass(frozen=True)
class StarShape(InclusionShape):
    """A star-shaped body; the semi-axes are those of the ellipsoid of its moments of inertia.

    Attributes:
        ball_mm: Radius of the ball of its volume.
        coefficients: Coefficients of the harmonics.
    """

    ball_mm: float
    coefficients: tuple[float, ...]

    @property
    def form(self) -> str:
        """Noun for the form."""
        return "irregular lump"

    def distance(self, points: Directions) -> Float[np.ndarray, " n"]:
        """Return the distance to the boundary along the radius (mm), negative inside."""
        offsets = points - self.center_mm
        apart = length(offsets)
        return np.asarray(apart - self._radii(_SUMS.of(offsets / apart[:, None])))

    def _radii(self, harmonics: Float[np.ndarray, "harmonics n"]) -> Float[np.ndarray, " n"]:
        coefficients = np.array(self.coefficients)
        logs = coefficients @ harmonics - _log_mean_cube(coefficients)
        return np.asarray(self.ball_mm * np.exp(logs))

    @property
    def radius_mm(self) -> float:
        """Radius of the ball of the same volume."""
        return self.ball_mm

    @property
    def centroid_mm(self) -> Float[np.ndarray, "3"]:
        """Centre of volume, mm."""
        return self.center_mm + _offset(np.log([self.ball_mm]), np.array([self.coefficients]))[0]

    @property
    def extents_mm(self) -> Float[np.ndarray, "2 3"]:
        """Lowest and highest coordinates, from the centre."""
        points = _BEYOND * self._radii(_AT_FINELY)[:, None] * _FINELY
        return np.stack([points.min(axis=0), points.max(axis=0)])

    def surface(self, segments: int = 48) -> TriangleSurface:
        """Return vertices (mm) and outward triangles; see `tactorch.mesh.Shape.surface`."""
        directions, triangles = Sphere().surface(2 * segments)
        radii = self._radii(_SUMS.of(directions))
        return radii[:, None] * directions + self.center_mm, triangles


class StarFamily(Family):
    """Irregular lumps: centre, radius of the ball of the same volume, contrast and coefficients."""

    name = judged_as = "irregular lump"
    noun = "an irregular lump"
    distortions = tuple(f"harmonic {k}" for k in range(len(_DEVIATIONS)))

    def scale(self, prior: ShapePrior) -> tuple[list[float], list[float]]:
        mean, deviation = super().scale(prior)
        return mean, [*deviation[: len(COMMON)], *_DEVIATIONS.tolist()]

    def like(self, cloud: Cloud) -> Values:
        """Return the body whose distances follow from the number of points in each direction."""
        turns = np.arange(_DIRECTIONS) + 0.5
        z, angles = 1.0 - 2.0 * turns / _DIRECTIONS, np.pi * (1.0 + np.sqrt(5.0)) * turns
        across = np.sqrt(1.0 - z**2)
        directions = np.stack([across * np.cos(angles), across * np.sin(angles), z], axis=1)
        nearest = ((cloud.points - cloud.center) @ directions.T).argmax(axis=1)
        counts = np.bincount(nearest, minlength=_DIRECTIONS)
        logs = np.log(np.maximum(counts / counts.mean(), 0.1)) / 3.0
        matrix = np.vstack([_SUMS.of(directions).T / _NOISE, np.diag(1.0 / _DEVIATIONS)])
        values = np.concatenate([(logs - logs.mean()) / _NOISE, np.zeros(len(_DEVIATIONS))])
        found = np.linalg.lstsq(matrix, values, rcond=None)[0]
        found = np.clip(found, -_MAX_START * _DEVIATIONS, _MAX_START * _DEVIATIONS)
        return np.array([*cloud.center, cloud.log_radius, cloud.log_contrast, *found])

    def shape(self, own: Parameters) -> InclusionShape:
        ball, coefficients = float(np.exp(own.log_radius)), own.distortions
        logs = coefficients @ _AT_AROUND - _log_mean_cube(coefficients)
        moments = 0.6 * ball**2 * (_AROUND.T * (np.exp(5.0 * logs) * _WEIGHTS)) @ _AROUND
        offset = _offset(own.log_radius, coefficients)
        squares, axes = np.linalg.eigh(moments - np.outer(offset, offset))
        return StarShape(
            tuple(own.center.tolist()),
            tuple(np.sqrt(5.0 * squares[::-1]).tolist()),
            tuple(tuple(row) for row in axes.T[::-1].tolist()),
            float(np.exp(own.log_contrast)),
            ball,
            tuple(coefficients.tolist()),
        )

    def centroids(self, own: Parameters) -> Float[np.ndarray, "*draws 3"]:
        return own.center + _offset(own.log_radius, own.distortions)

    def distance(self, own: Parameters, points: Samples) -> Distances:
        offsets = points.reshape(-1, 3) - own.center
        apart = length(offsets)
        radii = self._radii(own, _SUMS.of(offsets / apart[:, None]))
        return np.asarray((apart - radii).reshape(points.shape[:-1]))

    def _radii(
        self, own: Parameters, values: Float[np.ndarray, "harmonics n"]
    ) -> Float[np.ndarray, " n"]:
        logs = own.distortions @ values - _log_mean_cube(own.distortions)
        return np.asarray(np.exp(own.log_radius + logs))

    def distance_derivative(self, own: Parameters, points: Samples) -> tuple[Distances, Slopes]:
        offsets = points.reshape(-1, 3) - own.center
        apart = length(offsets)
        directions = offsets / apart[:, None]
        values = _SUMS.of(directions)
        radii = self._radii(own, values)
        cubes = np.exp(3.0 * own.distortions @ _AT_AROUND) * _WEIGHTS
        mean = _AT_AROUND @ cubes / cubes.sum()
        turn = radii / apart * _SUMS.gradient(directions, own.distortions)
        slopes = np.vstack([turn - directions.T, -radii, -radii * (values - mean[:, None])])
        shape = points.shape[:-1]
        return (apart - radii).reshape(shape), slopes.reshape(len(slopes), *shape)

    def least_distance(
        self, own: Parameters, points: Float[np.ndarray, "n 3"]
    ) -> Float[np.ndarray, " n"]:
        return _NEARER * super().least_distance(own, points)


STAR = StarFamily()
