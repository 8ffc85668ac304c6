"""Triangle surfaces of shapes, to be filled with tetrahedra or to be found in a mesh again."""

import numpy as np
from jaxtyping import Float, Int

from tactorch.errors import ConfigError
from tactorch.mesh.combined import Rotated
from tactorch.mesh.revolved import Revolved, Torus
from tactorch.mesh.shapes import Box, Cylinder, Ellipsoid, Shape, Sphere
from tactorch.mesh.surfaces import box_surface, cylinder_surface, revolved_surface, torus_surface

# Cells along the longest side where a surface is found by its signed distance.
_CELLS = 64

Skin = tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "k 3"]]


def skin(shape: Shape, segments: int = 48) -> Skin:
    """Return vertices (mm) and outward triangles of a shape's closed surface.

    Boxes are exact; round shapes are polyhedra whose corners lie on the surface; what has no
    formula here is found by marching cubes, 64 cells along its longest side, which rounds edges
    off.

    Args:
        shape: Any shape.
        segments: Sides of round shapes; a multiple of 4.

    Raises:
        ConfigError: The shape is thinner than the cells that would find it.
    """
    if isinstance(shape, Box):
        return box_surface(shape.size_mm, shape.center_mm)
    if isinstance(shape, Cylinder):
        place = shape.center_mm, shape.axis, segments
        return cylinder_surface(shape.radius_mm, shape.height_mm, *place)
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
        outline = _thinned(shape.profile(), segments)
        return revolved_surface(outline, shape.center_mm, shape.axis, segments)
    if isinstance(shape, Rotated):
        vertices, triangles = skin(shape.of, segments)
        return shape.turned(vertices), triangles
    return _marched(shape)


def _half_circle(segments: int) -> Float[np.ndarray, "c 2"]:
    angles = np.linspace(-np.pi / 2, np.pi / 2, segments // 2 + 1)
    arc = np.column_stack((np.cos(angles), np.sin(angles)))
    arc[[0, -1], 0] = 0.0
    return arc


def _thinned(profile: Float[np.ndarray, "c 2"], segments: int) -> Float[np.ndarray, "q 2"]:
    """Drop points of a finely drawn curve, so that its pieces are about as long as a ring's."""
    wanted = 2 * np.pi * profile[:, 0].max() / segments
    turns = _is_corner(profile)
    kept = [0]
    for i in range(1, len(profile)):
        if turns[i] or np.linalg.norm(profile[i] - profile[kept[-1]]) >= wanted:
            kept.append(i)
    return profile[kept]


def _is_corner(profile: Float[np.ndarray, "c 2"]) -> np.ndarray:
    """Which points the outline turns at by more than 15 degrees, its ends among them."""
    edges = np.diff(profile, axis=0)
    edges /= np.linalg.norm(edges, axis=1, keepdims=True)
    sharp = np.einsum("cd,cd->c", edges[:-1], edges[1:]) < np.cos(np.deg2rad(15.0))
    return np.concatenate(([True], sharp, [True]))


def _marched(shape: Shape) -> Skin:
    from skimage.measure import marching_cubes  # takes a second to import

    low, high = shape.bounds()
    step = float((high - low).max()) / _CELLS
    counts = np.ceil((high - low) / step).astype(int) + 3
    start = (low + high) / 2 - step * (counts - 1) / 2
    axes = [s + step * np.arange(n) for s, n in zip(start, counts, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    distances = shape.signed_distance(points).reshape(counts)
    if not (distances < 0).any():
        raise ConfigError(f"{shape} is thinner than {step:.3g} mm; no surface was found.")
    vertices, triangles, _, _ = marching_cubes(distances, 0.0, spacing=(step,) * 3)
    return vertices.astype(np.float64) + start, triangles.astype(np.int64)
