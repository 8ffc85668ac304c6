"""A body from a labelled volume: its voxels, its surface, and its mesh with regions."""

from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage

from tactorch.errors import ConfigError, MeshError
from tactorch.mesh import TetMesh, tetrahedralize
from tactorch.mesh.geometry import bounding_diagonal
from tactorch.mesh.io import naming
from tactorch.mesh.quadrature import element_means
from tactorch.mesh.surfaces import TriangleSurface
from tactorch.mesh.values import Points
from tactorch.volumes.surface import extent, smooth_surface
from tactorch.volumes.volume import LabelVolume

#: Largest difference of the mesh's volume from that of the voxels, relative.
MAX_VOLUME_ERROR = 0.02
#: Size of the details that are smoothed, over the edge length of the mesh.
DETAIL = 0.25
#: Distance of the mesh from the smooth surface, over the edge length.
ENVELOPE = 0.04
_SAMPLES = 4  # along an edge of an element, for the majority of its labels
_ELEMENT_VOLUME = 0.118  # of a regular tetrahedron, over its edge cubed


@dataclass(frozen=True, eq=False)
class Body:
    """Voxels of one connected body.

    Attributes:
        volume: Labels; 0 outside the body.
        keep_largest: Whether parts that the smoothing of the surface detaches are left out.
    """

    volume: LabelVolume
    keep_largest: bool = False

    @cached_property
    def mask(self) -> Bool[np.ndarray, "i j k"]:
        """Whether a voxel is in the body."""
        return self.volume.labels != 0

    @property
    def volume_mm3(self) -> float:
        """Volume of the voxels, mm^3."""
        return float(self.mask.sum()) * self.volume.voxel_mm3

    @cached_property
    def diagonal_mm(self) -> float:
        """Diagonal of the box around the body, mm."""
        ends = ((first - 0.5, last + 0.5) for first, last in extent(self.mask))
        return bounding_diagonal(self.volume.positions(np.array(list(product(*ends)))))

    def surface(self, detail_mm: float = 0.0) -> TriangleSurface:
        """Return vertices (mm) and outward triangles of the smooth surface around the voxels.

        See `tactorch.volumes.surface.smooth_surface`.
        """
        with naming(self.volume.source):
            return smooth_surface(
                self.mask, self.volume.affine, detail_mm, keep_largest=self.keep_largest
            )

    def mesh(
        self,
        edge_length_mm: float | None = None,
        *,
        max_elements: int = 500_000,
        cache: bool = True,
    ) -> TetMesh:
        """Mesh the body with a region number for each element: the label of most of its points.

        Args:
            edge_length_mm: Target edge length, mm; by default a tenth of the body's diagonal.
                Details of the surface below a quarter of it are smoothed.
            max_elements: Limit of the expected number of elements.
            cache: Whether `tetrahedralize` looks up and stores its result.

        Raises:
            ConfigError: The edge length is below that of a voxel, or takes too many elements.
            MeshError: The surface cannot be meshed, or the mesh has another volume than the voxels.
        """
        length = self.check_edge_length(edge_length_mm, max_elements)
        epsilon = ENVELOPE * length / self.diagonal_mm
        surface = self.surface(DETAIL * length)
        mesh = tetrahedralize(*surface, length, epsilon=epsilon, cache=cache)
        self.check_volume(mesh)
        return mesh.with_regions(self.regions(mesh))

    def check_edge_length(self, edge_length_mm: float | None, max_elements: int) -> float:
        """Return the edge length of a mesh, mm; refuse one that is too small for the voxels."""
        length = 0.1 * self.diagonal_mm if edge_length_mm is None else edge_length_mm
        voxel, source = float(self.volume.voxel_mm.min()), self.volume.source
        if length < voxel:
            raise ConfigError(
                f"edge_length_mm={length:.4g} is below the voxels of '{source}', {voxel:.4g} mm; "
                "give a larger one: smaller elements show the voxels, not the body."
            )
        expected = self.volume_mm3 / (_ELEMENT_VOLUME * length**3)
        if expected > max_elements:
            raise ConfigError(
                f"edge_length_mm={length:.4g} would take about {expected:.2g} elements for "
                f"'{source}', more than {max_elements}; give about "
                f"{length * (expected / max_elements) ** (1 / 3):.2g} mm, or raise max_elements."
            )
        return length

    def check_volume(self, mesh: TetMesh) -> None:
        """Refuse a mesh whose volume is not that of the voxels.

        Raises:
            MeshError: The volumes differ by more than `MAX_VOLUME_ERROR`.
        """
        volume = float(mesh.volumes.sum())
        if abs(volume - self.volume_mm3) > MAX_VOLUME_ERROR * self.volume_mm3:
            raise MeshError(
                f"the mesh of '{self.volume.source}' has {volume:.4g} mm^3 and its voxels "
                f"{self.volume_mm3:.4g} mm^3, more than {MAX_VOLUME_ERROR:.0%} apart: parts are "
                "thinner than its elements. Choose a smaller edge length."
            )

    def regions(self, mesh: TetMesh) -> Int[np.ndarray, " m"]:
        """Return the label of most of the points of each element; the smallest of equally many."""
        numbers = self.volume.numbers
        if len(numbers) == 1:
            return np.full(mesh.n_tets, numbers[0])

        def share(number: int) -> Float[np.ndarray, " m"]:
            return element_means(mesh, lambda p: (self.labels_at(p) == number) * 1.0, _SAMPLES)

        return numbers[np.argmax([share(number) for number in numbers.tolist()], axis=0)]

    def labels_at(self, points: Points) -> Int[np.ndarray, " n"]:
        """Return the label at points (mm); outside the body that of its nearest voxel."""
        i, j, k = self.volume.indices(points).T
        return self.nearest[i, j, k]

    @cached_property
    def nearest(self) -> Int[np.ndarray, "i j k"]:
        """Label of the nearest voxel of the body."""
        place = ndimage.distance_transform_edt(
            ~self.mask, sampling=self.volume.voxel_mm, return_distances=False, return_indices=True
        )
        nearest: np.ndarray = self.volume.labels[tuple(place)]
        return nearest
