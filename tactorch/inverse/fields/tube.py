"""Rods, tapered and bent rods, and rings: all points within a radius of a curve.

The curve of a rod is p(t) = c + t h with the centre c, half its length h, and t from -1 to 1. The
radius of a tapered one is a + k |h| t, so that it is the convex hull of two balls. The curve of a
bent rod has (t^2 - 1/3) b beside it, with the part of b across h, and is taken as straight
between nodes. A ring is a circle about an axis whose length is the circle's radius. The radius of
the tube follows from the volume, to which rounded ends contribute.
"""

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from tactorch.inverse.fields.family import (
    VARIANCE,
    Distances,
    Family,
    Samples,
    Slopes,
    Values,
    Widths,
    length,
)
from tactorch.inverse.fields.inclusion import COMMON, Cloud, InclusionShape, Parameters
from tactorch.inverse.fields.prior import ShapePrior
from tactorch.mesh.surfaces import TriangleSurface, marching_cubes

_DEVIATION = 0.25  # of the components of vectors, over the body's size
_SEGMENTS = 8  # of a bent rod
_TAPER, _MAX_TAPER = 0.6, 0.8  # standard deviation, and the largest hyperbolic tangent of a start
# Length that a ring has beside that of its circle, over the radius of the ball of its volume: the
# radius of the tube remains finite where the circle shrinks to a point.
_RING_LENGTH = 0.5
# Of Newton's method for the radius of a tube: largest number of steps, and last relative step.
_STEPS, _CLOSE = 30, 1e-14
_COMPLEX = 1e-30  # imaginary step, for derivatives
_TINY = 1e-12  # mm2, for directions at zero

Points = Float[np.ndarray, "n 3"]
Vector = Float[np.ndarray, "3"]


class _Foot(NamedTuple):
    """Offsets of points from the nearest points of a polyline."""

    offset: Points
    segment: Int[np.ndarray, " n"]
    along: Float[np.ndarray, " n"]  # part of the segment before the nearest point


def _from_polyline(points: Points, nodes: Float[np.ndarray, "m 3"]) -> _Foot:
    middle = nodes.mean(axis=0)  # less round-off
    shifted, begins = points - middle, nodes[:-1] - middle
    sides = np.diff(nodes, axis=0)
    squares = (sides * sides).sum(axis=1) + _TINY
    along = shifted @ sides.T - (begins * sides).sum(axis=1)
    t = np.clip(along / squares, 0.0, 1.0)
    # Squared distances, less those of the points from the middle.
    apart = (begins * begins).sum(axis=1) - 2.0 * (shifted @ begins.T)
    apart -= t * (2.0 * along - t * squares)
    segment = apart.argmin(axis=1)
    t = t[np.arange(len(points)), segment]
    return _Foot(shifted - begins[segment] - t[:, None] * sides[segment], segment, t)


def _from_circle(points: Points, center: Vector, axis: Vector) -> tuple[Points, Points]:
    """Return offsets of points from the nearest ones of a circle, whose directions are second."""
    apart, radius = points - center, float(length(axis))
    across = apart - np.outer(apart @ axis, axis) / radius**2
    outward = across / length(across)[:, None]
    return apart - radius * outward, outward


def _from_tapered(
    points: Points, center: Vector, half: Vector, slope: float
) -> tuple[Points, Float[np.ndarray, " n"]]:
    """Return offsets of points from those of an axis whose balls are nearest, and t of these.

    The radius of the balls changes with the position along the axis by the slope, below one.
    """
    size = float(length(half))
    apart, along = points - center, half / size
    y = apart @ along
    across = length(apart - np.outer(y, along))
    t = np.clip((y + across * slope / np.sqrt(1.0 - slope**2)) / size, -1.0, 1.0)
    return apart - np.outer(t, half), t


