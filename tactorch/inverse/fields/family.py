"""Families of inclusions: their parameters, prior, modulus at sample points, and relations.

An inclusion is the image of a shape of the volume of the unit ball, by exp(S) with a symmetric
matrix S, and a boundary of a width. The trace of S is three times the log-radius; the other part is
the sum of distortions, each a coefficient of a matrix without trace. The logarithm of the modulus
at a quadrature point is that of the background plus, for each inclusion, its log-contrast times the
fraction of the point's volume inside: the geometric mean. An arithmetic mean is too stiff where a
boundary crosses an element.
"""

from abc import ABC, abstractmethod
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from scipy.special import expit

from tactorch.config import Registry
from tactorch.inverse.fields.inclusion import (
    CENTER,
    COMMON,
    Candidate,
    Cloud,
    InclusionShape,
    Parameters,
)
from tactorch.inverse.fields.prior import ShapePrior
from tactorch.inverse.fields.sites import Sites

#: Families by name. A family is an object of a class in one file, and a line here.
FAMILIES = Registry(
    "inclusion",
    {
        "ball": "tactorch.inverse.fields.ball:BALL",
        "ellipsoid": "tactorch.inverse.fields.ellipsoid:ELLIPSOID",
        "cuboid": "tactorch.inverse.fields.cuboid:CUBOID",
        "rod": "tactorch.inverse.fields.tube:ROD",
        "tapered rod": "tactorch.inverse.fields.tube:TAPERED_ROD",
        "bent rod": "tactorch.inverse.fields.tube:BENT_ROD",
        "ring": "tactorch.inverse.fields.tube:RING",
        "irregular lump": "tactorch.inverse.fields.star:STAR",
    },
)

_X, _Y, _Z = np.eye(3)
#: Orthonormal basis of symmetric matrices without trace: distortions of the same volume.
DISTORTIONS = {
    "x-y": np.diag([1.0, -1.0, 0.0]) / np.sqrt(2.0),
    "xy-z": np.diag([1.0, 1.0, -2.0]) / np.sqrt(6.0),
    "xy": (np.outer(_X, _Y) + np.outer(_Y, _X)) / np.sqrt(2.0),
    "xz": (np.outer(_X, _Z) + np.outer(_Z, _X)) / np.sqrt(2.0),
    "yz": (np.outer(_Y, _Z) + np.outer(_Z, _Y)) / np.sqrt(2.0),
}
_RADIUS = 0.15  # mean radius of the prior, over the body's size
VARIANCE = np.pi**2 / 12.0  # of the logistic distribution whose density is a boundary of width one
_TINY = 1e-12  # mm2, for the derivative of a length at zero

Values = Float[np.ndarray, " parameters"]
Samples = Float[np.ndarray, "volumes samples 3"]
Distances = Float[np.ndarray, "volumes samples"]
Slopes = Float[np.ndarray, "k volumes samples"]
Widths = Float[np.ndarray, " volumes"]


