"""How far one shape reaches out of another."""

import numpy as np
from jaxtyping import Float

from tactorch.mesh import Hyperboloid, Lathe, Shape, Union, shape_surface

# Sides of round shapes: what is found is short by 0.1 % of the radius at most.
_SEGMENTS = 72
_COARSE = 24
_PER_TRIANGLE = 7  # most steps along an edge of a triangle, where corners do not tell enough
_STEPS = 20  # across a shape, that a step is not to be longer than


def protrusion(shape: Shape, body: Shape) -> float:
    """Return by how much `shape` reaches out of a body, mm; negative where well inside.

    The distance to a convex body is convex, so it is largest at an extreme point of the shape. Of
    bodies with a waist the shape's whole surface is sampled.
    """
    steps = _PER_TRIANGLE if isinstance(body, Hyperboloid | Lathe) else 1
    return float(body.signed_distance(_surface_points(shape, _SEGMENTS, steps)).max())


def clearance(shape: Shape, other: Shape) -> float:
    """Return about how far two shapes are apart, mm; negative where they overlap."""
    here, there = (_surface_points(one, _COARSE, 3) for one in (shape, other))
    return float(min(other.signed_distance(here).min(), shape.signed_distance(there).min()))


def _surface_points(shape: Shape, segments: int, steps: int) -> Float[np.ndarray, "p 3"]:
    """Points on the surface (of a union: of its parts), up to `steps` along a triangle's edge."""
    if isinstance(shape, Union):
        return np.concatenate([_surface_points(part, segments, steps) for part in shape.parts])
    vertices, triangles = shape_surface(shape, segments)
    if steps == 1:
        return vertices
    corners = vertices[triangles]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    step = np.linalg.norm(np.ptp(vertices, axis=0)) / _STEPS
    wanted = np.clip(np.ceil(longest / step), 1, steps).astype(int)
    return np.concatenate([_within(corners[wanted == n], int(n)) for n in np.unique(wanted)])


def _within(corners: Float[np.ndarray, "k 3 3"], steps: int) -> Float[np.ndarray, "p 3"]:
    """Points of triangles, so many steps along each edge."""
    counts = [(i, j, steps - i - j) for i in range(steps + 1) for j in range(steps + 1 - i)]
    shares = np.array(counts) / steps
    return np.einsum("pc,kcd->kpd", shares, corners).reshape(-1, 3)