@dataclass(frozen=True)
class TubeShape(InclusionShape):
    """All points within a radius of a curve; the semi-axes are half the extents along its axes.

    Attributes:
        nodes_mm: Nodes of the curve of a rod; the axis of the circle of a ring, alone.
        tube_mm: Radius of the tube, at the centre of a tapered rod.
        ball_mm: Radius of the ball of its volume.
        balance_mm: Centre of volume, from the centre.
        slope: Change of the radius of a rod along it.
    """

    nodes_mm: tuple[tuple[float, ...], ...]
    tube_mm: float
    ball_mm: float
    balance_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    slope: float = 0.0

    @property
    def form(self) -> str:
        """Noun for the form."""
        if self.slope:
            return "tapered rod"
        return {1: "ring", 2: "rod"}.get(len(self.nodes_mm), "bent rod")

    def distance(self, points: Points) -> Float[np.ndarray, " n"]:
        """Return the distance to the boundary (mm), negative inside."""
        offsets, radii = self._offsets(points)
        return length(offsets) - radii

    def _offsets(self, points: Points) -> tuple[Points, Float[np.ndarray, " n"]]:
        """Return offsets of points from the curve, and the radii there."""
        nodes, center = np.array(self.nodes_mm), np.array(self.center_mm)
        radii = np.full(len(points), self.tube_mm)
        if len(nodes) == 1:
            return _from_circle(points, center, nodes[0])[0], radii
        if self.slope:
            half = nodes[1] - center
            offsets, t = _from_tapered(points, center, half, self.slope)
            return offsets, radii + self.slope * float(length(half)) * t
        return _from_polyline(points, nodes).offset, radii

    @property
    def radius_mm(self) -> float:
        """Radius of the ball of the same volume."""
        return self.ball_mm

    @property
    def centroid_mm(self) -> Vector:
        """Centre of volume, mm."""
        return np.add(self.center_mm, self.balance_mm)

    @property
    def detail_mm(self) -> float:
        """Mean of the radii of the tube and of the ball of its volume, geometric."""
        return float(np.sqrt(self.tube_mm * self.ball_mm))

    @property
    def extents_mm(self) -> Float[np.ndarray, "2 3"]:
        """Lowest and highest coordinates, from the centre."""
        nodes = np.array(self.nodes_mm)
        if len(nodes) == 1:
            across = np.sqrt(np.maximum(nodes[0] @ nodes[0] - nodes[0] ** 2, 0.0))
            return np.outer([-1.0, 1.0], across + self.tube_mm)
        nodes = nodes - self.center_mm
        t = np.linspace(-1.0, 1.0, len(nodes))[:, None]
        radii = self.tube_mm + self.slope * float(length(nodes[-1])) * t
        return np.stack([(nodes - radii).min(axis=0), (nodes + radii).max(axis=0)])

    def surface(self, segments: int = 48) -> TriangleSurface:
        """Return vertices (mm) and outward triangles; the number of segments has no effect."""
        bounds = np.array(self.center_mm) + np.outer([-1.0, 1.0], self.half_size_mm)
        vertices, triangles = marching_cubes(self.distance, bounds, "an inclusion")
        offsets, radii = self._offsets(vertices)
        beyond = 1.0 - radii / length(offsets)
        return vertices - beyond[:, None] * offsets, triangles


