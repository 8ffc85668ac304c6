"""Validation of meshes and surfaces; every message names the faulty nodes or cells."""

from itertools import combinations
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from tactorch.errors import MeshError
from tactorch.mesh.geometry import bounding_diagonal, enclosed_volume, signed_volumes
from tactorch.mesh.topology import FaceMatch
from tactorch.mesh.values import Points, Rows, Tets, Triangles

#: An element is degenerate where six times its volume is below this fraction of its longest edge
#: cubed (a regular tetrahedron has 0.71): its stiffness would dominate that of its neighbours.
MIN_RELATIVE_VOLUME = 1e-9


def as_points(points: Rows, what: str = "points") -> Float[np.ndarray, "n 3"]:
    """Return a float64 copy of shape (n, 3) of finite numbers, or raise `MeshError`."""
    array = _as_rows(points, 3, what)
    if array.dtype.kind not in "fiu":
        raise MeshError(f"{what} must be real numbers, not {array.dtype}.")
    array = array.astype(np.float64)
    _refuse(
        ~np.isfinite(array).all(axis=1),
        what + " hold NaN or infinite coordinates in {}. Repair them, or mesh the shape again.",
        "rows",
    )
    return array


def as_cells(cells: Rows, width: int, n_points: int, what: str = "tets") -> Int[np.ndarray, "m w"]:
    """Return an int64 copy of shape (m, width) of distinct indices below `n_points`."""
    array = _as_rows(cells, width, what)
    if array.dtype.kind not in "iu":
        raise MeshError(f"{what} must be integer indices, not {array.dtype}.")
    array = array.astype(np.int64)
    _refuse(
        ((array < 0) | (array >= n_points)).any(axis=1),
        f"{what} index points outside 0..{n_points - 1} in {{}}; indices count from 0.",
        "rows",
    )
    repeats = (np.diff(np.sort(array, axis=1), axis=1) == 0).any(axis=1)
    _refuse(repeats, what + " repeat a vertex within {}.", "rows")
    return array


def as_regions(regions: Rows, n_tets: int) -> Int[np.ndarray, " m"]:
    """Return an int64 copy of the region number of each element, or raise `MeshError`."""
    array = np.asarray(regions)
    if array.shape != (n_tets,):
        raise MeshError(
            f"regions have shape {array.shape}; give one number for each of {n_tets} elements."
        )
    if array.dtype.kind not in "fiu" or not (np.isfinite(array) & (array == np.round(array))).all():
        raise MeshError("regions must be whole numbers, such as the labels of a segmentation.")
    return array.astype(np.int64)


def check_elements(points: Points, tets: Tets) -> None:
    """Refuse unreferenced nodes, duplicate, degenerate and inverted elements."""
    _refuse(
        unreferenced(len(points), tets),
        "No element uses {}: their displacement would be undetermined. Drop them"
        " (tactorch.mesh.compact does, and renumbers).",
        "nodes",
    )
    ordered = np.sort(tets, axis=1)
    order = np.lexsort(ordered.T)
    repeated = np.zeros(len(tets), dtype=bool)
    repeated[order[1:]] = (ordered[order[1:]] == ordered[order[:-1]]).all(axis=1)
    _refuse(repeated, "The mesh repeats elements: {} appear earlier too; remove them.")
    volumes = signed_volumes(points, tets)
    pairs = combinations(points[tets].swapaxes(0, 1), 2)
    longest = np.sqrt(np.max([np.square(a - b).sum(axis=1) for a, b in pairs], axis=0))
    # Coordinates are known to rounding only, which far from the origin hides a small height.
    rounding = 64 * np.finfo(np.float64).eps * np.abs(points).max() * longest**2
    _refuse(
        6 * np.abs(volumes) <= np.maximum(MIN_RELATIVE_VOLUME * longest**3, rounding),
        "The mesh has degenerate elements (no volume): {}. Mesh the shape again, or merge nodes"
        " that coincide.",
    )
    _refuse(
        volumes < 0,
        "The mesh has inverted elements (negative volume): {}. TetMesh.create(points, tets)"
        " reorders their vertices.",
    )


