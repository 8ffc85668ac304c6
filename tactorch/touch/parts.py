"""Two bodies as one mesh of two parts that share no node."""

import numpy as np

from tactorch.mesh import TetMesh
from tactorch.mesh.geometry import frozen
from tactorch.mesh.values import Points, Tets


class PartsMesh(TetMesh):
    """Mesh of parts that are valid meshes each; other meshes are of one part."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", frozen(self.points))
        object.__setattr__(self, "tets", frozen(self.tets))

    @staticmethod
    def of(points: Points, tets: Tets, second: TetMesh) -> "PartsMesh":
        """Return the mesh of a first part (mm), which may be moved, and a second one."""
        cells = np.concatenate([tets, second.tets + len(points)])
        return PartsMesh(np.concatenate([points, second.points]), cells)