class TubeFamily(Family):
    """Tubes: centre, radius of the ball of the same volume, contrast and vectors of the curve."""

    vectors: tuple[str, ...]

    def __init__(self) -> None:
        self.judged_as = self.name
        self.noun = f"a {self.name}"
        self.distortions = tuple(f"{vector} {axis}" for vector in self.vectors for axis in "xyz")

    @abstractmethod
    def offsets(self, own: Parameters, points: Points) -> tuple[Points, Float[np.ndarray, "k n"]]:
        """Return offsets of points from the curve, and derivatives of distances by its vectors."""

    @abstractmethod
    def length(self, own: Parameters) -> tuple[float, Float[np.ndarray, " k"]]:
        """Return the length of the curve (mm), and its derivatives by the vectors."""

    @abstractmethod
    def vectors_of(self, cloud: Cloud) -> Float[np.ndarray, "vectors 3"]:
        """Return the vectors of the curve through a cloud of points."""

    @abstractmethod
    def nodes(self, own: Parameters) -> Float[np.ndarray, "m 3"]:
        """Return `TubeShape.nodes_mm`."""

    def scale(self, prior: ShapePrior) -> tuple[list[float], list[float]]:
        mean, deviation = super().scale(prior)
        count = len(self.distortions)
        return mean, [*deviation[: len(COMMON)], *[_DEVIATION * prior.size_mm] * count]

    def like(self, cloud: Cloud) -> Values:
        vectors = self.vectors_of(cloud).ravel()
        return np.array([*cloud.center, cloud.log_radius, cloud.log_contrast, *vectors])

    def shape(self, own: Parameters) -> InclusionShape:
        half, axes = self.extents(own)
        return TubeShape(
            tuple(own.center.tolist()),
            tuple((half + self._radius(own)[0]).tolist()),
            tuple(tuple(row) for row in axes.tolist()),
            float(np.exp(own.log_contrast)),
            tuple(tuple(row) for row in self.nodes(own).tolist()),
            self._radius(own)[0],
            float(np.exp(own.log_radius)),
            tuple(self.balance(own).tolist()),
        )

    def centroids(self, own: Parameters) -> Float[np.ndarray, "*draws 3"]:
        if own.center.ndim == 1:
            return own.center + self.balance(own)
        return np.array([self.centroids(Parameters(*draw)) for draw in zip(*own, strict=True)])

    def balance(self, own: Parameters) -> Vector:
        """Return the centre of volume, from the centre, mm."""
        return np.zeros(3)

    def extents(self, own: Parameters) -> tuple[Vector, Float[np.ndarray, "3 3"]]:
        """Return half the extents of the curve along its principal axes, and these, the rows."""
        offsets = self.nodes(own) - own.center
        axes = np.linalg.svd(offsets, full_matrices=True)[2]
        half: Vector = np.abs(offsets @ axes.T).max(axis=0)
        order = np.argsort(-half)
        return half[order], axes[order]

    def distance(self, own: Parameters, points: Samples) -> Distances:
        offsets = self.offsets(own, points.reshape(-1, 3))[0]
        return length(offsets).reshape(points.shape[:-1]) - self._radius(own)[0]

    def distance_derivative(self, own: Parameters, points: Samples) -> tuple[Distances, Slopes]:
        offsets, vectors = self.offsets(own, points.reshape(-1, 3))
        radius, by_size, by_vectors = self._radius(own)
        distances = length(offsets)
        sizes = np.full((1, len(offsets)), -by_size)
        slopes = [-offsets.T / distances, sizes, vectors - by_vectors[:, None]]
        shape = points.shape[:-1]
        stacked = np.concatenate(slopes)
        return distances.reshape(shape) - radius, stacked.reshape(len(stacked), *shape)

    def _shift(self, own: Parameters, width: Widths) -> Widths:
        return 0.5 * VARIANCE * width * width / self._radius(own)[0]

    def _shift_derivative(self, own: Parameters, width: Widths) -> Float[np.ndarray, "k volumes"]:
        radius, by_size, by_vectors = self._radius(own)
        slopes = np.concatenate([np.zeros(3), [by_size], by_vectors])
        return -np.outer(slopes, self._shift(own, width)) / radius

    def _radius(self, own: Parameters) -> tuple[float, float, Float[np.ndarray, " k"]]:
        """Return the tube's radius (mm), and its derivatives by log-radius and vectors.

        The volumes of tube and ball, over that of the unit ball, are a^2 L 3/4 + a^3 = R^3.
        """
        total, by_vectors = self.length(own)
        ball = float(np.exp(own.log_radius))
        radius = _solved(lambda a: 0.75 * total * a**2 + a**3, ball)
        slope = 1.5 * total * radius + 3.0 * radius**2
        return radius, 3.0 * ball**3 / slope, -0.75 * radius**2 / slope * by_vectors


