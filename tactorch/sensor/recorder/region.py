"""A virtual cube where an object's shape is not known (end of Section VI-C).

The region of interest under the contact is taken to be a cuboid. What of it is empty then comes out
as soft as can be.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError
from tactorch.mesh import TetMesh, box_mesh
from tactorch.mesh.values import Real, positive
from tactorch.sensor.contact import check_pose, moved

_MOST = 200_000  # elements


@dataclass(frozen=True)
class VirtualCube:
    """A cuboid under the first contact.

    Attributes:
        side_mm: Of its pressed face, which lies across the sensor's z axis.
        depth_mm: Along it; None for the side's length.
        edge_mm: Of its elements.

    Raises:
        ConfigError: A value cannot be used.
    """

    side_mm: Real = 10.0
    depth_mm: Real | None = None
    edge_mm: Real = 1.0

    def __post_init__(self) -> None:
        side, edge = positive("side_mm", self.side_mm), positive("edge_mm", self.edge_mm)
        depth = side if self.depth_mm is None else positive("depth_mm", self.depth_mm)
        if 2 * edge > min(side, depth):
            raise ConfigError(f"edge_mm={edge:g} is more than half the region of {side:g} mm.")
        count = 6 * (side / edge) ** 2 * (depth / edge)
        if count > _MOST:
            raise ConfigError(f"edge_mm={edge:g} makes {count:.0f} elements; give a larger one.")

    def under(self, first: Float[np.ndarray, "4 4"], middle_mm: Float[np.ndarray, "2"]) -> TetMesh:
        """Mesh the region.

        Args:
            first: T_object_sensor when the gel first touched.
            middle_mm: Middle of what was touched, x and y in the sensor's frame.

        Returns:
            The mesh in the object's frame, its pressed face where the gel's highest point was.

        Raises:
            ConfigError: The pose is none.
        """
        check_pose(first, "pose of first touch")
        side = float(self.side_mm)
        depth = side if self.depth_mm is None else float(self.depth_mm)
        sizes = (side, side, depth)
        counts = [max(2, round(size / float(self.edge_mm))) for size in sizes]
        corner = (float(middle_mm[0]) - side / 2, float(middle_mm[1]) - side / 2, 0.0)
        # Mirrored elements, which favour no direction.
        mesh = box_mesh(sizes, counts, origin_mm=corner, tets_per_cell=5)
        return TetMesh.create(moved(first, mesh.points), mesh.tets)
