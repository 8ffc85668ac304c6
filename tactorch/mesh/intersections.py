"""Triangles of a surface that cross each other. Lengths in mm."""

from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Int

from tactorch.errors import MeshError
from tactorch.mesh.checks import listing
from tactorch.mesh.geometry import bounding_box
from tactorch.mesh.values import Points, Triangles

_INSIDE = 1e-9  # tolerance of barycentric coordinates
_PARALLEL = 1e-12  # sine between an edge and a triangle below which they do not cross


def crossing_triangles(vertices: Points, triangles: Triangles) -> Int[np.ndarray, "pairs 2"]:
    """Return pairs of triangles of which an edge of one passes through the other.

    Triangles that touch with a vertex, or overlap in one plane, are not found.
    """
    low, high = bounding_box(vertices)
    axis = int((high - low).argmax())  # along which few boxes overlap
    corners = vertices[triangles]
    order = np.argsort(corners[:, :, axis].min(axis=1), kind="stable")
    pairs = _sweep(
        np.ascontiguousarray(corners[order]), np.ascontiguousarray(triangles[order]), axis
    )
    return order[pairs]


def require_no_crossing(vertices: Points, triangles: Triangles) -> None:
    """Raise `MeshError` where a surface crosses itself: parts of it would be counted twice."""
    crossing = crossing_triangles(vertices, triangles)
    if len(crossing):
        crossed = np.isin(np.arange(len(triangles)), crossing)
        x, y, z = vertices[triangles[crossing[0, 0]]].mean(axis=0)
        raise MeshError(
            f"The surface intersects itself: {listing(crossed, 'triangles')} cross others, in"
            f" {len(crossing)} places, one near ({x:.3g}, {y:.3g}, {z:.3g}) mm. Repair it in a"
            " mesh editor, by a union of its parts."
        )


@no_type_check
@numba.njit(nogil=True, cache=True)
def _sweep(corners, triangles, axis):
    """Return the pairs of triangles (k, 3), sorted by their lowest coordinate, that cross."""
    count = len(corners)
    low, high = np.empty((count, 3)), np.empty((count, 3))
    for i in range(count):
        for d in range(3):
            low[i, d] = corners[i, :, d].min()
            high[i, d] = corners[i, :, d].max()
    found = [(0, 0) for _ in range(0)]
    for i in range(count):
        for j in range(i + 1, count):
            if low[j, axis] > high[i, axis]:
                break
            apart = False
            for d in range(3):
                apart |= low[j, d] > high[i, d] or low[i, d] > high[j, d]
            if apart:
                continue
            if _cross(corners[i], triangles[i], corners[j], triangles[j]) or _cross(
                corners[j], triangles[j], corners[i], triangles[i]
            ):
                found.append((i, j))
    pairs = np.empty((len(found), 2), np.int64)
    for k in range(len(found)):
        pairs[k, 0], pairs[k, 1] = found[k]
    return pairs


@no_type_check
@numba.njit(nogil=True, cache=True)
def _cross(edges_of, their_nodes, face, face_nodes):
    """Return whether an edge of a triangle passes through a face (T. Moeller, B. Trumbore 1997)."""
    side, other = face[1] - face[0], face[2] - face[0]
    for k in range(3):
        start, end = their_nodes[k], their_nodes[(k + 1) % 3]
        shared = False
        for m in range(3):
            shared |= face_nodes[m] == start or face_nodes[m] == end
        if shared:  # an edge meets the face in their common vertex only, or is in its plane
            continue
        push = edges_of[(k + 1) % 3] - edges_of[k]
        across = np.cross(push, other)
        determinant = np.dot(side, across)
        size = np.sqrt(np.dot(push, push) * np.dot(side, side) * np.dot(other, other))
        if abs(determinant) <= _PARALLEL * size:
            continue
        offset = edges_of[k] - face[0]
        first = np.dot(offset, across) / determinant
        turned = np.cross(offset, side)
        second = np.dot(push, turned) / determinant
        along = np.dot(other, turned) / determinant
        if (
            first > -_INSIDE
            and second > -_INSIDE
            and first + second < 1.0 + _INSIDE
            and _INSIDE < along < 1.0 - _INSIDE
        ):
            return True
    return False