class RodFamily(TubeFamily):
    """Straight rods."""

    name = "rod"
    vectors: tuple[str, ...] = ("half",)

    def curve(self, own: Parameters) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, "m 3 k"]]:
        """Return nodes of the curve about its centre, and their derivatives by the vectors."""
        ends = np.array([-1.0, 1.0])
        return np.outer(ends, own.distortions), ends[:, None, None] * np.eye(3)

    def vectors_of(self, cloud: Cloud) -> Float[np.ndarray, "vectors 3"]:
        deviations, axes = cloud.principal()
        # That of a disc is half its radius; of a line, its length over the root of twelve.
        half = np.sqrt(3.0) * deviations[0] - 0.95 * np.hypot(*deviations[1:])
        return np.maximum(half, 0.5 * deviations[0]) * axes[:1]

    def nodes(self, own: Parameters) -> Float[np.ndarray, "m 3"]:
        return own.center + self.curve(own)[0]

    def offsets(self, own: Parameters, points: Points) -> tuple[Points, Float[np.ndarray, "k n"]]:
        nodes, slopes = self.curve(own)
        foot = _from_polyline(points, own.center + nodes)
        away = foot.offset / length(foot.offset)[:, None]
        by_nodes = [np.einsum("nd,ndk->kn", away, slopes[foot.segment + end]) for end in (0, 1)]
        return foot.offset, -(1.0 - foot.along) * by_nodes[0] - foot.along * by_nodes[1]

    def length(self, own: Parameters) -> tuple[float, Float[np.ndarray, " k"]]:
        nodes, slopes = self.curve(own)
        sides = np.diff(nodes, axis=0)
        lengths = length(sides)
        along = sides / lengths[:, None]
        return float(lengths.sum()), np.einsum("md,mdk->k", along, np.diff(slopes, axis=0))