class Family(ABC):
    """A family of inclusions.

    Attributes:
        name: Its name in `FAMILIES`.
        noun: The name with its article.
        distortions: Names of the parameters beside those that all inclusions have; the first are
            of `DISTORTIONS`.
        shape_type: The body that is stretched.
        special: Names of families that a search tries as this one, from the same values of the
            parameters that both have.
        judged_as: Name of the family by which the posterior is computed: the data that make a ball
            the most probable model do not exclude an ellipsoid.
    """

    name: str
    noun: str
    distortions: tuple[str, ...] = ()
    shape_type: type[InclusionShape] = InclusionShape
    special: tuple[str, ...] = ()
    judged_as: str

    @cached_property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return (*COMMON, *self.distortions)

    def scale(self, prior: ShapePrior) -> tuple[list[float], list[float]]:
        """Return mean and deviation of the parameters, mm and logarithms."""
        middle, half = 0.5 * (prior.low_mm + prior.high_mm), 0.5 * (prior.high_mm - prior.low_mm)
        count = len(self.distortions)
        mean = [*middle, np.log(_RADIUS * prior.size_mm), 0.0, *[0.0] * count]
        return mean, [*half, prior.log_radius, prior.log_contrast, *[prior.distortion] * count]

    def birth(self, candidate: Candidate) -> Values | None:
        """Return the parameters of a ball or a rod; None where the family is not for it."""
        return None

    @abstractmethod
    def like(self, cloud: Cloud) -> Values:
        """Return the parameters of the inclusion that resembles a cloud of points most."""

    def shape(self, own: Parameters) -> InclusionShape:
        """Return the body."""
        logs, vectors = np.linalg.eigh(self.log_stretch(own))
        order = np.argsort(-logs)
        semi_axes = np.exp(logs[order]) / np.cbrt(self.shape_type.unit_volume)
        return self.shape_type(
            tuple(own.center.tolist()),
            tuple(semi_axes.tolist()),
            tuple(tuple(row) for row in vectors.T[order].tolist()),
            float(np.exp(own.log_contrast)),
        )

    def centroids(self, own: Parameters) -> Float[np.ndarray, "*draws 3"]:
        """Return the centre of volume, or that of each draw, mm."""
        return own.center

    @cached_property
    def basis(self) -> Float[np.ndarray, "k 3 3"]:
        """The matrices of the distortions."""
        known = [DISTORTIONS[name] for name in self.distortions if name in DISTORTIONS]
        return np.reshape(known, (-1, 3, 3))

    def log_stretch(self, own: Parameters) -> Float[np.ndarray, "3 3"]:
        """Return S, the logarithm of the matrix that maps the body of unit volume to this one."""
        stretches = own.distortions[: len(self.basis)]
        return own.log_radius * np.eye(3) + np.tensordot(stretches, self.basis, 1)

    def fractions(
        self, own: Parameters, sites: Sites
    ) -> tuple[Int[np.ndarray, " near"], Float[np.ndarray, " near"]]:
        """Return the volumes that the inclusion may touch, and the fraction of each inside."""
        near, border = self._near(own, sites)
        inside, at = np.ones(len(near)), near[border]
        inside[border] = self.fraction(own, sites.points[at], sites.width[at])
        return near, inside

    def fraction_derivative(
        self, own: Parameters, sites: Sites
    ) -> tuple[
        Int[np.ndarray, " near"], Float[np.ndarray, " near"], Float[np.ndarray, "near parameters"]
    ]:
        """Return `fractions`, and their derivatives by the parameters but the log-contrast."""
        near, border = self._near(own, sites)
        fractions, columns = np.ones(len(near)), np.zeros((len(near), len(self.parameters) - 1))
        points, width = sites.points[near[border]], sites.width[near[border]]
        distance, slopes = self.distance_derivative(own, points)
        slopes += self._shift_derivative(own, width)[:, :, None]
        inside = self._inside(own, distance, width)
        weights = inside * (1.0 - inside) * (-2.0 / width / points.shape[1])[:, None]
        fractions[border] = inside.mean(axis=1)
        columns[border] = np.einsum("vs,kvs->vk", weights, slopes)
        return near, fractions, columns

    def fraction(self, own: Parameters, points: Samples, width: Widths) -> Widths:
        """Return the fraction of each volume inside, by its sample points (mm).

        The boundary is sharp where its width (mm) is zero.
        """
        distance = self.distance(own, points)
        if not width.any():
            return np.asarray((distance < 0.0).mean(axis=1))
        return np.asarray(self._inside(own, distance, width).mean(axis=1))

    @abstractmethod
    def distance(self, own: Parameters, points: Samples) -> Distances:
        """Return the distance of points (mm) to the boundary, to first order, negative inside."""

    @abstractmethod
    def distance_derivative(self, own: Parameters, points: Samples) -> tuple[Distances, Slopes]:
        """Return `distance`, and its derivatives by centre, log-radius and distortions."""

    def _inside(self, own: Parameters, distance: Distances, width: Widths) -> Distances:
        scaled = -2.0 * (distance + self._shift(own, width)[:, None]) / width[:, None]
        return np.asarray(expit(scaled))

    def _shift(self, own: Parameters, width: Widths) -> Widths:
        """Shift of a smooth boundary (mm), which would enlarge a ball by its curvature."""
        return VARIANCE * width * width / np.exp(own.log_radius)

    def _shift_derivative(self, own: Parameters, width: Widths) -> Float[np.ndarray, "k volumes"]:
        """Return the derivatives of the shift by the parameters of `distance_derivative`."""
        slopes = np.zeros((len(self.parameters) - 1, len(width)))
        slopes[len(CENTER)] = -self._shift(own, width)
        return slopes

    def least_distance(
        self, own: Parameters, points: Float[np.ndarray, "n 3"]
    ) -> Float[np.ndarray, " n"]:
        """Return a distance of points (mm) to the boundary that is not exceeded, with its sign."""
        return self.distance(own, points[:, None])[:, 0]

    def _near(
        self, own: Parameters, sites: Sites
    ) -> tuple[Int[np.ndarray, " near"], Int[np.ndarray, " border"]]:
        """Return the volumes that an inclusion may touch, and which of these its boundary may."""
        distance, margin = self.least_distance(own, sites.centers), 4.0 * sites.width + sites.radii
        near = np.flatnonzero(distance < margin)
        return near, np.flatnonzero(distance[near] > -margin[near])


def length(vectors: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, " *n"]:
    """Return the lengths of vectors, with a derivative at zero."""
    return np.asarray(np.sqrt((vectors * vectors).sum(axis=-1) + _TINY))


def families_beyond(family: Family) -> list[Family]:
    """Return the families as which a search tries inclusions of one, see `Family.special`."""
    return [other for name in FAMILIES if family.name in (other := FAMILIES[name]).special]
