"""What a mesh is asked for besides its elements: its surface, and its elements' neighbours."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int


@dataclass(frozen=True, eq=False)
class Surface:
    """The boundary of a `TetMesh`, ordered by owner. Arrays are read-only.

    Attributes:
        triangles: Node indices of the mesh, counter-clockwise from outside.
        normals: Unit outward normals.
        areas: Areas, mm^2.
        owners: The tetrahedron behind each triangle.
    """

    triangles: Int[np.ndarray, "k 3"]
    normals: Float[np.ndarray, "k 3"]
    areas: Float[np.ndarray, " k"]
    owners: Int[np.ndarray, " k"]

    def nodes(self) -> Int[np.ndarray, " s"]:
        """Return the nodes on the boundary, ascending, each once."""
        return np.unique(self.triangles)


@dataclass(frozen=True, eq=False)
class Adjacency:
    """Pairs of tetrahedra that share a face, sorted. Arrays are read-only.

    Attributes:
        pairs: Element indices (i, j) with i < j.
        areas: Area of the shared face, mm^2.
        distances: Distance between the two centroids, mm.
    """

    pairs: Int[np.ndarray, "f 2"]
    areas: Float[np.ndarray, " f"]
    distances: Float[np.ndarray, " f"]