def check_faces(faces: FaceMatch, n_tets: int) -> None:
    """Refuse overlapping elements, folded elements and parts that share no face."""
    _refuse(
        np.bincount(faces.crowded // 4, minlength=n_tets) > 0,
        "A face is shared by three or more elements: {} overlap others.",
    )
    _refuse(
        np.bincount(faces.folded // 4, minlength=n_tets) > 0,
        "The mesh folds over itself: {} are on the same side of a shared face as their neighbour."
        " Mesh the shape again.",
    )
    links = coo_array((np.ones(len(faces.pairs), bool), (faces.pairs // 4).T), (n_tets, n_tets))
    count, labels = connected_components(links, directed=False)
    if count > 1:
        sizes = np.sort(np.bincount(labels))[::-1]
        shown = ", ".join(str(s) for s in sizes[:5]) + (", ..." if count > 5 else "")
        raise MeshError(
            f"The mesh is in {count} disconnected parts (of {shown} elements) that share no face."
            " Keep one part, or merge the nodes where the parts should be glued."
        )


def closed_surface(vertices: Rows, triangles: Rows) -> tuple[Points, Triangles]:
    """Check a closed triangle surface and orient it outward.

    Each edge must belong to exactly two triangles of opposite orientation, and the surface must
    enclose a volume. Unreferenced vertices are accepted.
    """
    points = as_points(vertices, "vertices")
    faces = as_cells(triangles, 3, len(points), "triangles")
    _check_edges(faces, len(points))
    volume = enclosed_volume(points, faces)
    if abs(volume) <= 1e-9 * bounding_diagonal(points[faces.ravel()]) ** 3:
        raise MeshError("The surface encloses no volume: it is flat or folded onto itself.")
    return points, faces if volume > 0 else faces[:, ::-1].copy()


def listing(selected: Bool[np.ndarray, " k"], noun: str) -> str:
    """Return a count and the first indices: '3 of 40 elements (4, 7, 9)'."""
    indices = np.flatnonzero(selected)
    first = ", ".join(str(i) for i in indices[:5])
    more = ", ..." if len(indices) > 5 else ""
    return f"{len(indices)} of {len(selected)} {noun} ({first}{more})"


def unreferenced(n_points: int, cells: Int[np.ndarray, "m w"]) -> Bool[np.ndarray, " n"]:
    """Return whether no cell uses each point."""
    return np.bincount(cells.ravel(), minlength=n_points) == 0


def _refuse(invalid: Any, message: str, noun: str = "elements") -> None:
    """Raise `MeshError` with the listing of invalid rows in place of {}, if there are any."""
    if invalid.any():
        raise MeshError(message.format(listing(invalid, noun)))


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


def _check_edges(faces: Triangles, n_points: int) -> None:
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    keys = np.minimum(start, end) * n_points + np.maximum(start, end)
    unique, inverse, counts = np.unique(keys, return_inverse=True, return_counts=True)

    def refuse(edges: Bool[np.ndarray, " e"], message: str) -> None:
        _refuse(edges[inverse].reshape(-1, 3).any(axis=1), message, "triangles")

    refuse(
        counts == 1,
        f"The surface is open: {(counts == 1).sum()} of its {len(unique)} edges belong to one"
        " triangle only, at {}. Close the holes; if each triangle has separate vertices, merge"
        " equal ones (read_surface does).",
    )
    refuse(
        counts > 2,
        f"The surface is not a manifold: {(counts > 2).sum()} of its {len(unique)} edges belong"
        " to more than two triangles, at {}. Remove duplicate or inner triangles.",
    )
    refuse(
        np.bincount(inverse, weights=np.sign(end - start)) != 0,
        "The surface's triangles are not oriented consistently at {}: make their normals"
        " consistent.",
    )
