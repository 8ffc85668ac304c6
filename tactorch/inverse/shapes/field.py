"""Ellipsoids in a smooth or layered background as a field of Young's modulus.

The logarithm of the modulus at a quadrature point is that of the background plus, for each
inclusion, its log-contrast times the fraction of the point's volume inside the inclusion: the
geometric mean. An arithmetic mean is too stiff where a boundary crosses an element.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.polynomial.legendre import legvander
from scipy.linalg import expm

from tactorch.errors import ConfigError
from tactorch.fem.assembly import Assembly
from tactorch.inverse.shapes import strength
from tactorch.inverse.shapes.fractions import Geometry
from tactorch.mesh import TetMesh
from tactorch.mesh.quadrature import samples_around

_SMOOTH = "legendre"  # modes of a smooth background
_STEP = 1e-5  # of differences, in standard deviations of the prior
_WIDTH = 0.15  # width of a boundary over the cube root of the element's volume


@dataclass(frozen=True, eq=False)
class Sites:
    """The volumes for which a field gives moduli: those of the quadrature points.

    Attributes:
        points: Sample points of each volume, (volumes, samples, 3), mm.
        width: Width of a boundary in each volume, mm.
        shape: Shape of the array of moduli, (elements, quadrature points).
    """

    points: Float[np.ndarray, "volumes samples 3"]
    width: Float[np.ndarray, " volumes"]
    shape: tuple[int, int]

    @staticmethod
    def of(assembly: Assembly) -> "Sites":
        """Return the volumes around the quadrature points of a body's elements."""
        mesh, rule = assembly.discretisation.mesh, assembly.discretisation.element.points
        points = samples_around(rule) @ mesh.points[mesh.tets]
        shape = assembly.weights.shape
        width = _WIDTH * np.cbrt(np.repeat(assembly.volumes, shape[1]))
        return Sites(points.reshape(shape[0] * shape[1], -1, 3), width, shape)

    @cached_property
    def centers(self) -> Float[np.ndarray, "volumes 3"]:
        """Centre of each volume, mm."""
        return self.points.mean(axis=1)

    def fraction_inside(
        self, shape: "Ellipsoid", elements: Int[np.ndarray, " k"]
    ) -> Float[np.ndarray, " k"]:
        """Return the fraction of each of some elements inside an inclusion, by sample points."""
        points = self.points.reshape(self.shape[0], -1, 3)[elements]
        inside = shape.contains(points.reshape(-1, 3)).reshape(points.shape[:2])
        return np.asarray(inside.mean(axis=1))

    @staticmethod
    def at(points: Float[np.ndarray, "n 3"]) -> "Sites":
        """Return points (mm), at which boundaries are sharp."""
        return Sites(points[:, None], np.zeros(len(points)), (len(points), 1))


