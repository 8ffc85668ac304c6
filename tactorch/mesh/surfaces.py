"""Closed triangle surfaces of simple solids, outward, ready for `tetrahedralize`. Lengths in mm."""

import numpy as np
from jaxtyping import Float, Int

from tactorch.errors import ConfigError
from tactorch.mesh.values import Real, Vector, positive, sizes, unit_vector, vector

# Corner b = 4 ix + 2 iy + iz.
_BOX_TRIANGLES = (
    (0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1),
    (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3),
)  # fmt: skip


def box_surface(
    size_mm: Vector | Real, center_mm: Vector = (0.0, 0.0, 0.0)
) -> tuple[Float[np.ndarray, "8 3"], Int[np.ndarray, "12 3"]]:
    """Return vertices and outward triangles of a cuboid.

    Args:
        size_mm: Edge lengths, three or one for a cube.
        center_mm: Its centre.

    Raises:
        ConfigError: A length is not positive, or a value is not finite.
    """
    low = np.array(vector("center_mm", center_mm)) - np.array(sizes("size_mm", size_mm)) / 2
    corners = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    return low + corners * np.array(sizes("size_mm", size_mm)), np.array(_BOX_TRIANGLES)


def cylinder_surface(
    radius_mm: Real,
    height_mm: Real,
    center_mm: Vector = (0.0, 0.0, 0.0),
    axis: Vector = (0.0, 0.0, 1.0),
    segments: int = 48,
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "k 3"]]:
    """Return vertices and outward triangles of a cylinder, as a prism of `segments` sides.

    Args:
        radius_mm: Radius of the circle through the vertices.
        height_mm: Full height.
        center_mm: Its centre, at mid-height.
        axis: Its direction, of any length.
        segments: Sides of the prism, at least 3.

    Raises:
        ConfigError: A length is not positive, a value not finite, or there are too few segments.
    """
    if segments < 3:
        raise ConfigError(f"segments={segments} must be at least 3.")
    radius, height = positive("radius_mm", radius_mm), positive("height_mm", height_mm)
    direction = np.array(unit_vector("axis", axis))
    first, second = _normal_plane(direction)
    angles = 2 * np.pi * np.arange(segments) / segments
    ring = radius * (np.outer(np.cos(angles), first) + np.outer(np.sin(angles), second))
    up = height / 2 * direction
    center = np.array(vector("center_mm", center_mm))
    vertices = np.concatenate((ring - up, ring + up, [-up, up])) + center
    return vertices, _prism_triangles(segments)


def _prism_triangles(segments: int) -> Int[np.ndarray, "k 3"]:
    """Triangles over bottom ring, top ring, bottom centre, top centre."""
    here = np.arange(segments)
    following = (here + 1) % segments
    top_here, top_following = here + segments, following + segments
    bottom = np.full(segments, 2 * segments)
    return np.concatenate(
        (
            np.column_stack((here, following, top_following)),
            np.column_stack((here, top_following, top_here)),
            np.column_stack((bottom, following, here)),
            np.column_stack((bottom + 1, top_here, top_following)),
        )
    )


def _normal_plane(
    direction: Float[np.ndarray, "3"],
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Two unit vectors that make a right-handed frame with `direction`."""
    helper = np.eye(3)[np.argmin(np.abs(direction))]
    first = np.cross(helper, direction)
    first /= np.linalg.norm(first)
    return first, np.cross(direction, first)
