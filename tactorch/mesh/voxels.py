"""Point location, and a regular grid over a mesh for images and networks. Lengths in mm."""

from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from tactorch.errors import ConfigError, MeshError
from tactorch.mesh.tetmesh import TetMesh

# Barycentric tolerance, so that points on shared faces are not lost to rounding.
_TOLERANCE = 1e-9
# Point-tetrahedron pairs tested at once; limits the memory to some hundred megabytes.
_MAX_PAIRS = 1_000_000


def locate(mesh: TetMesh, points: Float[np.ndarray, "p 3"], k: int = 8) -> Int[np.ndarray, " p"]:
    """Return the index of the element that contains each point (mm), -1 outside the body.

    The `k` elements of nearest centroid are tested first; the remaining points are tested against
    every element whose bounding ball contains them, so the result is exact. A point on a shared
    face gets one of its elements.
    """
    elements = np.full(len(points), -1, dtype=np.int64)
    low, high = mesh.bounds
    margin = _TOLERANCE * mesh.diagonal
    near = np.flatnonzero(np.all((points >= low - margin) & (points <= high + margin), axis=1))
    if not len(near):
        return elements
    corners = mesh.points[mesh.tets]
    inverses = np.linalg.inv((corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1))

    def assign(candidates: np.ndarray, indices: np.ndarray) -> None:
        """Assign each candidate element to the point of the same row, if it contains it."""
        offsets = points[indices] - corners[candidates, 0]
        local = np.einsum("qij,qj->qi", inverses[candidates], offsets)
        inside = (local >= -_TOLERANCE).all(axis=1) & (local.sum(axis=1) <= 1.0 + _TOLERANCE)
        elements[indices[inside]] = candidates[inside]

    count = max(1, min(k, mesh.n_tets))
    _, nearest = cKDTree(mesh.centroids).query(points[near], k=np.arange(1, count + 1))
    for column in nearest.T:
        missing = elements[near] < 0
        assign(column[missing], near[missing])
    rest = near[elements[near] < 0]
    if not len(rest):
        return elements
    radii = np.linalg.norm(corners - mesh.centroids[:, None], axis=2).max(axis=1) * (1.0 + 1e-6)
    reached = cKDTree(points[rest]).query_ball_point(mesh.centroids, radii)
    counts = np.fromiter(map(len, reached), dtype=np.int64, count=len(reached))
    ends = np.flatnonzero(np.diff(np.cumsum(counts) // _MAX_PAIRS)) + 1
    for block in np.split(np.arange(mesh.n_tets), ends):
        indices = np.concatenate([np.asarray(r, dtype=np.int64) for r in reached[block]])
        assign(np.repeat(block, counts[block]), rest[indices])
    return elements


@dataclass(frozen=True, eq=False)
class VoxelGrid:
    """Bounding box of a mesh of m elements, divided into `count` voxels in each direction."""

    mesh: TetMesh
    count: int

    def __post_init__(self) -> None:
        if self.count < 1:
            raise ConfigError(f"voxels={self.count} must be at least 1.")

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of voxels along x, y and z."""
        return (self.count,) * 3

    @property
    def size_mm(self) -> Float[np.ndarray, "3"]:
        """Edge lengths of a voxel, mm."""
        low, high = self.mesh.bounds
        return (high - low) / self.count

    @cached_property
    def centres(self) -> Float[np.ndarray, "v v v 3"]:
        """Centres of the voxels, mm."""
        low = self.mesh.bounds[0]
        axes = [low[i] + self.size_mm[i] * (np.arange(self.count) + 0.5) for i in range(3)]
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)

    @cached_property
    def nearest(self) -> Int[np.ndarray, "v v v"]:
        """Element of nearest centroid for each voxel, inside the body or not."""
        _, elements = cKDTree(self.mesh.centroids).query(self.centres.reshape(-1, 3))
        return elements.reshape(self.shape).astype(np.int64)

    @cached_property
    def inside(self) -> Bool[np.ndarray, "v v v"]:
        """Whether a voxel's centre is in the body.

        All voxels count as inside where a thin body contains no centre.
        """
        inside = (locate(self.mesh, self.centres.reshape(-1, 3)) >= 0).reshape(self.shape)
        return inside if inside.any() else np.ones(self.shape, dtype=bool)

    def fill(self, per_element: Float[np.ndarray, " m"]) -> Float[np.ndarray, "v v v"]:
        """Return the field with the value of the element of nearest centroid in each voxel."""
        if per_element.shape != (self.mesh.n_tets,):
            raise MeshError(
                f"a field of shape {per_element.shape} does not fit {self.mesh.n_tets} elements;"
                " give one value per element."
            )
        return per_element[self.nearest]

    def splat(self, nodal: Float[np.ndarray, "n c"]) -> Float[np.ndarray, "c v v v"]:
        """Distribute nodal values over the eight nearest voxels with trilinear weights.

        The sum of each component is conserved.
        """
        return (self._weights(self.mesh.points).T @ nodal).T.reshape(-1, *self.shape)

    def at_elements(self, values: Float[np.ndarray, "v v v"]) -> Float[np.ndarray, " m"]:
        """Interpolate a field on the voxels trilinearly at the elements' centroids."""
        return self.element_weights @ values.ravel()

    @cached_property
    def element_weights(self) -> sp.csr_matrix:
        """Trilinear weights of the voxels (v^3 columns) at the elements' centroids."""
        return self._weights(self.mesh.centroids)

    def _weights(self, points: Float[np.ndarray, "p 3"]) -> sp.csr_matrix:
        """Trilinear weights at points; beyond the centres of the outer voxels these count alone."""
        places = (points - self.mesh.bounds[0]) / self.size_mm - 0.5
        corner = np.floor(places).astype(np.int64)
        share, rows = places - corner, np.tile(np.arange(len(points)), 8)
        columns, weights = [], []
        for step in product((0, 1), repeat=3):
            voxel = np.clip(corner + step, 0, self.count - 1)
            columns.append(np.ravel_multi_index(tuple(voxel.T), self.shape))
            weights.append(np.prod(np.where(step, share, 1.0 - share), axis=1))
        entries = np.concatenate(weights), (rows, np.concatenate(columns))
        return sp.csr_matrix(entries, shape=(len(points), self.count**3))
