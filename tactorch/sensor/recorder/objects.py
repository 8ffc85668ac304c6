"""Object under the sensor: a box, a mesh file, or a virtual cube for an unknown shape."""

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
from jaxtyping import Float

from tactorch.config import Options, Registry, option
from tactorch.errors import ConfigError
from tactorch.mesh import TetMesh, box_mesh, read_mesh
from tactorch.sensor.poses import Pose, check_pose, transform_points

_MAX_ELEMENTS = 200_000

#: Objects by name.
OBJECTS = Registry(
    "object",
    {
        "box": "tactorch.sensor.recorder.objects:BoxObject",
        "mesh": "tactorch.sensor.recorder.objects:MeshObject",
        "virtual_cube": "tactorch.sensor.recorder.objects:VirtualCube",
    },
)


@dataclass(frozen=True)
class BoxObject(Options):
    """Box of known size."""

    section: ClassVar[str] = "object"
    size_mm: tuple[float, float, float] = option(
        (10.0, 10.0, 10.0), "Edge lengths", unit="mm", gt=0
    )
    origin_mm: tuple[float, float, float] = option(
        (0.0, 0.0, 0.0), "Corner of smallest coordinates in the object frame", unit="mm"
    )
    edge_mm: float = option(1.25, "Edge length of the elements", unit="mm", gt=0)

    def mesh(self) -> TetMesh:
        """Return the mesh in the object frame, mm."""
        if min(self.size_mm) < self.edge_mm:
            raise ConfigError(
                f"object.edge_mm={self.edge_mm:g} must be no more than a side of the box."
            )
        counts = [max(1, round(size / self.edge_mm)) for size in self.size_mm]
        return box_mesh(self.size_mm, counts, origin_mm=self.origin_mm, tets_per_cell=5)


@dataclass(frozen=True)
class MeshObject(Options):
    """Object of known shape, from a tetrahedral mesh file."""

    section: ClassVar[str] = "object"
    path: Path = option(
        help="Mesh file of tetrahedra: .msh (gmsh), .vtu or .inp (Abaqus, CalculiX)"
    )
    unit: Literal["mm", "cm", "m"] = option("mm", "Unit of length of the file")

    def mesh(self) -> TetMesh:
        """Return the mesh in the object frame, mm."""
        return read_mesh(str(self.path), self.unit)


@dataclass(frozen=True)
class VirtualCube(Options):
    """Cuboid under the first contact, for an object of unknown shape (end of Section VI-C).

    The reconstruction assigns the empty parts of the cuboid a very low modulus.
    """

    section: ClassVar[str] = "object"
    side_mm: float = option(
        10.0, "Side of the pressed face, across the sensor's z axis", unit="mm", gt=0
    )
    depth_mm: float | None = option(
        None, "Extent along the sensor's z axis; null for the side", unit="mm", gt=0
    )
    edge_mm: float = option(1.0, "Edge length of the elements", unit="mm", gt=0)

    def __post_init__(self) -> None:
        super().__post_init__()
        edge, sizes = self.edge_mm, np.array(self._sizes_mm)
        if 2 * edge > sizes.min():
            raise ConfigError(
                f"object.edge_mm={edge:g} is more than half the region of {self.side_mm:g} mm; give"
                " a smaller one."
            )
        count = 6 * float(np.prod(sizes / edge))
        if count > _MAX_ELEMENTS:
            raise ConfigError(
                f"object.edge_mm={edge:g} makes {count:.0f} elements; give a larger one."
            )

    @property
    def _sizes_mm(self) -> tuple[float, float, float]:
        depth = self.side_mm if self.depth_mm is None else self.depth_mm
        return self.side_mm, self.side_mm, depth

    def mesh_under(self, first_pose: Pose, center_mm: Float[np.ndarray, "2"]) -> TetMesh:
        """Return the mesh in the object frame, its pressed face at the gel's highest point.

        `center_mm` is the center of the contact, x and y in the sensor frame.
        """
        check_pose(first_pose, "pose of first contact")
        counts = [max(2, round(size / self.edge_mm)) for size in self._sizes_mm]
        x, y = (center_mm - self.side_mm / 2).tolist()
        # Five tetrahedra per cell, mirrored from cell to cell, favor no direction.
        mesh = box_mesh(self._sizes_mm, counts, origin_mm=(x, y, 0.0), tets_per_cell=5)
        return TetMesh.create(transform_points(first_pose, mesh.points), mesh.tets)
