"""Faces and edges of tetrahedra: matching, boundary and adjacency, vectorised over all elements."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from tactorch.mesh.geometry import frozen
from tactorch.mesh.values import Tets, Triangles

#: Face `i` is opposite vertex `i`; counter-clockwise from outside a positive tetrahedron.
LOCAL_FACES = frozen(np.array([(1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1)]))
#: The six edges, in the order of `TetMesh.tet_edges`.
LOCAL_EDGES = frozen(np.array([(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]))


@dataclass(frozen=True, eq=False)
class Surface:
    """Boundary of a `TetMesh`, ordered by owner. Arrays are read-only.

    Attributes:
        triangles: Node indices of the mesh, counter-clockwise from outside.
        normals: Unit outward normals.
        areas: Areas, mm^2.
        owners: Index of the tetrahedron that each triangle belongs to.
    """

    triangles: Triangles
    normals: Float[np.ndarray, "k 3"]
    areas: Float[np.ndarray, " k"]
    owners: Int[np.ndarray, " k"]

    def nodes(self) -> Int[np.ndarray, " s"]:
        """Return the boundary nodes, ascending, without duplicates."""
        return np.unique(self.triangles)


@dataclass(frozen=True, eq=False)
class Adjacency:
    """Pairs of tetrahedra that share a face, sorted. Arrays are read-only.

    Attributes:
        pairs: Element indices (i, j) with i < j.
        areas: Area of the shared face, mm^2.
        distances: Distance between the two centroids, mm.
    """

    pairs: Int[np.ndarray, "f 2"]
    areas: Float[np.ndarray, " f"]
    distances: Float[np.ndarray, " f"]


class FaceMatch(NamedTuple):
    """Matched element faces; flat face `4 * tet + i` is opposite local vertex `i`."""

    boundary: Int[np.ndarray, " k"]  # faces of one element only, ascending
    pairs: Int[np.ndarray, "f 2"]  # faces that coincide, sorted by elements (i, j), i < j
    crowded: Int[np.ndarray, " c"]  # faces shared by three or more elements
    folded: Int[np.ndarray, " g"]  # faces of `pairs` with both elements on the same side


def match_faces(tets: Tets, n_points: int) -> FaceMatch:
    """Match the 4m element faces with one another."""
    faces = tets[:, LOCAL_FACES].reshape(-1, 3)
    keys = row_keys(np.sort(faces, axis=1), n_points)
    order = np.argsort(keys, kind="stable")
    same = keys[order[1:]] == keys[order[:-1]]
    like_previous = np.concatenate(([False], same))
    like_next = np.concatenate((same, [False]))
    first = np.flatnonzero(like_next & ~like_previous)
    pairs = np.column_stack((order[first], order[first + 1]))
    pairs = pairs[np.argsort(row_keys(pairs // 4, len(tets)))]
    # Seen from its two elements, a shared face must turn in opposite senses.
    a, b, c = faces.T
    odd = (a > b) ^ (a > c) ^ (b > c)
    return FaceMatch(
        boundary=np.sort(order[~like_previous & ~like_next]),
        pairs=pairs,
        crowded=np.sort(order[like_previous & like_next]),
        folded=pairs[odd[pairs[:, 0]] == odd[pairs[:, 1]]].ravel(),
    )


def triangle_edges(triangles: Triangles) -> Int[np.ndarray, "e 2"]:
    """Return the edges of each triangle, lower node first; edge 3 t + i begins at its vertex i."""
    return np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)


def matched_edges(edges: Int[np.ndarray, "e 2"]) -> Int[np.ndarray, "pairs 2"]:
    """Return the pairs of equal edges, by the edges; lower node first."""
    keys = row_keys(edges, int(edges.max(initial=0)) + 1)
    order = np.argsort(keys, kind="stable")
    first = np.flatnonzero(keys[order[1:]] == keys[order[:-1]])
    return np.column_stack((order[first], order[first + 1]))


def number_edges(
    tets: Tets, n_points: int
) -> tuple[Int[np.ndarray, "e 2"], Int[np.ndarray, "m 6"]]:
    """Return the nodes of each edge, in ascending order, and the edges of each element."""
    first, second = tets[:, LOCAL_EDGES].transpose(2, 0, 1)
    pairs = np.minimum(first, second) * n_points + np.maximum(first, second)
    keys, inverse = np.unique(pairs, return_inverse=True)
    return np.column_stack(np.divmod(keys, n_points)), inverse.reshape(-1, 6)


def flat_faces(tets: Tets, faces: Int[np.ndarray, " k"]) -> Int[np.ndarray, "k 3"]:
    """Return the nodes of flat faces, see `FaceMatch`; counter-clockwise from outside."""
    return tets[faces[:, None] // 4, LOCAL_FACES[faces % 4]]


def row_keys(rows: Int[np.ndarray, "r w"], n_points: int) -> Int[np.ndarray, " r"]:
    """Number rows of node indices: equal rows have equal numbers, in lexicographic order."""
    if n_points ** rows.shape[1] > np.iinfo(np.int64).max:
        return np.unique(rows, axis=0, return_inverse=True)[1].reshape(-1)
    keys = rows[:, 0].astype(np.int64)
    for column in rows.T[1:]:
        keys = keys * n_points + column
    return keys
