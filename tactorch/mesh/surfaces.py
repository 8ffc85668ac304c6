"""Closed, outward triangle surfaces of round solids and of signed distances. Lengths in mm."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError
from tactorch.mesh.values import Corners, Points, Real, Triangles, Vector

# Cells along the longest side for marching cubes.
_CELLS = 64
#: Points (radius, height) from the lower end on the axis to the upper; only the ends have radius 0.
Profile = Float[np.ndarray, "c 2"]
TriangleSurface = tuple[Points, Triangles]


def revolve(profile: Profile, center: Vector, axis: Vector, segments: int) -> TriangleSurface:
    """Return the surface of a solid of revolution, as rings of `segments` sides."""
    if segments < 3:
        raise ConfigError(f"segments={segments} must be at least 3.")
    direction, (radii, heights) = np.array(axis), profile.T
    circle = _circle(direction, 2 * np.pi * np.arange(segments) / segments)
    rings = radii[1:-1, None, None] * circle + heights[1:-1, None, None] * direction
    poles = heights[[0, -1], None] * direction
    vertices = np.concatenate((rings.reshape(-1, 3), poles)) + np.array(center)
    return vertices, _ring_triangles(len(profile) - 2, segments)


def torus(
    radius: Real, tube: Real, center: Vector, axis: Vector, segments: tuple[int, int]
) -> TriangleSurface:
    """Return the surface of a torus of `segments` sides along the ring and around the tube."""
    if min(segments) < 3:
        raise ConfigError(f"segments={segments} must be at least 3 each.")
    along, around = (2 * np.pi * np.arange(n) / n for n in segments)
    across = (radius + tube * np.cos(around))[None, :, None] * _circle(axis, along)[:, None]
    vertices = (across + (tube * np.sin(around))[None, :, None] * np.array(axis)).reshape(-1, 3)
    i, j = np.divmod(np.arange(len(vertices)), segments[1])
    right, up = (i + 1) % segments[0] * segments[1], (j + 1) % segments[1]
    corner, opposite = i * segments[1] + j, right + up
    first = np.column_stack((corner, right + j, opposite))
    second = np.column_stack((corner, opposite, i * segments[1] + up))
    return vertices + np.array(center), np.concatenate((first, second))


def half_circle(segments: int) -> Profile:
    """Return the profile of a ball of radius 1 for rings of `segments` sides."""
    angles = np.linspace(-np.pi / 2, np.pi / 2, max(segments // 2, 2) + 1)
    arc = np.column_stack((np.cos(angles), np.sin(angles)))
    arc[[0, -1], 0] = 0.0
    return arc


def coarsen(profile: Profile, segments: int) -> Float[np.ndarray, "q 2"]:
    """Drop points of a fine profile, so that its edges are about as long as a ring's.

    Ends and corners of more than 15 degrees are kept.
    """
    target = 2 * np.pi * profile[:, 0].max() / segments
    edges = np.diff(profile, axis=0)
    edges /= np.linalg.norm(edges, axis=1, keepdims=True)
    sharp = np.einsum("cd,cd->c", edges[:-1], edges[1:]) < np.cos(np.deg2rad(15.0))
    selected = [0]
    for i, corner in enumerate([*sharp, True], start=1):
        if corner or np.linalg.norm(profile[i] - profile[selected[-1]]) >= target:
            selected.append(i)
    return profile[selected]


def marching_cubes(
    distance: Callable[[Points], Float[np.ndarray, " n"]], bounds: Corners, name: str
) -> TriangleSurface:
    """Return the zero level of a signed distance; `name` is for the message on thin shapes."""
    from skimage import measure  # takes a second to import

    low, high = bounds
    step = float((high - low).max()) / _CELLS
    counts = np.ceil((high - low) / step).astype(int) + 3
    start = (low + high) / 2 - step * (counts - 1) / 2
    axes = [s + step * np.arange(n) for s, n in zip(start, counts, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    distances = distance(points).reshape(counts)
    if not (distances < 0).any():
        raise ConfigError(
            f"{name} is thinner than {step:.3g} mm, the cell size of marching cubes; enlarge it."
        )
    vertices, triangles, _, _ = measure.marching_cubes(distances, 0.0, spacing=(step,) * 3)
    return vertices.astype(np.float64) + start, triangles.astype(np.int64)


def _circle(axis: Vector, angles: Float[np.ndarray, " s"]) -> Float[np.ndarray, "s 3"]:
    """Points of the unit circle around `axis`, counter-clockwise seen from its end."""
    direction = np.array(axis)
    first = np.cross(np.eye(3)[np.argmin(np.abs(direction))], direction)
    first /= np.linalg.norm(first)
    second = np.cross(direction, first)
    return np.outer(np.cos(angles), first) + np.outer(np.sin(angles), second)


def _ring_triangles(rings: int, segments: int) -> Triangles:
    """Triangles between rings from the lowest to the highest, then at the two poles."""
    current = np.arange(segments)
    following = (current + 1) % segments
    top, pole = (rings - 1) * segments, np.full(segments, rings * segments)
    sides = []
    for start in range(0, top, segments):
        a, b = current + start, following + start
        sides.append(np.column_stack((a, b, b + segments)))
        sides.append(np.column_stack((a, b + segments, a + segments)))
    below = np.column_stack((pole, following, current))
    above = np.column_stack((pole + 1, current + top, following + top))
    return np.concatenate((*sides, below, above))
