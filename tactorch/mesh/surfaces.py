"""Closed, outward triangle surfaces of shapes, for `tetrahedralize`. Lengths in mm."""

import numpy as np
from jaxtyping import Float, Int

from tactorch.errors import ConfigError
from tactorch.mesh.revolved import Revolved, Torus
from tactorch.mesh.shapes import Box, Cylinder, Ellipsoid, Rotated, Shape, Sphere
from tactorch.mesh.values import Real, Vector, positive, sizes, unit_vector, vector

# Corner b = 4 ix + 2 iy + iz.
_BOX_TRIANGLES = (
    (0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1),
    (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3),
)  # fmt: skip
# Cells along the longest side for marching cubes.
_CELLS = 64

TriangleSurface = tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "k 3"]]


def shape_surface(shape: Shape, segments: int = 48) -> TriangleSurface:
    """Return vertices (mm) and outward triangles of a shape's closed surface.

    Boxes are exact; round shapes are polyhedra with vertices on the surface; surfaces of other
    shapes are computed by marching cubes with 64 cells along the longest side, which rounds edges.

    Args:
        shape: Shape.
        segments: Number of sides of round shapes; a multiple of 4.

    Raises:
        ConfigError: The shape is thinner than the cells of marching cubes.
    """
    if isinstance(shape, Box):
        return box_surface(shape.size_mm, shape.center_mm)
    if isinstance(shape, Cylinder):
        size = shape.radius_mm, shape.height_mm
        return cylinder_surface(*size, shape.center_mm, shape.axis, segments)
    if isinstance(shape, Sphere):
        arc = shape.radius_mm * _half_circle(segments)
        return revolved_surface(arc, shape.center_mm, segments=segments)
    if isinstance(shape, Ellipsoid):
        vertices, triangles = revolved_surface(_half_circle(segments), segments=segments)
        return vertices * np.array(shape.radii_mm) + np.array(shape.center_mm), triangles
    if isinstance(shape, Torus):
        sides = segments, segments // 2
        return torus_surface(shape.radius_mm, shape.tube_mm, shape.center_mm, shape.axis, sides)
    if isinstance(shape, Revolved):
        profile = _coarsened(shape.profile(), segments)
        return revolved_surface(profile, shape.center_mm, shape.axis, segments)
    if isinstance(shape, Rotated):
        vertices, triangles = shape_surface(shape.of, segments)
        return shape.rotate(vertices), triangles
    return _marching_cubes(shape)


def box_surface(
    size_mm: Vector | Real, center_mm: Vector = (0.0, 0.0, 0.0)
) -> tuple[Float[np.ndarray, "8 3"], Int[np.ndarray, "12 3"]]:
    """Return vertices and outward triangles of a cuboid.

    Args:
        size_mm: Edge lengths, three or one for a cube.
        center_mm: Centre.

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
        center_mm: Centre, at mid-height.
        axis: Direction of the axis, of any length.
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
        profile: Points (radius, height) from the lower end on the axis to the upper; only the
            ends have radius 0.
        center_mm: Position of (0, 0) of the profile.
        axis: Direction of the axis, of any length.
        segments: Sides of each ring, at least 3.

    Raises:
        ConfigError: The profile does not begin and end on the axis, a value is not finite, or
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
        radius_mm: Major radius.
        tube_mm: Minor radius.
        center_mm: Centre.
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
    corner, next_along = i * segments[1] + j, right + j
    next_around, opposite = i * segments[1] + up, right + up
    triangles = np.concatenate(
        (
            np.column_stack((corner, next_along, opposite)),
            np.column_stack((corner, opposite, next_around)),
        )
    )
    return vertices + np.array(vector("center_mm", center_mm)), triangles


def _half_circle(segments: int) -> Float[np.ndarray, "c 2"]:
    angles = np.linspace(-np.pi / 2, np.pi / 2, segments // 2 + 1)
    arc = np.column_stack((np.cos(angles), np.sin(angles)))
    arc[[0, -1], 0] = 0.0
    return arc


def _coarsened(profile: Float[np.ndarray, "c 2"], segments: int) -> Float[np.ndarray, "q 2"]:
    """Drop points of a fine profile, so that its segments are about as long as a ring's."""
    target = 2 * np.pi * profile[:, 0].max() / segments
    corners = _is_corner(profile)
    selected = [0]
    for i in range(1, len(profile)):
        if corners[i] or np.linalg.norm(profile[i] - profile[selected[-1]]) >= target:
            selected.append(i)
    return profile[selected]


def _is_corner(profile: Float[np.ndarray, "c 2"]) -> np.ndarray:
    """Whether the profile turns by more than 15 degrees at each point; true at its ends."""
    edges = np.diff(profile, axis=0)
    edges /= np.linalg.norm(edges, axis=1, keepdims=True)
    sharp = np.einsum("cd,cd->c", edges[:-1], edges[1:]) < np.cos(np.deg2rad(15.0))
    return np.concatenate(([True], sharp, [True]))


def _marching_cubes(shape: Shape) -> TriangleSurface:
    from skimage.measure import marching_cubes  # takes a second to import

    low, high = shape.bounds()
    step = float((high - low).max()) / _CELLS
    counts = np.ceil((high - low) / step).astype(int) + 3
    start = (low + high) / 2 - step * (counts - 1) / 2
    axes = [s + step * np.arange(n) for s, n in zip(start, counts, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    distances = shape.signed_distance(points).reshape(counts)
    if not (distances < 0).any():
        raise ConfigError(
            f"{shape} is thinner than {step:.3g} mm, the cell size of marching cubes; enlarge it."
        )
    vertices, triangles, _, _ = marching_cubes(distances, 0.0, spacing=(step,) * 3)
    return vertices.astype(np.float64) + start, triangles.astype(np.int64)


def _ring_triangles(rings: int, segments: int) -> Int[np.ndarray, "k 3"]:
    """Triangles between rings from the lowest to the highest, then at the two poles."""
    current = np.arange(segments)
    following = (current + 1) % segments
    lower, upper = rings * segments, rings * segments + 1
    top = (rings - 1) * segments
    sides = []
    for ring in range(rings - 1):
        a, b = current + ring * segments, following + ring * segments
        sides += [
            np.column_stack((a, b, b + segments)),
            np.column_stack((a, b + segments, a + segments)),
        ]
    below = np.column_stack((np.full(segments, lower), following, current))
    above = np.column_stack((np.full(segments, upper), current + top, following + top))
    return np.concatenate((*sides, below, above))


def _normal_plane(
    direction: Float[np.ndarray, "3"],
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Two unit vectors that form a right-handed frame with `direction`."""
    helper = np.eye(3)[np.argmin(np.abs(direction))]
    first = np.cross(helper, direction)
    first /= np.linalg.norm(first)
    return first, np.cross(direction, first)