@dataclass(frozen=True)
class Ellipsoid:
    """An inclusion.

    Attributes:
        center_mm: Centre.
        semi_axes_mm: Semi-axes in descending order; equal for a ball.
        axes: Their directions, the rows of a rotation.
        contrast: Young's modulus over that of the background.
    """

    center_mm: tuple[float, float, float]
    semi_axes_mm: tuple[float, float, float]
    axes: tuple[tuple[float, float, float], ...]
    contrast: float

    def contains(self, points: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Return whether points (mm) are inside."""
        return self._level(points) <= 1.0

    def distance(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Return the distance to the boundary (mm), negative inside; exact for balls only."""
        return (self._level(points) - 1.0) * self.radius_mm

    def _level(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        relative = (points - self.center_mm) @ np.array(self.axes).T / np.array(self.semi_axes_mm)
        return np.linalg.norm(relative, axis=1)

    @property
    def radius_mm(self) -> float:
        """Radius of the ball of the same volume."""
        return float(np.cbrt(np.prod(self.semi_axes_mm)))


@dataclass(frozen=True, eq=False)
class ShapePrior:
    """Normal prior of the parameters of shapes, wide enough for any body.

    Centres are within the body's bounding box (one standard deviation is half its extent), radii
    around a seventh of its size, moduli of inclusions within a factor of four or so.

    Attributes:
        outside_mm: Standard deviation of the length by which an inclusion extends beyond the
            bounding box at each side, mm; None without such a penalty.
    """

    low_mm: Float[np.ndarray, "3"]
    high_mm: Float[np.ndarray, "3"]
    size_mm: float
    log_background: float

    background: float = 1.0
    mode: float = 0.4
    log_radius: float = 0.6
    distortion: float = 0.35
    log_contrast: float = 1.5
    outside_mm: float | None = None

    @staticmethod
    def of(mesh: TetMesh, background_mpa: float) -> "ShapePrior":
        """Return the prior for a body whose best uniform modulus is given."""
        low, high = mesh.points.min(axis=0), mesh.points.max(axis=0)
        return ShapePrior(low, high, float(np.cbrt(mesh.volumes.sum())), np.log(background_mpa))

    def plain(self) -> dict[str, Any]:
        """Return plain JSON values; the inverse of `of_plain`."""
        return {name: np.asarray(value).tolist() for name, value in vars(self).items()}

    @staticmethod
    def of_plain(plain: Mapping[str, Any]) -> "ShapePrior":
        """Return the prior from plain JSON values."""
        values: dict[str, Any] = dict(plain)
        low, high = (np.array(values.pop(name)) for name in ("low_mm", "high_mm"))
        return ShapePrior(low, high, **values)

    def mode_deviations(self, waves: Float[np.ndarray, "modes 3"]) -> Float[np.ndarray, " modes"]:
        """Return the deviation of the amplitude of each mode of a varying background.

        The amplitudes of the modes of a step, too, fall with the wave number.
        """
        return self.mode / np.linalg.norm(waves, axis=1)

    def modes_at(
        self, points: Float[np.ndarray, "n 3"], waves: Float[np.ndarray, "modes 3"]
    ) -> Float[np.ndarray, "n modes"]:
        """Return the modes of a layered background at points: cosines in the bounding box."""
        modes: np.ndarray = np.cos(np.pi * waves * self._relative(points)[:, None, :]).prod(axis=2)
        return modes

    def polynomials_at(
        self, points: Float[np.ndarray, "n 3"], degrees: Float[np.ndarray, "modes 3"]
    ) -> Float[np.ndarray, "n modes"]:
        """Return the modes of a smooth background at points: products of Legendre polynomials.

        Those of a smooth function fall faster than the cosines, which have no slope at the sides.
        They are one at the first corner of the bounding box, as the cosines are.
        """
        largest = int(degrees.max(initial=0.0))
        values = legvander(1.0 - 2.0 * self._relative(points), largest)
        powers = degrees.astype(int)
        modes: np.ndarray = np.ones((len(points), len(powers)))
        for axis in range(3):
            modes *= values[:, axis, powers[:, axis]]
        return modes

    def _relative(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Return positions in the bounding box, from 0 to 1."""
        return (points - self.low_mm) / (self.high_mm - self.low_mm)

    def ball(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean and deviation of centre (mm), log-radius and log-contrast."""
        mean = [*(0.5 * (self.low_mm + self.high_mm)), np.log(0.15 * self.size_mm), 0.0]
        deviation = [*(0.5 * (self.high_mm - self.low_mm)), self.log_radius, self.log_contrast]
        return np.array(mean), np.array(deviation)


@dataclass(frozen=True, eq=False)
class ShapeField:
    """A number of inclusions in a uniform, smooth or layered background.

    The parameters are in standard deviations of the prior: the log-modulus of the background, and
    the amplitudes of its modes; for each inclusion its centre, log-radius and log-contrast, and for
    an ellipsoid five distortions.

    Attributes:
        prior: Prior of the parameters.
        distorted: For each inclusion, whether it is an ellipsoid rather than a ball.
        degree: Largest sum of the wave numbers along x, y and z of a mode of the background.
        layers: Largest wave numbers of further modes along x, y or z alone, for layers across that
            axis.
    """

    prior: ShapePrior
    distorted: tuple[bool, ...] = ()
    degree: int = 0
    layers: tuple[int, int, int] = (0, 0, 0)

    def plain(self) -> dict[str, Any]:
        """Return plain JSON values; the inverse of `of`."""
        return {
            "prior": self.prior.plain(),
            "distorted": list(self.distorted),
            "degree": self.degree,
            "layers": list(self.layers),
            "smooth": _SMOOTH,
        }

    @staticmethod
    def of(plain: Mapping[str, Any]) -> "ShapeField":
        """Return the family from plain JSON values, of which others are left out.

        Raises:
            ConfigError: the background has the modes of an earlier version.
        """
        if plain["degree"] and plain.get("smooth") != _SMOOTH:
            raise ConfigError(
                "The shapes have a smooth background by the modes of an earlier version; fit them "
                "again with tactorch find."
            )
        prior = ShapePrior.of_plain(plain["prior"])
        layers = tuple(plain.get("layers", (0, 0, 0)))
        return ShapeField(prior, tuple(plain["distorted"]), plain["degree"], layers)

    @property
    def waves(self) -> Float[np.ndarray, "modes 3"]:
        """Wave numbers of the modes of the background along x, y and z; none if it is uniform.

        Those of the smooth part are first, and are the degrees of its polynomials.
        """
        return _wave_numbers(self.degree, self.layers)

    @property
    def n_smooth(self) -> int:
        """Number of modes of the smooth part of the background."""
        return len(_wave_numbers(self.degree, (0, 0, 0)))

    def modes_at(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n modes"]:
        """Return the modes of the background at points (mm)."""
        waves, count = self.waves, self.n_smooth
        smooth = self.prior.polynomials_at(points, waves[:count])
        return np.hstack([smooth, self.prior.modes_at(points, waves[count:])])

    @cached_property
    def _scale(self) -> tuple[np.ndarray, np.ndarray]:
        ball, spread = self.prior.ball()
        mean, deviation = [self.prior.log_background], [self.prior.background]
        modes = self.prior.mode_deviations(self.waves).tolist()
        mean, deviation = mean + [0.0] * len(modes), deviation + modes
        for distorted in self.distorted:
            mean += [*ball, *[0.0] * (5 * distorted)]
            deviation += [*spread, *[self.prior.distortion] * (5 * distorted)]
        return np.array(mean), np.array(deviation)

    @property
    def size(self) -> int:
        """Number of parameters."""
        return len(self._scale[0])

    @property
    def deviation(self) -> Float[np.ndarray, " size"]:
        """Standard deviations of the prior, mm and logarithms."""
        return self._scale[1]

    @property
    def n_background(self) -> int:
        """Number of parameters of the background."""
        return 1 + len(self.waves)

    @property
    def parts(self) -> list[slice]:
        """Parameters of each inclusion."""
        ends = np.cumsum(
            [self.n_background, *(10 if distorted else 5 for distorted in self.distorted)]
        )
        return [slice(int(a), int(b)) for a, b in pairwise(ends)]

    def physical(self, z: Float[np.ndarray, "*k size"]) -> Float[np.ndarray, "*k size"]:
        """Return parameters in mm and logarithms from those in standard deviations."""
        mean, deviation = self._scale
        return mean + deviation * z

    def standard(self, values: Float[np.ndarray, "*k size"]) -> Float[np.ndarray, "*k size"]:
        """Return parameters in standard deviations; the inverse of `physical`."""
        mean, deviation = self._scale
        return (values - mean) / deviation

    def moved(
        self, z: Float[np.ndarray, " size"], step: Float[np.ndarray, " size"]
    ) -> Float[np.ndarray, " size"]:
        """Return the parameters after a step, on which the data depend nearly linearly.

        Steps of squared radii and strengths of inclusions are straight, see
        `tactorch.inverse.shapes.strength`, which is `z + step` to first order only.
        """
        values, change = self.physical(z), self.deviation * step
        new = values + change
        for part in self.parts:
            logs = slice(part.start + 3, part.start + 5)
            new[logs] = strength.moved(values[logs], change[logs])
        return self.standard(new)

    def shapes(self, z: Float[np.ndarray, " size"]) -> Iterator[Ellipsoid]:
        """Yield the inclusions."""
        values = self.physical(z)
        for part in self.parts:
            logs, vectors = np.linalg.eigh(_geometry(values[part]).log_stretch)
            order = np.argsort(-logs)
            yield Ellipsoid(
                tuple(values[part][:3].tolist()),
                tuple(np.exp(logs[order]).tolist()),
                tuple(tuple(row) for row in vectors.T[order].tolist()),
                float(np.exp(values[part][4])),
            )

    def excess(self, z: Float[np.ndarray, " size"]) -> Float[np.ndarray, " sides"]:
        """Return how far inclusions extend beyond each side of the box, in standard deviations.

        There are six values for each inclusion where the prior restricts them, and otherwise none.
        """
        prior = self.prior
        if prior.outside_mm is None:
            return np.zeros(0)
        values, found = self.physical(z), [np.zeros(0)]
        for part in self.parts:
            inclusion = _geometry(values[part])
            half = np.sqrt(np.diag(expm(2.0 * inclusion.log_stretch)))
            beyond = [
                inclusion.center + half - prior.high_mm,
                prior.low_mm - inclusion.center + half,
            ]
            found.append(np.maximum(np.concatenate(beyond), 0.0) / prior.outside_mm)
        return np.concatenate(found)

    def penalty(self, z: Float[np.ndarray, " size"]) -> float:
        """Return minus the log-density of the prior, up to a constant of the family."""
        excess = self.excess(z)
        return 0.5 * float(z @ z + excess @ excess)

    def excess_jacobian(self, z: Float[np.ndarray, " size"]) -> Float[np.ndarray, "sides size"]:
        """Return the derivative of `excess` by the parameters, by central differences."""
        steps = _STEP * np.eye(self.size)
        columns = [
            (self.excess(z + step) - self.excess(z - step)) / (2.0 * _STEP) for step in steps
        ]
        return np.stack(columns, axis=1)

    def log_background(
        self, values: Float[np.ndarray, "k size"], points: Float[np.ndarray, "k 3"]
    ) -> Float[np.ndarray, " k"]:
        """Return the log-modulus of the background of each of k fields at one point (mm) each.

        `values` are in mm and logarithms; see `physical`.
        """
        modes = self.modes_at(points)
        return values[:, 0] + (modes * values[:, 1 : self.n_background]).sum(axis=1)

    def _background(self, sites: Sites) -> Float[np.ndarray, "volumes k"]:
        """Derivative of the background's log-modulus by its parameters."""
        one = np.ones((len(sites.points), 1))
        return np.hstack([one, self.modes_at(sites.centers)]) if len(self.waves) else one

    def log_youngs(self, z: Float[np.ndarray, " size"], sites: Sites) -> np.ndarray:
        """Return the log-modulus of each volume, log MPa."""
        values = self.physical(z)
        out = self._background(sites) @ values[: self.n_background]
        for part in self.parts:
            inclusion = _geometry(values[part])
            near = _near(inclusion, sites)
            out[near] += values[part][4] * inclusion.fraction(sites.points[near], sites.width[near])
        return out

    def log_youngs_of(
        self,
        z: Float[np.ndarray, " size"],
        sites: Sites,
        fractions: Sequence[Float[np.ndarray, " elements"]],
    ) -> np.ndarray:
        """Return the log-modulus of each volume, of elements in each inclusion by a fraction."""
        values = self.physical(z)
        out = self._background(sites) @ values[: self.n_background]
        for part, fraction in zip(self.parts, fractions, strict=True):
            out += values[part][4] * np.repeat(fraction, sites.shape[1])
        return out

    def jacobian(self, z: Float[np.ndarray, " size"], sites: Sites) -> np.ndarray:
        """Return the derivative of `log_youngs` by the parameters, (volumes, size)."""
        values, deviation = self.physical(z), self._scale[1]
        out = np.zeros((len(sites.points), self.size))
        out[:, : self.n_background] = self._background(sites)
        for part in self.parts:
            inclusion, contrast = _geometry(values[part]), values[part][4]
            near = _near(inclusion, sites)
            fraction, slopes = inclusion.derivative(sites.points[near], sites.width[near])
            columns = np.arange(part.start, part.stop)
            out[near, part.start + 4] = fraction
            out[np.ix_(near, np.delete(columns, 4))] = contrast * slopes
        return out * deviation


@cache
def _wave_numbers(degree: int, layers: tuple[int, int, int]) -> Float[np.ndarray, "modes 3"]:
    modes = [np.zeros((0, 3))]
    modes += [np.array([k], float) for k in np.ndindex(*[degree + 1] * 3) if 1 <= sum(k) <= degree]
    for axis, largest in zip(np.eye(3), layers, strict=True):
        modes.append(np.outer(np.arange(1, largest + 1), axis))
    return np.concatenate(modes)


def _geometry(inclusion: Float[np.ndarray, " parameters"]) -> Geometry:
    """Return the geometry of an inclusion of these parameters, mm and logarithms."""
    return Geometry(inclusion[:3], float(inclusion[3]), inclusion[5:])


def _near(inclusion: Geometry, sites: Sites) -> np.ndarray:
    """Indices of the volumes that may touch an inclusion."""
    stretch = inclusion.log_stretch
    shortest, longest = np.exp(np.linalg.eigvalsh(stretch)[[0, -1]])
    margin = 4.0 * sites.width
    apart = sites.points - inclusion.center
    distance = np.sqrt((apart * apart).sum(axis=2).min(axis=1))
    near = np.flatnonzero(distance < longest + margin)
    if longest > shortest:
        # The distance to an ellipsoid is at least that in the unit ball times the shortest axis.
        unit = apart[near] @ expm(-stretch)
        level = np.sqrt((unit * unit).sum(axis=2).min(axis=1))
        near = near[(level - 1.0) * shortest < margin[near]]
    return near