class TaperedRodFamily(RodFamily):
    """Rods that are thicker at one end: the convex hulls of two balls.

    The slope of the radius is k = q / (1 + q^2)^(1/2) with q = a tanh(taper) / |h| and the radius a
    at the centre.
    """

    name = "tapered rod"

    def __init__(self) -> None:
        super().__init__()
        self.distortions = (*self.distortions, "taper")

    def scale(self, prior: ShapePrior) -> tuple[list[float], list[float]]:
        mean, deviation = super().scale(prior)
        return mean, [*deviation[:-1], _TAPER]

    def like(self, cloud: Cloud) -> Values:
        half = self.vectors_of(cloud)[0]
        t = (cloud.points - cloud.center) @ half / float(half @ half)
        squares = ((cloud.points - cloud.center - np.outer(t, half)) ** 2).sum(axis=1)
        # The mean square of the distance from the axis is half that of the radius.
        slope, mean = np.polyfit(t, squares, 1)
        taper = np.arctanh(np.clip(0.5 * slope / max(mean, _TINY), -_MAX_TAPER, _MAX_TAPER))
        return np.array([*cloud.center, cloud.log_radius, cloud.log_contrast, *half, taper])

    def curve(self, own: Parameters) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, "m 3 k"]]:
        return super().curve(own._replace(distortions=own.distortions[:3]))

    def shape(self, own: Parameters) -> InclusionShape:
        shape = super().shape(own)
        assert isinstance(shape, TubeShape)
        return replace(shape, slope=self._sizes(own)[-1])

    def balance(self, own: Parameters) -> Vector:
        """Return the centre of volume, from the centre: of the frustum and its two caps, mm."""
        radius, size, _, ball, slope = self._sizes(own)
        balls = radius + slope * size * np.array([-1.0, 1.0])
        ends = np.array([-size, size])
        (first, last), circles = ends - slope * balls, balls * np.sqrt(1.0 - slope**2)
        total = 0.0
        for part, (low, high) in enumerate(
            [(-size - balls[0], first), (first, last), (last, size + balls[1])]
        ):
            # Areas are squares of positions, so that two points are exact.
            y = 0.5 * (low + high) + 0.5 * (high - low) * np.array([-1.0, 1.0]) / np.sqrt(3.0)
            if part == 1:
                area = np.interp(y, (first, last), circles) ** 2
            else:
                area = balls[part // 2] ** 2 - (y - ends[part // 2]) ** 2
            total += 0.5 * (high - low) * float(area @ y)
        return own.distortions[:3] / size * (0.75 * total / ball**3)

    def distance(self, own: Parameters, points: Samples) -> Distances:
        radius, size, _, _, slope = self._sizes(own)
        half = own.distortions[:3]
        offsets, t = _from_tapered(points.reshape(-1, 3), own.center, half, slope)
        return (length(offsets) - radius - slope * size * t).reshape(points.shape[:-1])

    def distance_derivative(self, own: Parameters, points: Samples) -> tuple[Distances, Slopes]:
        (radius, size, taper, _, slope), half = self._sizes(own), own.distortions[:3]
        offsets, t = _from_tapered(points.reshape(-1, 3), own.center, half, slope)
        distances = length(offsets)
        away = offsets.T / distances
        _, by_size, by_vectors = self._radius(own)
        by_radius, by_length, by_taper = _gradient(_slope, radius, size, taper)
        along, within = half / size, 1.0 - taper**2
        # Of the slope times the length, by log-radius, vector and taper, as of the radius.
        ends = np.concatenate([[by_radius * by_size], by_radius * by_vectors])
        ends[1:4] += by_length * along
        ends[4] += by_taper * within
        ends *= size
        ends[1:4] += slope * along
        radii = np.concatenate([[by_size], by_vectors])[:, None] + np.outer(ends, t)
        slopes = np.concatenate([-away, -radii])
        slopes[4:7] -= away * t
        shape = points.shape[:-1]
        values = distances - radius - slope * size * t
        return values.reshape(shape), slopes.reshape(len(slopes), *shape)

    def _radius(self, own: Parameters) -> tuple[float, float, Float[np.ndarray, " k"]]:
        """Return the radius at the centre, and its derivatives by log-radius, vector and taper."""
        radius, size, taper, ball, _ = self._sizes(own)
        by_radius, by_size, by_taper = _gradient(_volume, radius, size, taper)
        along = own.distortions[:3] / size
        others = np.array([*(-by_size / by_radius * along), -by_taper / by_radius * (1 - taper**2)])
        return radius, 3.0 * ball**3 / by_radius, others

    def _sizes(self, own: Parameters) -> tuple[float, float, float, float, float]:
        """Return radius at the centre, half the length, taper, the ball's radius, and slope."""
        size, taper = float(length(own.distortions[:3])), float(np.tanh(own.distortions[3]))
        ball = float(np.exp(own.log_radius))
        radius = _solved(lambda a: _volume(a, size, taper), ball)
        return radius, size, taper, ball, float(_slope(radius, size, taper).real)


class BentRodFamily(RodFamily):
    """Rods that are bent in a plane."""

    name = "bent rod"
    vectors: tuple[str, ...] = ("half", "bend")

    def curve(self, own: Parameters) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, "m 3 k"]]:
        half, bend = own.distortions.reshape(2, 3)
        t = np.linspace(-1.0, 1.0, _SEGMENTS + 1)
        f = t**2 - 1.0 / 3.0
        square, part = float(half @ half) + _TINY, float(half @ bend)
        across = np.eye(3) - np.outer(half, half) / square
        by_half = -np.outer(half, bend) / square - part / square * np.eye(3)
        by_half += 2.0 * part / square**2 * np.outer(half, half)
        slopes = np.multiply.outer(t, np.eye(3)) + np.multiply.outer(f, by_half)
        slopes = np.concatenate([slopes, np.multiply.outer(f, across)], axis=2)
        return np.outer(t, half) + np.outer(f, across @ bend), slopes

    def balance(self, own: Parameters) -> Vector:
        """Return the centre of volume, from the centre: of the tube and the halves of a ball, mm.

        Where the tube bends, its centre of volume is outside the curve by as much as the halves of
        the ball are beyond the ends.
        """
        nodes, radius = self.curve(own)[0], self._radius(own)[0]
        lengths = length(np.diff(nodes, axis=0))
        middles = 0.5 * (nodes[1:] + nodes[:-1])
        total = lengths @ middles + 2.0 / 3.0 * radius * (nodes[0] + nodes[-1])
        return np.asarray(total / (lengths.sum() + 4.0 / 3.0 * radius))

    def vectors_of(self, cloud: Cloud) -> Float[np.ndarray, "vectors 3"]:
        """Return the vectors of the parabola through the points."""
        half = super().vectors_of(cloud)[0]
        t = (cloud.points - cloud.center) @ half / float(half @ half)
        columns = np.stack([np.ones_like(t), t, t**2 - 1.0 / 3.0], axis=1)
        fitted = np.linalg.lstsq(columns, cloud.points - cloud.center, rcond=None)[0]
        return np.stack([half, fitted[2]])


