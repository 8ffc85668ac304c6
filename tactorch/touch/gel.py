"""The gel of a sensor as a part of a coupled mesh."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Int

from tactorch.mesh import TetMesh
from tactorch.sensor.description import GelLayer
from tactorch.sensor.gel import GelMesh

_CENTER = 0.6  # edge length of cells at the center of the face, over the mean


@dataclass(frozen=True, eq=False)
class GelPart:
    """Mesh of a gel with smaller cells at the center.

    Attributes:
        layer: The gel.
        mesh: Mesh in the sensor frame, mm.
        face: Nodes of the outer face.
        window: Nodes that are bonded to the window.
    """

    layer: GelLayer
    mesh: TetMesh
    face: Int[np.ndarray, " k"]
    window: Int[np.ndarray, " w"]

    @staticmethod
    @lru_cache(maxsize=4)
    def of(gel: GelLayer, edge_mm: float, layers: int) -> "GelPart":
        """Mesh a gel with cells of a mean edge length (mm) on its face.

        Raises:
            ConfigError: There are too few cells across the gel, or too many.
        """
        regular = GelMesh(gel, edge_mm, layers)
        points, half = regular.mesh.points.copy(), np.array(gel.half_size_mm)
        height = gel.height_mm(points[:, :2])
        depth = (height - points[:, 2]) / (height + gel.thickness_mm)  # 0 at the face, 1 below
        outward = (points[:, :2] / half) ** 2
        if gel.size_mm is None:
            outward = outward.sum(axis=1, keepdims=True)
        points[:, :2] *= _CENTER + (1.0 - _CENTER) * outward
        height = gel.height_mm(points[:, :2])
        points[:, 2] = height - depth * (height + gel.thickness_mm)
        return GelPart(gel, TetMesh(points, regular.mesh.tets), regular.face, regular.window)
