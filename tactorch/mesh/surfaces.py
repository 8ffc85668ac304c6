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
    radius, half = positive("radius_mm", radius_mm), positive("height_mm", height_mm) / 2
    profile = np.array([(0.0, -half), (radius, -half), (radius, half), (0.0, half)])
    return revolved_surface(profile, center_mm, axis, segments)


def revolved_surface(
    profile: Float[np.ndarray, "c 2"],
    center_mm: Vector = (0.0, 0.0, 0.0),
    axis: Vector = (0.0, 0.0, 1.0),
    segments: int = 48,
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "k 3"]]:
    """Return vertices and outward triangles of a solid of revolution, as rings of `segments` sides.

    Args:
        profile: Its outline as (radius, height), from one end on the axis to the other, upward;
            only the ends have radius 0.
        center_mm: What (0, 0) of the outline stands for.
        axis: Direction of the axis, of any length.
        segments: Sides of each ring, at least 3.

    Raises:
        ConfigError: The outline does not begin and end on the axis, a value is not finite, or
            there are too few segments.
    """
    if segments < 3:
        raise ConfigError(f"segments={segments} must be at least 3.")
    radii, heights = profile.T
    if len(profile) < 3 or radii[0] != 0 or radii[-1] != 0 or not (radii[1:-1] > 0).all():
        raise ConfigError("The outline must begin and end on the axis, and be off it between.")
    direction = np.array(unit_vector("axis", axis))
    first, second = _normal_plane(direction)
    angles = 2 * np.pi * np.arange(segments) / segments
    circle = np.outer(np.cos(angles), first) + np.outer(np.sin(angles), second)
    rings = radii[1:-1, None, None] * circle + heights[1:-1, None, None] * direction
    poles = heights[[0, -1], None] * direction
    vertices = np.concatenate((rings.reshape(-1, 3), poles))
    return vertices + np.array(vector("center_mm", center_mm)), _ring_triangles(
        len(profile) - 2, segments
    )


def torus_surface(
    radius_mm: Real,
    tube_mm: Real,
    center_mm: Vector = (0.0, 0.0, 0.0),
    axis: Vector = (0.0, 0.0, 1.0),
    segments: tuple[int, int] = (48, 24),
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "k 3"]]:
    """Return vertices and outward triangles of a torus.

    Args:
        radius_mm: Of the core of the ring.
        tube_mm: Around the core.
        center_mm: Its centre.
        axis: Direction of the axis, of any length.
        segments: Sides along the ring and around the tube, at least 3 each.

    Raises:
        ConfigError: A length is not positive, or there are too few segments.
    """
    if min(segments) < 3:
        raise ConfigError(f"segments={segments} must be at least 3 each.")
    radius, tube = positive("radius_mm", radius_mm), positive("tube_mm", tube_mm)
    direction = np.array(unit_vector("axis", axis))
    first, second = _normal_plane(direction)
    along, around = (2 * np.pi * np.arange(n) / n for n in segments)
    outward = np.outer(np.cos(along), first) + np.outer(np.sin(along), second)
    across = (radius + tube * np.cos(around))[None, :, None] * outward[:, None]
    vertices = (across + (tube * np.sin(around))[None, :, None] * direction).reshape(-1, 3)
    i, j = np.divmod(np.arange(len(vertices)), segments[1])
    right, up = (i + 1) % segments[0] * segments[1], (j + 1) % segments[1]
    here, beside = i * segments[1] + j, right + j
    above, across_corner = i * segments[1] + up, right + up
    triangles = np.concatenate(
        (
            np.column_stack((here, beside, across_corner)),
            np.column_stack((here, across_corner, above)),
        )
    )
    return vertices + np.array(vector("center_mm", center_mm)), triangles


def _ring_triangles(rings: int, segments: int) -> Int[np.ndarray, "k 3"]:
    """Triangles over rings from the lowest to the highest, then the lower and the upper pole."""
    here = np.arange(segments)
    following = (here + 1) % segments
    lower, upper = rings * segments, rings * segments + 1
    top = (rings - 1) * segments
    sides = []
    for ring in range(rings - 1):
        a, b = here + ring * segments, following + ring * segments
        sides += [
            np.column_stack((a, b, b + segments)),
            np.column_stack((a, b + segments, a + segments)),
        ]
    below = np.column_stack((np.full(segments, lower), following, here))
    above = np.column_stack((np.full(segments, upper), here + top, following + top))
    return np.concatenate((*sides, below, above))


def _normal_plane(
    direction: Float[np.ndarray, "3"],
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Two unit vectors that make a right-handed frame with `direction`."""
    helper = np.eye(3)[np.argmin(np.abs(direction))]
    first = np.cross(helper, direction)
    first /= np.linalg.norm(first)
    return first, np.cross(direction, first)
