"""Tetrahedral mesh: immutable data, validated on construction."""

import hashlib
import logging
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, get_args

import numpy as np
from jaxtyping import Float, Int

from tactorch.display import Displayed
from tactorch.errors import ConfigError, MeshError
from tactorch.mesh.checks import as_cells, as_points, as_regions, check_elements, check_faces
from tactorch.mesh.geometry import area_vectors, bounding_box, frozen, signed_volumes, vertex_areas
from tactorch.mesh.topology import (
    Adjacency,
    FaceMatch,
    Surface,
    flat_faces,
    match_faces,
    number_edges,
)
from tactorch.mesh.values import Corners, Points, Real, Rows, Tets

logger = logging.getLogger(__name__)

FaceName = Literal["x-", "x+", "y-", "y+", "z-", "z+"]
#: Sides of the bounding box.
FACE_NAMES = get_args(FaceName)
# A triangle belongs to a side if its normal deviates less than 45 degrees from the side's.
_MIN_COSINE = np.sqrt(0.5)


@dataclass(frozen=True, eq=False, repr=False)
class TetMesh(Displayed):
    """Linear tetrahedra in mm; n nodes, m elements.

    The arrays are copied, made read-only and checked: non-finite points, indices out of range,
    repeated vertices, unreferenced nodes, duplicate, degenerate, inverted or overlapping elements
    and disconnected parts raise `MeshError`. Use `create` for meshes of unknown orientation.

    Attributes:
        points: Node positions, mm, float64.
        tets: Node indices of each element, positively oriented, int64.
        regions: Region number of each element, such as the label of a segmentation; None where the
            mesh has no regions.
    """

    points: Points
    tets: Tets
    regions: Int[np.ndarray, " m"] | None = None

    def __post_init__(self) -> None:
        points = as_points(self.points)
        tets = as_cells(self.tets, 4, len(points))
        object.__setattr__(self, "points", frozen(points))
        object.__setattr__(self, "tets", frozen(tets))
        if self.regions is not None:
            object.__setattr__(self, "regions", frozen(as_regions(self.regions, len(tets))))
        check_elements(points, tets)
        check_faces(self._faces, self.n_tets)

    @classmethod
    def create(
        cls, points: Rows, tets: Rows, repair: bool = True, regions: Rows | None = None
    ) -> "TetMesh":
        """Build a mesh from array-likes of shape (n, 3) and (m, 4), and (m,) for regions.

        `repair` swaps the last two vertices of inverted elements rather than refusing them. The
        order of nodes and elements is kept.
        """
        nodes = as_points(points)
        cells = as_cells(tets, 4, len(nodes))
        if repair:
            inverted = signed_volumes(nodes, cells) < 0
            cells[inverted] = cells[inverted][:, [0, 1, 3, 2]]
            if inverted.any():
                logger.info("Reoriented %d of %d elements.", inverted.sum(), len(cells))
        return cls(nodes, cells, None if regions is None else as_regions(regions, len(cells)))

    def with_regions(self, regions: Rows | None) -> "TetMesh":
        """Return the same mesh with other region numbers, (m,), or none."""
        return TetMesh.create(self.points, self.tets, repair=False, regions=regions)

    def summary(self) -> str:
        """Return a description of the mesh in a few lines of text."""
        size = " x ".join(f"{edge:.3g}" for edge in self.bounds[1] - self.bounds[0])
        quantiles = np.quantile(self.edge_lengths, [0.0, 0.5, 1.0])
        low, middle, high = (f"{x:.3g}" for x in quantiles)
        lines = [
            f"{self.n_points} nodes, {self.n_tets} tetrahedra",
            f"{size} mm, {self.volumes.sum():.4g} mm3",
            f"edges of {low} to {high} mm, median {middle} mm",
        ]
        if self.regions is not None:
            lines.append(f"regions: {', '.join(map(str, np.unique(self.regions)))}")
        return "\n".join(lines)

    def __repr__(self) -> str:
        return f"TetMesh({self.n_points} nodes, {self.n_tets} tets, {self.diagonal:.4g} mm across)"

    def __reduce__(self) -> tuple[type["TetMesh"], tuple[np.ndarray | None, ...]]:
        """Pickle and copy the data only; copies are checked and read-only too."""
        return type(self), (self.points, self.tets, self.regions)

    @property
    def n_points(self) -> int:
        """Number of nodes."""
        return len(self.points)

    @property
    def n_tets(self) -> int:
        """Number of elements."""
        return len(self.tets)

    @cached_property
    def volumes(self) -> Float[np.ndarray, " m"]:
        """Volume of each element, mm^3, positive."""
        return frozen(signed_volumes(self.points, self.tets))

    @cached_property
    def centroids(self) -> Float[np.ndarray, "m 3"]:
        """Centroid of each element, mm."""
        return frozen(self.points[self.tets].mean(axis=1))

    @cached_property
    def bounds(self) -> Corners:
        """Lowest and highest corner of the bounding box, mm."""
        return frozen(bounding_box(self.points))

    @cached_property
    def diagonal(self) -> float:
        """Length of the bounding box's diagonal, mm."""
        return float(np.linalg.norm(self.bounds[1] - self.bounds[0]))

    @cached_property
    def surface(self) -> Surface:
        """Boundary triangles, oriented outward."""
        triangles = flat_faces(self.tets, self._faces.boundary)
        vectors = area_vectors(self.points, triangles)
        areas = np.linalg.norm(vectors, axis=1)
        arrays = triangles, vectors / areas[:, None], areas, self._faces.boundary // 4
        return Surface(*map(frozen, arrays))

    @cached_property
    def adjacency(self) -> Adjacency:
        """Pairs of elements that share a face."""
        pairs = self._faces.pairs // 4
        shared = flat_faces(self.tets, self._faces.pairs[:, 0])
        areas = np.linalg.norm(area_vectors(self.points, shared), axis=1)
        offsets = self.centroids[pairs[:, 0]] - self.centroids[pairs[:, 1]]
        return Adjacency(frozen(pairs), frozen(areas), frozen(np.linalg.norm(offsets, axis=1)))

    @cached_property
    def vertex_areas(self) -> Float[np.ndarray, " n"]:
        """One third of the area of the boundary triangles at each node, mm^2; zero inside."""
        return frozen(vertex_areas(self.points, self.surface.triangles))

    @property
    def edges(self) -> Int[np.ndarray, "k 2"]:
        """Unique edges, smaller node first, sorted."""
        return self._edges[0]

    @property
    def tet_edges(self) -> Int[np.ndarray, "m 6"]:
        """Each element's edges 01, 02, 03, 12, 13, 23 as rows of `edges`."""
        return self._edges[1]

    @property
    def edge_lengths(self) -> Float[np.ndarray, " k"]:
        """Length of each edge, mm."""
        return np.linalg.norm(np.diff(self.points[self.edges], axis=1)[:, 0], axis=1)

    def content_hash(self) -> str:
        """Return the SHA-256 of points and elements, the same on every platform.

        Regions do not change it: they do not change the equilibrium.
        """
        digest = hashlib.sha256(f"tetmesh 1 {self.n_points} {self.n_tets} ".encode())
        digest.update((self.points + 0.0).astype("<f8").tobytes())  # -0.0 becomes 0.0
        digest.update(self.tets.astype("<i8").tobytes())
        return digest.hexdigest()

    @cached_property
    def _faces(self) -> FaceMatch:
        return match_faces(self.tets, self.n_points)

    @cached_property
    def _edges(self) -> tuple[Int[np.ndarray, "k 2"], Int[np.ndarray, "m 6"]]:
        edges, tet_edges = number_edges(self.tets, self.n_points)
        return frozen(edges), frozen(tet_edges)


