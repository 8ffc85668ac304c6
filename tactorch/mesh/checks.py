"""What must hold of a mesh before anything is computed on it. Every fault is refused by name."""

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from tactorch.errors import MeshError
from tactorch.mesh.geometry import longest_edges, signed_volumes
from tactorch.mesh.topology import FaceMatch
from tactorch.mesh.values import Rows

#: An element is flat where six times its volume is below this share of its longest edge cubed
#: (a regular tetrahedron has 0.71): its stiffness would drown that of its neighbours.
FLATNESS = 1e-9


def as_points(points: Rows, what: str = "points") -> Float[np.ndarray, "n 3"]:
    """Return a float64 copy of shape (n, 3) of finite numbers, or raise `MeshError`."""
    array = _as_rows(points, 3, what)
    if array.dtype.kind not in "fiu":
        raise MeshError(f"{what} must be real numbers, not {array.dtype}.")
    array = array.astype(np.float64)
    bad = np.flatnonzero(~np.isfinite(array).all(axis=1))
    if bad.size:
        raise MeshError(
            f"{what} hold NaN or infinite coordinates in {listing(bad, len(array), 'rows')}."
            " Repair them, or mesh the shape again."
        )
    return array


def as_cells(cells: Rows, width: int, n_points: int, what: str = "tets") -> Int[np.ndarray, "m w"]:
    """Return an int64 copy of shape (m, width) of distinct indices below `n_points`."""
    array = _as_rows(cells, width, what)
    if array.dtype.kind not in "iu":
        raise MeshError(f"{what} must be integer indices, not {array.dtype}.")
    array = array.astype(np.int64)
    bad = np.flatnonzero(((array < 0) | (array >= n_points)).any(axis=1))
    if bad.size:
        raise MeshError(
            f"{what} index points outside 0..{n_points - 1} in {listing(bad, len(array), 'rows')};"
            " indices count from 0."
        )
    ordered = np.sort(array, axis=1)
    bad = np.flatnonzero((ordered[:, 1:] == ordered[:, :-1]).any(axis=1))
    if bad.size:
        raise MeshError(f"{what} repeat a vertex within {listing(bad, len(array), 'rows')}.")
    return array


def check_elements(points: Float[np.ndarray, "n 3"], tets: Int[np.ndarray, "m 4"]) -> None:
    """Refuse unreferenced nodes, duplicate, degenerate and inverted elements."""
    _check_referenced(points, tets)
    _check_unique(tets)
    volumes = signed_volumes(points, tets)
    _check_not_flat(points, tets, volumes)
    bad = np.flatnonzero(volumes < 0)
    if bad.size:
        raise MeshError(
            f"The mesh has inverted elements (negative volume): {listing(bad, len(tets))}."
            " TetMesh.create(points, tets) reorders their vertices."
        )


def check_faces(faces: FaceMatch, n_tets: int) -> None:
    """Refuse crowded faces, folded elements and parts that share no face."""
    if faces.crowded.size:
        bad = np.unique(faces.crowded // 4)
        raise MeshError(
            f"A face is shared by three or more elements: {listing(bad, n_tets)} overlap others."
        )
    if faces.folded.size:
        bad = np.unique(faces.folded // 4)
        raise MeshError(
            f"The mesh folds over itself: {listing(bad, n_tets)} lie on the same side of a shared"
            " face as their neighbour. Mesh the shape again."
        )
    _check_connected(faces.pairs // 4, n_tets)


def listing(indices: Int[np.ndarray, " k"], total: int, noun: str = "elements") -> str:
    """Say how many of how many, and which come first: '3 of 40 elements (4, 7, 9)'."""
    first = ", ".join(str(i) for i in indices[:5])
    more = ", ..." if len(indices) > 5 else ""
    return f"{len(indices)} of {total} {noun} ({first}{more})"


def _as_rows(values: Rows, width: int, what: str) -> NDArray:
    try:
        array = np.asarray(values)
    except ValueError as error:
        raise MeshError(f"{what} must form an array of shape (k, {width}): {error}.") from error
    if array.ndim != 2 or array.shape[1] != width:
        raise MeshError(f"{what} must have shape (k, {width}), not {array.shape}.")
    if not len(array):
        raise MeshError(f"{what} are empty.")
    return array


def _check_referenced(points: Float[np.ndarray, "n 3"], tets: Int[np.ndarray, "m 4"]) -> None:
    bad = unreferenced(len(points), tets)
    if bad.size:
        raise MeshError(
            f"No element uses {listing(bad, len(points), 'nodes')}: their displacement would be"
            " undetermined. Drop them (tactorch.mesh.compact does, and renumbers)."
        )


def unreferenced(n_points: int, cells: Int[np.ndarray, "m w"]) -> Int[np.ndarray, " k"]:
    """Return the points that no cell uses."""
    return np.flatnonzero(np.bincount(cells.ravel(), minlength=n_points) == 0)


def _check_unique(tets: Int[np.ndarray, "m 4"]) -> None:
    ordered = np.sort(tets, axis=1)
    order = np.lexsort(ordered.T)
    again = (ordered[order[1:]] == ordered[order[:-1]]).all(axis=1)
    bad = np.sort(order[1:][again])
    if bad.size:
        raise MeshError(f"The mesh repeats elements: {listing(bad, len(tets))} appear earlier too.")


def _check_not_flat(
    points: Float[np.ndarray, "n 3"],
    tets: Int[np.ndarray, "m 4"],
    volumes: Float[np.ndarray, " m"],
) -> None:
    longest = longest_edges(points, tets)
    # Coordinates are known to rounding only, which far from the origin hides a small height.
    rounding = 64 * np.finfo(np.float64).eps * np.abs(points).max() * longest**2
    bad = np.flatnonzero(6 * np.abs(volumes) <= np.maximum(FLATNESS * longest**3, rounding))
    if bad.size:
        raise MeshError(
            f"The mesh has degenerate elements (no volume): {listing(bad, len(tets))}."
            " Mesh the shape again, or merge nodes that coincide."
        )


def _check_connected(pairs: Int[np.ndarray, "f 2"], n_tets: int) -> None:
    links = coo_array((np.ones(len(pairs), bool), (pairs[:, 0], pairs[:, 1])), (n_tets, n_tets))
    count, labels = connected_components(links, directed=False)
    if count > 1:
        sizes = np.sort(np.bincount(labels))[::-1]
        shown = ", ".join(str(s) for s in sizes[:5]) + (", ..." if count > 5 else "")
        raise MeshError(
            f"The mesh is in {count} disconnected parts (of {shown} elements) that share no face."
            " Keep one part, or merge the nodes where the parts should be glued."
        )
