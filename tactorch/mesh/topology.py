"""Who touches whom: faces and edges of a list of tetrahedra, vectorised over all of them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Int

#: Face `i` lies opposite vertex `i`; counter-clockwise from outside a positive tetrahedron.
LOCAL_FACES = np.array([(1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1)])
#: The six edges, in the order of `TetMesh.tet_edges`.
LOCAL_EDGES = np.array([(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)])
LOCAL_FACES.setflags(write=False)
LOCAL_EDGES.setflags(write=False)


@dataclass(frozen=True, eq=False)
class FaceMatch:
    """How the 4m element faces meet. Flat face `4 * tet + i` is opposite local vertex `i`.

    Attributes:
        boundary: Flat faces that belong to one element only, ascending.
        pairs: Flat faces that coincide, one row a shared face, sorted by elements (i, j), i < j.
        crowded: Flat faces met by three or more elements (empty in a sound mesh).
        folded: Those flat faces of `pairs` whose two elements lie on the same side of them.
    """

    boundary: Int[np.ndarray, " k"]
    pairs: Int[np.ndarray, "f 2"]
    crowded: Int[np.ndarray, " c"]
    folded: Int[np.ndarray, " g"]


def match_faces(tets: Int[np.ndarray, "m 4"], n_points: int) -> FaceMatch:
    """Find which element faces coincide, which lie on the boundary, and which meet wrongly."""
    faces = tets[:, LOCAL_FACES].reshape(-1, 3)
    keys = row_keys(np.sort(faces, axis=1), n_points)
    order = np.argsort(keys, kind="stable")
    same = keys[order[1:]] == keys[order[:-1]]
    like_previous = np.concatenate(([False], same))
    like_next = np.concatenate((same, [False]))
    first = np.flatnonzero(like_next & ~like_previous)
    pairs = np.column_stack((order[first], order[first + 1]))
    pairs = pairs[np.argsort(row_keys(pairs // 4, len(tets)))]
    odd = _is_odd(faces)
    return FaceMatch(
        boundary=np.sort(order[~like_previous & ~like_next]),
        pairs=pairs,
        crowded=np.sort(order[like_previous & like_next]),
        # Seen from its two elements, a shared face must turn in opposite senses.
        folded=pairs[odd[pairs[:, 0]] == odd[pairs[:, 1]]].ravel(),
    )


def match_edges(
    tets: Int[np.ndarray, "m 4"], n_points: int
) -> tuple[Int[np.ndarray, "k 2"], Int[np.ndarray, "m 6"]]:
    """Return the unique edges (smaller node first, sorted) and the six edges of each element."""
    ends = np.sort(tets[:, LOCAL_EDGES].reshape(-1, 2), axis=1)
    keys = row_keys(ends, n_points)
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    return ends[first], inverse.reshape(-1, 6)


def row_keys(rows: Int[np.ndarray, "r w"], n_points: int) -> Int[np.ndarray, " r"]:
    """Number rows of node indices so that equal rows, and only they, have equal numbers.

    The order of the numbers is the lexicographic order of the rows.
    """
    if n_points ** rows.shape[1] > np.iinfo(np.int64).max:
        return np.unique(rows, axis=0, return_inverse=True)[1].reshape(-1)
    keys = rows[:, 0].astype(np.int64)
    for column in rows.T[1:]:
        keys = keys * n_points + column
    return keys


def _is_odd(faces: Int[np.ndarray, "r 3"]) -> Bool[np.ndarray, " r"]:
    """Whether sorting each triple takes an odd number of swaps."""
    a, b, c = faces.T
    return (a > b) ^ (a > c) ^ (b > c)
