"""Phantoms by name: the objects of the paper's figures and simple relatives."""

from collections.abc import Callable
from typing import Any

from tactorch.errors import ConfigError
from tactorch.phantoms import cubes, curved
from tactorch.phantoms.phantom import Phantom

PHANTOMS: dict[str, Callable[..., Phantom]] = {
    make.__name__: make
    for make in (
        cubes.uniform_cube,
        cubes.cube_sphere,
        cubes.cube_shallow_sphere,
        cubes.cube_deep_sphere,
        cubes.cube_box,
        cubes.cube_cylinder,
        cubes.cube_ellipsoid,
        cubes.cube_two_tiers,
        cubes.cube_torus,
        cubes.cube_cone,
        cubes.cube_soft_cone,
        cubes.cube_gradient,
        cubes.cube_layers,
        cubes.depth_cube,
        cubes.silicone_ball,
        cubes.silicone_hole,
        curved.cylinder_sphere,
        curved.cylinder_hole_sphere,
        curved.hyperboloid_sphere,
        curved.hemisphere_spheres,
        curved.hemisphere_random,
        curved.hemisphere_two_spheres,
        curved.toy_two_spheres,
    )
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
