"""A regular grid over a mesh: for images of its fields, and for networks. Lengths in mm."""

from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from jaxtyping import Bool, Float, Int

from tactorch.errors import ConfigError, MeshError
from tactorch.mesh.locate import locate
from tactorch.mesh.tetmesh import TetMesh


@dataclass(frozen=True, eq=False)
class VoxelGrid:
    """The bounding box of a mesh, cut into `count` voxels in each direction.

    Attributes:
        mesh: The body, m elements.
        count: Voxels in each direction.

    Raises:
        ConfigError: The count is below 1.
    """

    mesh: TetMesh
    count: int

    def __post_init__(self) -> None:
        if self.count < 1:
            raise ConfigError(f"voxels={self.count} must be at least 1.")

    @property
    def shape(self) -> tuple[int, int, int]:
        """Voxels along x, y and z."""
        return (self.count,) * 3

    @property
    def size_mm(self) -> Float[np.ndarray, "3"]:
        """Edges of a voxel, mm."""
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
        """Each voxel's element of nearest centroid, outside the body too."""
        from scipy.spatial import cKDTree

        _, found = cKDTree(self.mesh.centroids).query(self.centres.reshape(-1, 3))
        return found.reshape(self.shape).astype(np.int64)

    @cached_property
    def inside(self) -> Bool[np.ndarray, "v v v"]:
        """Whether a voxel's centre is in the body.

        Slivers of a body can slip between all centres; then all count as inside.
        """
        found = (locate(self.mesh, self.centres.reshape(-1, 3)) >= 0).reshape(self.shape)
        return found if found.any() else np.ones(self.shape, dtype=bool)

    def fill(self, per_element: Float[np.ndarray, " m"]) -> Float[np.ndarray, "v v v"]:
        """Give each voxel the value of the element whose centroid is nearest to its centre."""
        if per_element.shape != (self.mesh.n_tets,):
            raise MeshError(
                f"a field of shape {per_element.shape} is not over the {self.mesh.n_tets} elements."
            )
        return per_element[self.nearest]

    def splat(self, nodal: Float[np.ndarray, "n c"]) -> Float[np.ndarray, "c v v v"]:
        """Share each node's values out among the eight voxels around it; sums are kept."""
        places = (self.mesh.points - self.mesh.bounds[0]) / self.size_mm - 0.5
        corner = np.floor(places).astype(np.int64)
        share = places - corner
        out = np.zeros((self.count**3, nodal.shape[1]))
        for step in product((0, 1), repeat=3):
            at = np.clip(corner + step, 0, self.count - 1)
            weight = np.prod(np.where(np.array(step) == 1, share, 1.0 - share), axis=1)
            flat = (at[:, 0] * self.count + at[:, 1]) * self.count + at[:, 2]
            np.add.at(out, flat, weight[:, None] * nodal)
        return np.ascontiguousarray(out.T).reshape(nodal.shape[1], *self.shape)

    def at_elements(self, values: Float[np.ndarray, "v v v"]) -> Float[np.ndarray, " m"]:
        """Return a field on the voxels at the elements' centroids, linear between centres."""
        from scipy.ndimage import map_coordinates

        places = (self.mesh.centroids - self.mesh.bounds[0]) / self.size_mm - 0.5
        return map_coordinates(values, places.T, order=1, mode="nearest")
