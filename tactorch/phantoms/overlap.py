"""Protrusion of one shape out of another, and clearance between two shapes."""

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from tactorch.mesh import BodyFile, Hyperboloid, Lathe, Shape, Union
from tactorch.mesh.quadrature import lattice

# Sides of round shapes: results are short by 0.1 % of the radius at most.
_SEGMENTS = 72
_COARSE_SEGMENTS = 24
_MAX_EDGE_STEPS = 7  # of points along an edge of a triangle, for bodies that are not convex
_MIN_STEPS_ACROSS = 20  # of the shape's extent
_STRIDES = (64, 8, 1)  # of points whose distances are computed first, and then


def protrusion(shape: Shape, body: Shape) -> float:
    """Return the largest distance of `shape` outside a body, mm; negative where it is inside.

    The distance to a convex body is convex and largest at an extreme point of the shape. For
    bodies that are not convex, the whole surface of the shape is sampled.
    """
    steps = _MAX_EDGE_STEPS if isinstance(body, Hyperboloid | Lathe | BodyFile) else 1
    points = _surface_points(shape, _SEGMENTS, steps)
    if isinstance(body, BodyFile):
        return _largest_distance(body, points)
    return float(body.signed_distance(points).max())


def _largest_distance(body: Shape, points: Float[np.ndarray, "p 3"]) -> float:
    """Return the largest signed distance of points, most of which need not be computed.

    A distance differs from that of another point by no more than the distance of both points.
    """
    largest = -np.inf
    for stride in _STRIDES:
        known = points[::stride]
        distances = body.signed_distance(known)
        largest = max(largest, float(distances.max()))
        if stride > 1:
            apart, nearest = cKDTree(known).query(points)
            points = points[distances[nearest] + apart > largest]
            if not len(points):
                break
    return largest


def clearance(shape: Shape, other: Shape) -> float:
    """Return the approximate distance between two shapes, mm; negative where they overlap."""
    first, second = (_surface_points(s, _COARSE_SEGMENTS, 3) for s in (shape, other))
    return float(min(other.signed_distance(first).min(), shape.signed_distance(second).min()))


def _surface_points(shape: Shape, segments: int, steps: int) -> Float[np.ndarray, "p 3"]:
    """Points on the surface (of a union: of its parts), up to `steps` along a triangle's edge."""
    if isinstance(shape, Union):
        return np.concatenate([_surface_points(part, segments, steps) for part in shape.parts])
    vertices, triangles = shape.surface(segments)
    if steps == 1:
        return vertices
    corners = vertices[triangles]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    step = np.linalg.norm(np.ptp(vertices, axis=0)) / _MIN_STEPS_ACROSS
    counts = np.clip(np.ceil(longest / step), 1, steps).astype(int)
    points = [
        np.einsum("pc,kcd->kpd", lattice(int(n) + 1, 0.0, 3), corners[counts == n])
        for n in np.unique(counts)
    ]
    return np.concatenate([each.reshape(-1, 3) for each in points])