def compact(
    points: Rows, cells: Rows
) -> tuple[Float[np.ndarray, "r 3"], Int[np.ndarray, "m w"], Int[np.ndarray, " r"]]:
    """Drop the points (n, 3) that no cell (m, w) uses, and renumber the cells; order is kept.

    Returns:
        The remaining points, the renumbered cells, and the old index of each remaining point.
    """
    nodes = as_points(points)
    width = np.shape(cells)[-1] if np.ndim(cells) == 2 else 4
    rows = as_cells(cells, width, len(nodes), "cells")
    used = np.unique(rows)
    return nodes[used], np.searchsorted(used, rows), used


def select_face(mesh: TetMesh, name: str, tolerance: Real = 2e-3) -> Int[np.ndarray, " k"]:
    """Return the boundary triangles on one flat side of the bounding box; at least one.

    They are ascending indices into `mesh.surface.triangles`.

    Args:
        mesh: Mesh.
        name: One of `FACE_NAMES`.
        tolerance: Maximum distance of a vertex from the side's plane, as a fraction of the
            bounding box's diagonal. The default covers the envelope of `tetrahedralize`.
    """
    if name not in FACE_NAMES:
        raise ConfigError(f"Unknown face '{name}'; choose one of {', '.join(FACE_NAMES)}.")
    if not 0 <= tolerance < 0.5:
        raise ConfigError(f"tolerance={tolerance} must be in [0, 0.5), a fraction of the diagonal.")
    axis, high = "xyz".index(name[0]), int(name[1] == "+")
    surface = mesh.surface
    depth = np.abs(mesh.points[surface.triangles, axis] - mesh.bounds[high, axis]).max(axis=1)
    outward = surface.normals[:, axis] * (1 if high else -1)
    selected = np.flatnonzero((depth <= tolerance * mesh.diagonal) & (outward > _MIN_COSINE))
    if not selected.size:
        raise MeshError(
            f"No boundary triangle is on side '{name}' within {tolerance:g} of the bounding box's"
            f" diagonal ({mesh.diagonal:.4g} mm): the mesh is not flat there. Raise the tolerance,"
            " or select triangles by their position."
        )
    return selected


def face_nodes(mesh: TetMesh, name: str, tolerance: Real = 2e-3) -> Int[np.ndarray, " k"]:
    """Return the nodes of `select_face`, ascending; same arguments and errors."""
    return np.unique(mesh.surface.triangles[select_face(mesh, name, tolerance)])
