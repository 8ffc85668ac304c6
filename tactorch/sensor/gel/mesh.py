"""Tetrahedral mesh of the gel in the sensor frame, and loads on its outer face. Lengths in mm."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float, Int

from tactorch.errors import ConfigError
from tactorch.fem import SoftBody
from tactorch.mesh import TetMesh, box_mesh
from tactorch.mesh.values import Real, positive
from tactorch.sensor.description import GelLayer

_MAX_CELLS = 200_000


@dataclass(frozen=True, eq=False)
class GelMesh:
    """Mesh of a gel.

    Attributes:
        mesh: Tetrahedra; the outer face is near z = 0, the window at z = -thickness.
        face: Nodes of the outer face.
        window: Nodes bonded to the rigid window.
    """

    mesh: TetMesh
    face: Int[np.ndarray, " k"]
    window: Int[np.ndarray, " w"]

    @property
    def face_points(self) -> Float[np.ndarray, "k 3"]:
        """Rest positions of the nodes of the outer face, mm."""
        return self.mesh.points[self.face]

    @cached_property
    def _on_face(self) -> Bool[np.ndarray, " n"]:
        on_face = np.zeros(self.mesh.n_points, dtype=bool)
        on_face[self.face] = True
        return on_face

    @cached_property
    def face_triangles(self) -> Int[np.ndarray, "t 3"]:
        """Triangles of the outer face, as indices into `face`."""
        index = np.full(self.mesh.n_points, -1)
        index[self.face] = np.arange(len(self.face))
        triangles = self.mesh.surface.triangles
        return index[triangles[self._on_face[triangles].all(axis=1)]]

    @cached_property
    def face_areas(self) -> Float[np.ndarray, " k"]:
        """Area of each node of the face, a third of the adjacent triangles, mm^2."""
        surface = self.mesh.surface
        areas = surface.areas[self._on_face[surface.triangles].all(axis=1)]
        return np.bincount(
            self.face_triangles.ravel(), np.repeat(areas / 3.0, 3), minlength=len(self.face)
        )


def build_gel_mesh(gel: GelLayer, edge_mm: Real = 1.0, layers: int = 4) -> GelMesh:
    """Mesh a gel with regular cells that become thinner toward the outer face.

    Args:
        gel: Gel layer.
        edge_mm: Edge length of a cell on the outer face.
        layers: Number of cells through the thickness.

    Returns:
        The mesh.

    Raises:
        ConfigError: The cells are too large or too many.
    """
    edge = positive("edge_mm", edge_mm)
    half = np.array(gel.half_size_mm)
    counts = np.maximum(np.round(2 * half / edge).astype(int), 1)
    if counts.min() < 4 or layers < 1:
        raise ConfigError(
            f"edge_mm={edge:g}, layers={layers}: a gel of {2 * half[0]:g} x {2 * half[1]:g} mm"
            " needs at least 4 cells across and 1 layer."
        )
    if counts.prod() * layers > _MAX_CELLS:
        raise ConfigError(f"edge_mm={edge:g} makes {counts.prod() * layers} cells; give a larger.")
    cube = box_mesh((2.0, 2.0, 1.0), (*counts.tolist(), layers), origin_mm=(-1.0, -1.0, -1.0))
    square = cube.points[:, :2]
    flat = square * half if gel.size_mm is not None else _square_to_disc(square) * half
    depth = -cube.points[:, 2]  # 0 at the outer face, 1 at the window
    graded = depth * (0.5 + 0.5 * depth)  # the outermost cells are about half as thick
    thickness, face_height = float(gel.thickness_mm), gel.height_mm(flat)
    height = face_height - graded * (thickness + face_height)
    mesh = TetMesh.create(np.column_stack([flat, height]), cube.tets)
    return GelMesh(mesh, np.flatnonzero(depth < 1e-9), np.flatnonzero(depth > 1 - 1e-9))


def _square_to_disc(square: Float[np.ndarray, "n 2"]) -> np.ndarray:
    """Map the square from -1 to 1 to a disc; cells near the center stay nearly square."""
    largest = np.abs(square).max(axis=1, keepdims=True)
    length = np.linalg.norm(square, axis=1, keepdims=True)
    ratio = np.divide(largest, length, out=np.ones_like(largest), where=length > 0)
    return square * (1 + largest * (ratio - 1))


@dataclass(frozen=True, eq=False)
class FaceLoads:
    """Relation of forces on the nodes of the outer face to forces on all element nodes.

    Attributes:
        gel: Mesh of the gel.
        body: Finite element model on that mesh.
    """

    gel: GelMesh
    body: SoftBody

    @cached_property
    def load_matrix(self) -> sp.csc_matrix:
        """Forces on all element nodes from those on the nodes of the face, (nodes, k).

        On quadratic elements a nodal force is distributed as a traction around the node: a point
        force would have an unbounded displacement as the mesh is refined.
        """
        indicator = np.zeros(self.gel.mesh.points.shape)
        indicator[self.gel.face] = 1.0
        matrix = self.body.discretisation.consistent_load_matrix(indicator)
        return matrix.tocsc()[:, self.gel.face]

    def edges(self, loaded: Bool[np.ndarray, " k"]) -> Int[np.ndarray, "e 2"]:
        """Pairs of neighbors among the loaded nodes, as indices among these."""
        index = np.full(len(loaded), -1)
        index[loaded] = np.arange(int(loaded.sum()))
        pairs = index[self.gel.face_triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)]
        return np.unique(np.sort(pairs[(pairs >= 0).all(axis=1)], axis=1), axis=0)

    def unit_loads(self, loaded: Bool[np.ndarray, " k"]) -> Float[np.ndarray, "size f"]:
        """Loads on all degrees of freedom for a unit force on each loaded node and axis."""
        shares = self.load_matrix[:, loaded].toarray()
        loads = np.zeros((len(shares), 3, shares.shape[1], 3))
        for axis in range(3):
            loads[:, axis, :, axis] = shares
        return np.asfortranarray(loads.reshape(3 * len(shares), -1))

    def gather(self, forces: Float[np.ndarray, "nodes 3"]) -> Float[np.ndarray, "k 3"]:
        """Forces on the face from those on all element nodes; midside nodes go to both ends."""
        n = self.gel.mesh.n_points
        gathered = forces[:n].copy()
        if len(forces) > n:
            edges = self.body.discretisation.edges
            on_face = self.gel._on_face[edges].all(axis=1)
            for end in (0, 1):
                np.add.at(gathered, edges[on_face, end], 0.5 * forces[n:][on_face])
        return gathered[self.gel.face]
