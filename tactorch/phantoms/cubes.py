"""Cubes of the paper (Sections IV, V and VI) and related phantoms.

One corner is at the origin; the top (z+) is pressed. Positions and sizes of inclusions are
fractions of the cube's side.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from tactorch.config import Options, option
from tactorch.mesh import Box, Cone, Cylinder, Ellipsoid, Shape, Sphere, Torus, Union
from tactorch.mesh.values import Real, Vector, unit_vector, vector
from tactorch.phantoms.background import Gradient, Layers
from tactorch.phantoms.phantom import HOLE_MPA, Phantom

Triple = tuple[float, float, float]
_CENTER = (0.5, 0.5, 0.5)
_UP = (0.0, 0.0, 1.0)
_SOFT, _HARD = 0.2, 1.0


def cube_body(side_mm: float) -> Box:
    """Return a cube with one corner at the origin."""
    return Box((side_mm / 2,) * 3, (side_mm,) * 3)


def two_tiers(center: Vector, radius: Real, height: Real, axis: Vector = _UP) -> Union:
    """Return two coaxial cylinders of equal height, the upper half as wide (Fig. 4a); mm.

    `center` and `height` are those of both tiers together; `radius` is that of the lower tier,
    and `axis` points from it to the upper one.
    """
    up = np.array(unit_vector("axis", axis)) * float(height) / 4
    middle = np.array(vector("center", center))
    # The upper cylinder passes through the lower one, which leaves no gap by rounding.
    lower = Cylinder(middle - up, radius, float(height) / 2, axis)
    return Union((lower, Cylinder(middle, float(radius) / 2, height, axis)))


@dataclass(frozen=True)
class UniformCube(Options):
    """Homogeneous cube."""

    section = "phantom"
    side_mm: float = option(10.0, "Side of the cube", unit="mm", gt=0)
    youngs_mpa: float = option(_SOFT, "Young's modulus of the cube", unit="MPa", gt=0)

    def build(self) -> Phantom:
        return Phantom(cube_body(self.side_mm), self._inclusions(), self.youngs_mpa)

    def _inclusions(self) -> list[tuple[Shape, float]]:
        return []

    def _mm(self, *fractions: float) -> tuple[float, ...]:
        return tuple(self.side_mm * fraction for fraction in fractions)


@dataclass(frozen=True)
class _CubeWithInclusion(UniformCube, ABC):
    inclusion_mpa: float = option(_HARD, "Young's modulus of the inclusion", unit="MPa", gt=0)

    @abstractmethod
    def _shape(self) -> Shape: ...

    def _inclusions(self) -> list[tuple[Shape, float]]:
        return [(self._shape(), self.inclusion_mpa)]


@dataclass(frozen=True)
class CubeSphere(_CubeWithInclusion):
    """Cube with a ball below the centre of the top."""

    depth: float = option(0.5, "Depth of the ball's centre below the top, in sides", gt=0, lt=1)
    radius: float = option(0.2, "Radius of the ball, in sides", gt=0)

    def _shape(self) -> Shape:
        return Sphere(self._mm(0.5, 0.5, 1.0 - self.depth), *self._mm(self.radius))


@dataclass(frozen=True)
class CubeShallowSphere(CubeSphere):
    """Model 1 of the study of design factors (Fig. 6a): ball at depth 0.3."""

    depth: float = option(0.3, "Depth of the ball's centre below the top, in sides", gt=0, lt=1)


@dataclass(frozen=True)
class CubeDeepSphere(CubeSphere):
    """Model 2 of the study of design factors (Fig. 6b): ball at depth 0.6."""

    depth: float = option(0.6, "Depth of the ball's centre below the top, in sides", gt=0, lt=1)


@dataclass(frozen=True)
class _CubeWithCenteredInclusion(_CubeWithInclusion):
    center: Triple = option(_CENTER, "Centre of the inclusion, in sides")


@dataclass(frozen=True)
class _CubeWithAxialInclusion(_CubeWithCenteredInclusion):
    axis: Triple = option(_UP, "Direction of the inclusion's axis")


@dataclass(frozen=True)
class CubeBox(_CubeWithCenteredInclusion):
    """Cube with a cuboid."""

    size: Triple = option((0.4, 0.4, 0.4), "Edge lengths of the cuboid, in sides", gt=0)

    def _shape(self) -> Shape:
        return Box(self._mm(*self.center), self._mm(*self.size))


@dataclass(frozen=True)
class CubeCylinder(_CubeWithAxialInclusion):
    """Cube with a cylinder."""

    radius: float = option(0.2, "Radius of the cylinder, in sides", gt=0)
    height: float = option(0.4, "Height of the cylinder, in sides", gt=0)

    def _shape(self) -> Shape:
        radius, height = self._mm(self.radius, self.height)
        return Cylinder(self._mm(*self.center), radius, height, self.axis)


@dataclass(frozen=True)
class CubeEllipsoid(_CubeWithCenteredInclusion):
    """Cube with an ellipsoid."""

    radii: Triple = option((0.3, 0.2, 0.15), "Semi-axes of the ellipsoid, in sides", gt=0)

    def _shape(self) -> Shape:
        return Ellipsoid(self._mm(*self.center), self._mm(*self.radii))


@dataclass(frozen=True)
class CubeTwoTiers(_CubeWithAxialInclusion):
    """Cube with a cylinder of two tiers, similar to Fig. 4(a)."""

    radius: float = option(0.3, "Radius of the lower tier, in sides", gt=0)
    height: float = option(0.4, "Height of both tiers together, in sides", gt=0)

    def _shape(self) -> Shape:
        radius, height = self._mm(self.radius, self.height)
        return two_tiers(self._mm(*self.center), radius, height, self.axis)


@dataclass(frozen=True)
class CubeTorus(_CubeWithAxialInclusion):
    """Cube with a torus, similar to Fig. 4(b)."""

    radius: float = option(0.25, "Major radius of the torus, in sides", gt=0)
    tube: float = option(0.1, "Minor radius of the torus, in sides", gt=0)

    def _shape(self) -> Shape:
        radius, tube = self._mm(self.radius, self.tube)
        return Torus(self._mm(*self.center), radius, tube, self.axis)


@dataclass(frozen=True)
class CubeCone(_CubeWithAxialInclusion):
    """Cube with a cone, apex up, similar to Fig. 4(c)."""

    radius: float = option(0.3, "Radius of the cone's base, in sides", gt=0)
    height: float = option(0.5, "Height of the cone, in sides", gt=0)

    def _shape(self) -> Shape:
        radius, height = self._mm(self.radius, self.height)
        return Cone(self._mm(*self.center), radius, height, self.axis)


@dataclass(frozen=True)
class CubeSoftCone(CubeCone):
    """Stiff cube with a softer cone (Fig. 4d)."""

    youngs_mpa: float = option(_HARD, "Young's modulus of the cube", unit="MPa", gt=0)
    inclusion_mpa: float = option(_SOFT, "Young's modulus of the inclusion", unit="MPa", gt=0)


@dataclass(frozen=True)
class CubeGradient(Options):
    """Cube with a linear modulus from one vertical edge to the opposite one (as Fig. 5a)."""

    section = "phantom"
    side_mm: float = option(10.0, "Side of the cube", unit="mm", gt=0)
    low_mpa: float = option(_SOFT, "Young's modulus at the edge x = y = 0", unit="MPa", gt=0)
    high_mpa: float = option(_HARD, "Young's modulus at the opposite edge", unit="MPa", gt=0)

    def build(self) -> Phantom:
        side = self.side_mm
        ends = (0.0, 0.0, side / 2), (side, side, side / 2)
        return Phantom(cube_body(side), (), Gradient(*ends, self.low_mpa, self.high_mpa))


@dataclass(frozen=True)
class CubeLayers(Options):
    """Cube of equally thick layers (as Fig. 5b)."""

    section = "phantom"
    side_mm: float = option(10.0, "Side of the cube", unit="mm", gt=0)
    youngs_mpa: tuple[float, ...] = option(
        (1.0, 0.5, 0.2), "Young's modulus of each layer, the lowest first", unit="MPa", gt=0
    )

    def build(self) -> Phantom:
        count = len(self.youngs_mpa)
        levels = tuple(self.side_mm * i / count for i in range(1, count))
        return Phantom(cube_body(self.side_mm), (), Layers(levels, self.youngs_mpa))


@dataclass(frozen=True)
class DepthCube(_CubeWithInclusion):
    """Cube of the depth study (Section V-A): 4 MPa with a ball of 30 MPa and radius 0.2."""

    youngs_mpa: float = option(4.0, "Young's modulus of the cube", unit="MPa", gt=0)
    inclusion_mpa: float = option(30.0, "Young's modulus of the ball", unit="MPa", gt=0)
    depth: float = option(0.4, "Depth of the ball's centre below the top, in sides", gt=0, lt=1)
    offset: tuple[float, float] = option(
        (0.0, 0.0), "Offset of the ball's centre along x and y, in sides"
    )

    def _shape(self) -> Shape:
        x, y = (0.5 + offset for offset in self.offset)
        return Sphere(self._mm(x, y, 1.0 - self.depth), *self._mm(0.2))


@dataclass(frozen=True)
class SiliconeBall(_CubeWithCenteredInclusion):
    """Silicone cube with a hard ball of 4 mm diameter (Fig. 14a): 0.2 MPa and 2.5 GPa.

    The paper does not state the side; 15 mm is within the range of its sensor.
    """

    side_mm: float = option(15.0, "Side of the cube", unit="mm", gt=0)
    inclusion_mpa: float = option(2500.0, "Young's modulus of the ball", unit="MPa", gt=0)

    def _shape(self) -> Shape:
        return Sphere(self._mm(*self.center), 2.0)


@dataclass(frozen=True)
class SiliconeHole(UniformCube):
    """Silicone cube with the hole of the removed ball near a corner (Fig. 14b)."""

    side_mm: float = option(15.0, "Side of the cube", unit="mm", gt=0)
    center: Triple = option((0.75, 0.75, 0.75), "Centre of the hole, in sides")

    def _inclusions(self) -> list[tuple[Shape, float]]:
        return [(Sphere(self._mm(*self.center), 2.0), HOLE_MPA)]
