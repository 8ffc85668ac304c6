"""Phantoms of curved outline: those of Fig. 4(e) to (g), 5(c) and 12.

They stand on the plane z = 0; lengths in mm, moduli in MPa.
"""

from dataclasses import dataclass

import numpy as np

from tactorch.config import Options, option
from tactorch.mesh import Cylinder, Hemisphere, Hyperboloid, Lathe, Shape, Sphere
from tactorch.phantoms.background import RandomField
from tactorch.phantoms.phantom import HOLE_MPA, Phantom

_ORIGIN = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class _SoftBody(Options):
    section = "phantom"
    youngs_mpa: float = option(0.2, "Young's modulus of the body", unit="MPa", gt=0)
    inclusion_mpa: float = option(1.0, "Young's modulus of the balls", unit="MPa", gt=0)

    def _phantom(self, body: Shape, *balls: Sphere) -> Phantom:
        return Phantom(body, [(ball, self.inclusion_mpa) for ball in balls], self.youngs_mpa)


@dataclass(frozen=True)
class _UprightCylinder(_SoftBody):
    diameter_mm: float = option(10.0, "Diameter of the cylinder", unit="mm", gt=0)
    height_mm: float = option(10.0, "Height of the cylinder", unit="mm", gt=0)

    @property
    def _body(self) -> Cylinder:
        radius = self.diameter_mm / 2
        return Cylinder((radius, radius, self.height_mm / 2), radius, self.height_mm)


@dataclass(frozen=True)
class CylinderSphere(_UprightCylinder):
    """Upright cylinder with a ball."""

    depth: float = option(0.4, "Depth of the ball's centre below the top, in heights", gt=0, lt=1)
    radius: float = option(0.2, "Radius of the ball, in diameters", gt=0)

    def build(self) -> Phantom:
        wide, high = self.diameter_mm, self.height_mm
        ball = Sphere((wide / 2, wide / 2, high * (1.0 - self.depth)), self.radius * wide)
        return self._phantom(self._body, ball)


@dataclass(frozen=True)
class CylinderHoleSphere(_UprightCylinder):
    """Upright cylinder with a hole and a ball (Fig. 4e)."""

    diameter_mm: float = option(12.0, "Diameter of the cylinder", unit="mm", gt=0)
    radius: float = option(0.14, "Radius of the hole and of the ball, in diameters", gt=0)
    hole_mpa: float = option(HOLE_MPA, "Young's modulus of the hole", unit="MPa", gt=0)

    def build(self) -> Phantom:
        wide, high = self.diameter_mm, self.height_mm
        hole = Sphere((0.28 * wide, wide / 2, 0.6 * high), self.radius * wide)
        ball = Sphere((0.72 * wide, wide / 2, 0.6 * high), self.radius * wide)
        parts = [(hole, self.hole_mpa), (ball, self.inclusion_mpa)]
        return Phantom(self._body, parts, self.youngs_mpa)


@dataclass(frozen=True)
class HyperboloidSphere(_SoftBody):
    """Hyperboloid with a ball on its axis (Fig. 4f)."""

    waist_mm: float = option(3.5, "Radius at mid-height", unit="mm", gt=0)
    rim_mm: float = option(5.0, "Radius of both ends", unit="mm", gt=0)
    height_mm: float = option(10.0, "Height of the hyperboloid", unit="mm", gt=0)
    radius_mm: float = option(2.0, "Radius of the ball", unit="mm", gt=0)
    height: float = option(0.6, "Height of the ball's centre, in heights of the body")

    def build(self) -> Phantom:
        rim, high = self.rim_mm, self.height_mm
        body = Hyperboloid((rim, rim, high / 2), self.waist_mm, rim, high)
        ball = Sphere((rim, rim, self.height * high), self.radius_mm)
        return self._phantom(body, ball)