class RingFamily(TubeFamily):
    """Rings about an axis."""

    name = "ring"
    vectors: tuple[str, ...] = ("axis",)

    def vectors_of(self, cloud: Cloud) -> Float[np.ndarray, "vectors 3"]:
        deviations, axes = cloud.principal()
        return float(np.hypot(*deviations[:2])) * axes[2:]

    def nodes(self, own: Parameters) -> Float[np.ndarray, "m 3"]:
        return own.distortions[None]

    def extents(self, own: Parameters) -> tuple[Vector, Float[np.ndarray, "3 3"]]:
        axes = np.linalg.svd(own.distortions[None], full_matrices=True)[2][::-1]
        return float(length(own.distortions)) * np.array([1.0, 1.0, 0.0]), axes

    def offsets(self, own: Parameters, points: Points) -> tuple[Points, Float[np.ndarray, "k n"]]:
        offsets, outward = _from_circle(points, own.center, own.distortions)
        away = offsets / length(offsets)[:, None]
        normal = own.distortions / length(own.distortions)
        radial, along = (away * outward).sum(axis=1), away @ normal
        return offsets, along * outward.T - np.outer(normal, radial)

    def length(self, own: Parameters) -> tuple[float, Float[np.ndarray, " k"]]:
        around = 2.0 * np.pi * float(length(own.distortions))
        return around, 2.0 * np.pi * own.distortions / length(own.distortions)

    def _radius(self, own: Parameters) -> tuple[float, float, Float[np.ndarray, " k"]]:
        """Return the tube's radius, and its derivatives: a ring has no ends."""
        around, by_vectors = self.length(own)
        ball = float(np.exp(own.log_radius))
        least = _RING_LENGTH * ball
        total = float(np.hypot(around, least))
        radius = float(np.sqrt(4.0 / 3.0 * ball**3 / total))
        by_size = radius * (1.5 - 0.5 * (least / total) ** 2)
        return radius, by_size, -0.5 * radius * around / total**2 * by_vectors


def _slope(radius: complex, size: complex, taper: complex) -> complex:
    """Return the slope of the radius along a tapered rod."""
    ratio = radius * taper / size
    return ratio / np.sqrt(1.0 + ratio**2)


def _volume(radius: complex, size: complex, taper: complex) -> complex:
    """Return the volume of a tapered rod, over that of the unit ball.

    Between the circles where its cone touches the balls it is a frustum, and beyond them it has two
    caps.
    """
    slope = _slope(radius, size, taper)
    cosine = np.sqrt(1.0 - slope**2)
    volume: complex = 0.0
    for sign in (-1.0, 1.0):
        ball = radius + sign * slope * size
        height = ball * (1.0 + sign * slope)
        volume += height**2 * (3.0 * ball - height) / 4.0
    ends = [(radius + sign * slope * size) * cosine for sign in (-1.0, 1.0)]
    squares = ends[0] ** 2 + ends[0] * ends[1] + ends[1] ** 2
    return volume + size * cosine**2 * squares / 2.0


def _gradient(function: Callable[..., complex], *at: float) -> list[float]:
    """Return the derivatives of an analytic function by complex steps."""
    steps = _COMPLEX * 1j * np.eye(len(at))
    return [float(function(*(np.array(at) + step)).imag) / _COMPLEX for step in steps]


def _solved(volume: Callable[[complex], complex], ball: float) -> float:
    """Return the radius of a tube (mm) of the volume of a ball, by Newton's method from above.

    `volume` is an analytic function of the radius, over that of the unit ball.
    """
    radius = ball
    for _ in range(_STEPS):
        value = volume(radius + _COMPLEX * 1j)
        step = float(value.real - ball**3) / float(value.imag / _COMPLEX)
        radius -= step
        if abs(step) < _CLOSE * radius:
            break
    return radius


ROD, TAPERED_ROD, BENT_ROD = RodFamily(), TaperedRodFamily(), BentRodFamily()
RING = RingFamily()
