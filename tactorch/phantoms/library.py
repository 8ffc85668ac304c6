"""Phantoms by name: the paper's cubes (Section IV) and simple relatives.

Cubes stand with one corner at the origin and are pressed on top (z+). Positions and sizes of
inclusions are shares of the cube's side; moduli default to the paper's 0.2 MPa and 1 MPa.
"""

from collections.abc import Callable, Sequence
from typing import Any

from tactorch.errors import ConfigError
from tactorch.mesh import Box, Cylinder, Ellipsoid, Shape, Sphere
from tactorch.mesh.values import Real, positive
from tactorch.phantoms.phantom import Phantom

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


def cube_two_tiers(
    side_mm: Real = 10.0, youngs_mpa: Real = _SOFT, inclusion_mpa: Real = _HARD
) -> Phantom:
    """A cube with a cake of two tiers, in the manner of Fig. 4(a)."""
    body = _cube(side_mm)
    tiers: list[tuple[Shape, Real]] = []
    for height, radius in ((0.4, 0.3), (0.6, 0.15)):
        r, thick = _scaled(side_mm, (radius, 0.2))
        tiers.append((Cylinder(_scaled(side_mm, (0.5, 0.5, height)), r, thick), inclusion_mpa))
    return Phantom(body, tiers, youngs_mpa)


def cylinder_sphere(
    depth: Real = 0.4,
    radius: Real = 0.2,
    diameter_mm: Real = 10.0,
    height_mm: Real = 10.0,
    youngs_mpa: Real = _SOFT,
    inclusion_mpa: Real = _HARD,
) -> Phantom:
    """An upright cylinder with a ball; depth in heights, radius in diameters."""
    wide, high = positive("diameter_mm", diameter_mm), positive("height_mm", height_mm)
    body = Cylinder((wide / 2, wide / 2, high / 2), wide / 2, high)
    ball = Sphere((wide / 2, wide / 2, high * (1.0 - float(depth))), float(radius) * wide)
    return Phantom(body, [(ball, inclusion_mpa)], youngs_mpa)


PHANTOMS: dict[str, Callable[..., Phantom]] = {
    "uniform_cube": uniform_cube,
    "cube_sphere": cube_sphere,
    "cube_shallow_sphere": cube_shallow_sphere,
    "cube_deep_sphere": cube_deep_sphere,
    "cube_box": cube_box,
    "cube_cylinder": cube_cylinder,
    "cube_ellipsoid": cube_ellipsoid,
    "cube_two_tiers": cube_two_tiers,
    "cylinder_sphere": cylinder_sphere,
}


def make_phantom(name: str, **changes: Any) -> Phantom:
    """Make a phantom of `PHANTOMS` by name.

    Args:
        name: A key of `PHANTOMS`.
        changes: Arguments of that function, such as `inclusion_mpa=2.0`.

    Raises:
        ConfigError: The name or an argument is unknown, or a value cannot be used.
    """
    if name not in PHANTOMS:
        raise ConfigError(f"phantom '{name}' is unknown; choose one of {', '.join(PHANTOMS)}.")
    try:
        return PHANTOMS[name](**changes)
    except (TypeError, ValueError) as error:
        raise ConfigError(f"phantom '{name}' does not take these arguments: {error}.") from error