@dataclass(frozen=True)
class HemisphereSpheres(_SoftBody):
    """Hemisphere on its flat side with balls in a ring (Fig. 4g)."""

    radius_mm: float = option(10.0, "Radius of the hemisphere", unit="mm", gt=0)
    count: int = option(4, "Number of balls", ge=0)
    ball: float = option(0.2, "Radius of the balls, in radii of the hemisphere", gt=0)
    distance: float = option(0.55, "Distance of their centres from the axis, in radii")
    height: float = option(0.4, "Height of their centres above the flat side, in radii")

    def build(self) -> Phantom:
        r = self.radius_mm
        angles = 2.0 * np.pi * np.arange(self.count) / max(self.count, 1)
        ring = np.column_stack((np.cos(angles), np.sin(angles))) * self.distance
        balls = [Sphere(r * np.array((x, y, self.height)), self.ball * r) for x, y in ring]
        return self._phantom(Hemisphere(_ORIGIN, r), *balls)


@dataclass(frozen=True)
class HemisphereRandom(Options):
    """Hemisphere with a smooth random field of moduli (as Fig. 5c)."""

    section = "phantom"
    radius_mm: float = option(10.0, "Radius of the hemisphere", unit="mm", gt=0)
    median_mpa: float = option(0.3, "Median of Young's modulus", unit="MPa", gt=0)
    spread: float = option(0.5, "Standard deviation of the logarithm of Young's modulus", gt=0)
    seed: int = option(5, "Seed of the random field", ge=0)

    def build(self) -> Phantom:
        r = self.radius_mm
        field = RandomField(self.median_mpa, self.spread, 0.4 * r, self.seed)
        return Phantom(Hemisphere(_ORIGIN, r), (), field)


@dataclass(frozen=True)
class HemisphereTwoSpheres(_SoftBody):
    """Hemisphere with a shallow and a deeper ball (Fig. 12a)."""

    radius_mm: float = option(10.0, "Radius of the hemisphere", unit="mm", gt=0)
    youngs_mpa: float = option(0.1, "Young's modulus of the body", unit="MPa", gt=0)
    inclusion_mpa: float = option(0.5, "Young's modulus of the balls", unit="MPa", gt=0)

    def build(self) -> Phantom:
        r = self.radius_mm
        shallow = Sphere((0.45 * r, 0.0, 0.45 * r), 0.28 * r)
        deep = Sphere((-0.4 * r, 0.15 * r, 0.38 * r), 0.28 * r)
        return self._phantom(Hemisphere(_ORIGIN, r), shallow, deep)


@dataclass(frozen=True)
class ToyTwoSpheres(_SoftBody):
    """Toy figure, belly and head on a flat base, with a ball in each (as Fig. 12b)."""

    height_mm: float = option(20.0, "Height of the figure", unit="mm", gt=0)

    def build(self) -> Phantom:
        h = self.height_mm
        belly = Sphere((0.1 * h, 0.0, 0.3 * h), 0.12 * h)
        head = Sphere((0.0, 0.05 * h, 0.76 * h), 0.09 * h)
        return self._phantom(Lathe(_ORIGIN, h * _toy_outline()), belly, head)


def _toy_outline() -> np.ndarray:
    """Profile of two intersecting balls, the lower one cut flat below; of height 1."""
    belly, head = (0.36, 0.34), (0.24, 0.76)  # radius, height of the centre
    outline = [np.array([(0.0, 0.0), (np.sqrt(belly[0] ** 2 - belly[1] ** 2), 0.0)])]
    for (radius, middle), (other_radius, other_middle) in ((belly, head), (head, belly)):
        angles = np.linspace(-np.pi / 2, np.pi / 2, 65)
        arc = np.column_stack((radius * np.cos(angles), middle + radius * np.sin(angles)))
        outside = np.hypot(arc[:, 0], arc[:, 1] - other_middle) >= other_radius
        outline.append(arc[outside & (arc[:, 1] > 0) & (arc[:, 0] > 1e-9)])
    return np.concatenate([*outline, [(0.0, 1.0)]])
