"""The cubes of the paper (Section IV, V and VI) and simple relatives.

They stand with one corner at the origin and are pressed on top (z+). Positions and sizes of
inclusions are shares of the cube's side; moduli default to 0.2 MPa and 1 MPa.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from tactorch.mesh import Box, Cone, Cylinder, Ellipsoid, Sphere, Torus, Union
from tactorch.mesh.values import Real, Vector, positive, unit_vector, vector
from tactorch.phantoms.background import Gradient, Layers
from tactorch.phantoms.phantom import HOLE_MPA, Phantom

_MIDDLE = (0.5, 0.5, 0.5)
_SOFT, _HARD = 0.2, 1.0


def _cube(side_mm: Real) -> Box:
    side = positive("side_mm", side_mm)
    return Box((side / 2,) * 3, (side,) * 3)


def _scaled(side_mm: Real, shares: Sequence[Real]) -> tuple[float, ...]:
    return tuple(float(side_mm) * float(share) for share in shares)


def uniform_cube(side_mm: Real = 10.0, youngs_mpa: Real = _SOFT) -> Phantom:
    """A cube without inclusion."""
    return Phantom(_cube(side_mm), (), youngs_mpa)


def cube_sphere(
    depth: Real = 0.5,
    radius: Real = 0.2,
    side_mm: Real = 10.0,
    youngs_mpa: Real = _SOFT,
    inclusion_mpa: Real = _HARD,
) -> Phantom:
    """A cube with a ball whose centre is `depth` below the middle of the top, in sides."""
    body = _cube(side_mm)
    center = _scaled(side_mm, (0.5, 0.5, 1.0 - float(depth)))
    ball = Sphere(center, float(radius) * float(side_mm))
    return Phantom(body, [(ball, inclusion_mpa)], youngs_mpa)


def cube_shallow_sphere(**changes: Any) -> Phantom:
    """Model 1 of the depth study (Fig. 6a): a ball at depth 0.3; arguments of `cube_sphere`."""
    return cube_sphere(**{"depth": 0.3, **changes})


def cube_deep_sphere(**changes: Any) -> Phantom:
    """Model 2 of the depth study (Fig. 6b): a ball at depth 0.6; arguments of `cube_sphere`."""
    return cube_sphere(**{"depth": 0.6, **changes})


def cube_box(
    center: Sequence[Real] = _MIDDLE,
    size: Sequence[Real] = (0.4, 0.4, 0.4),
    side_mm: Real = 10.0,
    youngs_mpa: Real = _SOFT,
    inclusion_mpa: Real = _HARD,
) -> Phantom:
    """A cube with a cuboid; centre and edge lengths in sides."""
    body = _cube(side_mm)
    inside = Box(_scaled(side_mm, center), _scaled(side_mm, size))
    return Phantom(body, [(inside, inclusion_mpa)], youngs_mpa)


def cube_cylinder(
    center: Sequence[Real] = _MIDDLE,
    radius: Real = 0.2,
    height: Real = 0.4,
    axis: Sequence[Real] = (0.0, 0.0, 1.0),
    side_mm: Real = 10.0,
    youngs_mpa: Real = _SOFT,
    inclusion_mpa: Real = _HARD,
) -> Phantom:
    """A cube with a cylinder; centre, radius and height in sides."""
    body = _cube(side_mm)
    r, h = _scaled(side_mm, (radius, height))
    inside = Cylinder(_scaled(side_mm, center), r, h, axis)
    return Phantom(body, [(inside, inclusion_mpa)], youngs_mpa)


def cube_ellipsoid(
    center: Sequence[Real] = _MIDDLE,
    radii: Sequence[Real] = (0.3, 0.2, 0.15),
    side_mm: Real = 10.0,
    youngs_mpa: Real = _SOFT,
    inclusion_mpa: Real = _HARD,
) -> Phantom:
    """A cube with an ellipsoid; centre and semi-axes in sides."""
    body = _cube(side_mm)
    inside = Ellipsoid(_scaled(side_mm, center), _scaled(side_mm, radii))
    return Phantom(body, [(inside, inclusion_mpa)], youngs_mpa)


def cake(center: Vector, radius: Real, height: Real, axis: Vector = (0.0, 0.0, 1.0)) -> Union:
    """Two tiers of equal height, the upper half as wide: the inclusion of Fig. 4(a); mm.

    Args:
        center: Its middle.
        radius: Of the lower tier.
        height: Of both together.
        axis: From the lower to the upper tier.
    """
    up = np.array(unit_vector("axis", axis)) * float(height) / 4
    middle = np.array(vector("center", center))
    # The upper one goes through the lower: no seam where round-off would find no cake.
    lower = Cylinder(middle - up, radius, float(height) / 2, axis)
    return Union((lower, Cylinder(middle, float(radius) / 2, height, axis)))


def cube_two_tiers(
    center: Sequence[Real] = _MIDDLE,
    radius: Real = 0.3,
    height: Real = 0.4,
    axis: Sequence[Real] = (0.0, 0.0, 1.0),
    side_mm: Real = 10.0,
    youngs_mpa: Real = _SOFT,
    inclusion_mpa: Real = _HARD,
) -> Phantom:
    """A cube with a cake of two tiers, in the manner of Fig. 4(a); lengths in sides."""
    r, h = _scaled(side_mm, (radius, height))
    inside = cake(_scaled(side_mm, center), r, h, axis)
    return Phantom(_cube(side_mm), [(inside, inclusion_mpa)], youngs_mpa)


def cube_torus(
    center: Sequence[Real] = _MIDDLE,
    radius: Real = 0.25,
    tube: Real = 0.1,
    axis: Sequence[Real] = (0.0, 0.0, 1.0),
    side_mm: Real = 10.0,
    youngs_mpa: Real = _SOFT,
    inclusion_mpa: Real = _HARD,
) -> Phantom:
    """A cube with a torus, in the manner of Fig. 4(b); lengths in sides."""
    r, t = _scaled(side_mm, (radius, tube))
    inside = Torus(_scaled(side_mm, center), r, t, axis)
    return Phantom(_cube(side_mm), [(inside, inclusion_mpa)], youngs_mpa)


def cube_cone(
    center: Sequence[Real] = _MIDDLE,
    radius: Real = 0.3,
    height: Real = 0.5,
    axis: Sequence[Real] = (0.0, 0.0, 1.0),
    side_mm: Real = 10.0,
    youngs_mpa: Real = _SOFT,
    inclusion_mpa: Real = _HARD,
) -> Phantom:
    """A cube with a cone, its point up, in the manner of Fig. 4(c); lengths in sides."""
    r, h = _scaled(side_mm, (radius, height))
    inside = Cone(_scaled(side_mm, center), r, h, axis)
    return Phantom(_cube(side_mm), [(inside, inclusion_mpa)], youngs_mpa)


def cube_soft_cone(**changes: Any) -> Phantom:
    """A stiff cube with a softer cone, Fig. 4(d); arguments of `cube_cone`."""
    return cube_cone(**{"youngs_mpa": _HARD, "inclusion_mpa": _SOFT, **changes})


def cube_gradient(side_mm: Real = 10.0, low_mpa: Real = _SOFT, high_mpa: Real = _HARD) -> Phantom:
    """A cube that stiffens evenly from one vertical edge to the opposite one (as Fig. 5a)."""
    side = positive("side_mm", side_mm)
    field = Gradient((0.0, 0.0, side / 2), (side, side, side / 2), low_mpa, high_mpa)
    return Phantom(_cube(side_mm), (), field)


def cube_layers(side_mm: Real = 10.0, youngs_mpa: Sequence[Real] = (1.0, 0.5, 0.2)) -> Phantom:
    """A cube of equally thick layers, the lowest first (as Fig. 5b)."""
    side, count = positive("side_mm", side_mm), len(youngs_mpa)
    levels = [side * i / count for i in range(1, count)]
    return Phantom(_cube(side_mm), (), Layers(levels, youngs_mpa))


def depth_cube(
    depth: Real = 0.4,
    offset: Sequence[Real] = (0.0, 0.0),
    side_mm: Real = 10.0,
    youngs_mpa: Real = 4.0,
    inclusion_mpa: Real = 30.0,
) -> Phantom:
    """The cube of the depth study (Section V-A): 4 MPa with a ball of 30 MPa, radius 0.2.

    Its centre is `depth` below the top and `offset` beside the middle, in sides.
    """
    x, y = (0.5 + float(share) for share in offset)
    ball = Sphere(_scaled(side_mm, (x, y, 1.0 - float(depth))), 0.2 * float(side_mm))
    return Phantom(_cube(side_mm), [(ball, inclusion_mpa)], youngs_mpa)


def silicone_ball(
    side_mm: Real = 15.0,
    center: Sequence[Real] = _MIDDLE,
    youngs_mpa: Real = _SOFT,
    inclusion_mpa: Real = 2500.0,
) -> Phantom:
    """The silicone cube with a hard ball of 4 mm diameter (Fig. 14a): 0.2 MPa and 2.5 GPa.

    The paper does not state the side; 15 mm lies within its sensor.
    """
    ball = Sphere(_scaled(side_mm, center), 2.0)
    return Phantom(_cube(side_mm), [(ball, inclusion_mpa)], youngs_mpa)


def silicone_hole(
    side_mm: Real = 15.0,
    center: Sequence[Real] = (0.75, 0.75, 0.75),
    youngs_mpa: Real = _SOFT,
) -> Phantom:
    """The silicone cube with the hole that the ball left near a corner (Fig. 14b)."""
    return silicone_ball(side_mm, center, youngs_mpa, HOLE_MPA)
