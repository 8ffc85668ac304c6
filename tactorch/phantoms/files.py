"""Phantoms whose body is read from a file: a surface, a mesh, or the voxels of labelled volumes."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float
from scipy import ndimage

from tactorch.config import Options, option
from tactorch.errors import ConfigError
from tactorch.mesh import BodyFile, Shape, TetMesh, tetrahedralize
from tactorch.mesh.geometry import bounding_box
from tactorch.mesh.shapes import Distances
from tactorch.mesh.surfaces import TriangleSurface
from tactorch.mesh.values import Corners, Points, Real
from tactorch.phantoms.phantom import Phantom
from tactorch.volumes import Body, BodySettings, read_body

# Of meshes about the surface, over the diagonal: flat sides remain within the tolerance at which
# presses find them.
_ENVELOPE = 2e-3


@dataclass(frozen=True, kw_only=True)
class FilePhantom(Options):
    """Body of a surface (.stl, .obj, .ply) or mesh file, with inclusions of simple shapes."""

    section = "phantom"
    file: Path | None = option(None, "Closed surface or mesh of the body; required")
    unit: Literal["mm", "cm", "m"] = option("mm", "Length unit of the file")
    youngs_mpa: float = option(0.2, "Young's modulus of the body", unit="MPa", gt=0)
    inclusions: tuple[Mapping[str, Any], ...] = option(
        (), "Shapes with their moduli, such as "
        "{shape: sphere, center_mm: [0, 0, 8], radius_mm: 3, youngs_mpa: 1}",
    )  # fmt: skip

    def build(self) -> Phantom:
        """Return the phantom.

        Raises:
            ConfigError: There is no file, or an inclusion is not valid.
            FileError: The file cannot be read.
            MeshError: The surface does not bound one body.
        """
        if self.file is None:
            raise ConfigError("phantom.file is required: the surface or mesh of the body.")
        body = BodyFile(str(self.file), self.unit)
        entries = {"shape": "bodyfile", "path": body.path, "unit": body.unit}
        return Phantom.from_config(
            {"body": entries, "youngs_mpa": self.youngs_mpa, "inclusions": list(self.inclusions)}
        )


@dataclass(frozen=True, eq=False)
class VoxelShape(Shape):
    """Smooth body around voxels."""

    voxels: Body

    def signed_distance(self, points: Points) -> Distances:
        """Return the distance of each point (n, 3) to the voxels' surface, mm, within a voxel."""
        indices = self.voxels.volume.coordinates(points) + 1.0  # one for the padding
        return np.asarray(
            ndimage.map_coordinates(self._distances, indices.T, order=1, mode="nearest")
        )

    def bounds(self) -> Corners:
        """Return the lowest and the highest corner of the smooth surface, mm."""
        return bounding_box(self._surface[0])

    def surface(self, segments: int = 48) -> TriangleSurface:
        """Return vertices (mm) and outward triangles; see `tactorch.volumes.Body.surface`."""
        return self._surface

    @cached_property
    def _surface(self) -> TriangleSurface:
        return self.voxels.surface()

    @cached_property
    def _distances(self) -> Float[np.ndarray, "a b c"]:
        """Signed distance at the centres of the voxels and a layer around them, mm."""
        mask, sizes = np.pad(self.voxels.mask, 1), self.voxels.volume.voxel_mm
        half = 0.5 * float(sizes.min())
        outside = ndimage.distance_transform_edt(~mask, sampling=sizes)
        inside = ndimage.distance_transform_edt(mask, sampling=sizes)
        return np.where(mask, half - inside, outside - half)


@dataclass(frozen=True, eq=False)
class RegionModuli:
    """Young's modulus of the label at a point."""

    voxels: Body
    moduli_mpa: dict[int, float]

    def __post_init__(self) -> None:
        volume = self.voxels.volume
        for number in volume.numbers.tolist():
            if number not in self.moduli_mpa:
                names = ", ".join(map(volume.name, volume.numbers.tolist()))
                raise ConfigError(
                    f"region_mpa has no modulus for label {number}; give one for each of {names}."
                )

    def at(self, points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        """Return Young's modulus at points (mm), MPa."""
        numbers = self.voxels.volume.numbers
        moduli = np.array([self.moduli_mpa[number] for number in numbers.tolist()])
        return moduli[np.searchsorted(numbers, self.voxels.labels_at(points))]


@dataclass(frozen=True)
class VolumePhantom(Phantom):
    """Phantom from the voxels of a labelled volume; its meshes have regions."""

    config: dict[str, Any] = field(default_factory=dict)  # for the provenance of recordings

    def __post_init__(self) -> None:
        if self.inclusions or not isinstance(self.body, VoxelShape):
            raise ConfigError("a phantom from a volume has a voxel shape, and no other inclusions.")

    def mesh(self, edge_length_mm: Real | None = None, **options: Any) -> TetMesh:
        """Mesh the body with the label of each element as its region; see `Phantom.mesh`.

        Element faces do not conform to the boundaries of labels.

        Raises:
            ConfigError: The generator is "structured", or `conforming` is true.
            MeshError: The mesh has another volume than the voxels.
        """
        if options.pop("generator", "auto") == "structured" or options.pop("conforming", False):
            raise ConfigError("a body of voxels has no structured and no conforming mesh.")
        assert isinstance(self.body, VoxelShape)
        mesh = tetrahedralize(*self.body.surface(), edge_length_mm, epsilon=_ENVELOPE, **options)
        self.body.voxels.check_volume(mesh)
        return mesh.with_regions(self.body.voxels.regions(mesh))

    def to_config(self) -> dict[str, Any]:
        """Return the file, the labels and the moduli as plain values."""
        return self.config


@dataclass(frozen=True, kw_only=True)
class Labelled(BodySettings):
    """Body of a labelled volume, such as a segmentation, with one modulus for each label."""

    section = "phantom"
    volume: Path = option(help="NIfTI, DICOM segmentation, .npz or .npy with a label per voxel")
    region_mpa: dict[int, float] = option(help="Young's modulus of each label", unit="MPa", gt=0)

    def build(self) -> Phantom:
        """Return the phantom.

        Raises:
            ConfigError: A label has no modulus, see also `tactorch.volumes.read_body`.
            FileError: See `tactorch.volumes.read_body`.
        """
        body = read_body(self.volume, self)
        config = {
            "volume": self.volume.name,
            "labels": body.volume.numbers.tolist(),
            "region_mpa": {str(number): e for number, e in self.region_mpa.items()},
        }
        return VolumePhantom(
            VoxelShape(body), (), RegionModuli(body, dict(self.region_mpa)), config=config
        )
