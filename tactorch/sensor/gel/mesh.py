"""The soft layer as tetrahedra, in the sensor's frame. Lengths in mm."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from tactorch.errors import ConfigError
from tactorch.mesh import TetMesh, box_mesh
from tactorch.mesh.values import Real, positive
from tactorch.sensor.description import GelLayer


@dataclass(frozen=True, eq=False)
class GelMesh:
    """A meshed gel.

    Attributes:
        mesh: Its tetrahedra; the outer face about z = 0, the window at z = -thickness.
        face: Nodes of the outer face.
        window: Nodes that are bonded to the rigid window.
    """

    mesh: TetMesh
    face: Int[np.ndarray, " k"]
    window: Int[np.ndarray, " w"]

    @property
    def face_points(self) -> Float[np.ndarray, "k 3"]:
        """Rest positions of the outer face's nodes, mm."""
        return self.mesh.points[self.face]


def gel_mesh(gel: GelLayer, edge_mm: Real = 1.0, layers: int = 4) -> GelMesh:
    """Mesh a gel with regular cells, thinner ones toward the outer face.

    Args:
        gel: The soft layer.
        edge_mm: Of a cell on the outer face.
        layers: Of cells through the thickness.

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
    if counts.prod() * layers > 200_000:
        raise ConfigError(f"edge_mm={edge:g} makes {counts.prod() * layers} cells; give a larger.")
    cube = box_mesh((2.0, 2.0, 1.0), (*counts.tolist(), layers), origin_mm=(-1.0, -1.0, -1.0))
    flat = cube.points[:, :2] * half if gel.size_mm is not None else _disc(cube.points[:, :2], half)
    depth = -cube.points[:, 2]  # 0 at the outer face, 1 at the window
    graded = depth * (0.5 + 0.5 * depth)  # the uppermost cells are about half as thick
    thickness, face = float(gel.thickness_mm), gel.height_mm(flat)
    height = face - graded * (thickness + face)
    mesh = TetMesh.create(np.column_stack([flat, height]), cube.tets)
    return GelMesh(mesh, np.flatnonzero(depth < 1e-9), np.flatnonzero(depth > 1 - 1e-9))


def _disc(square: Float[np.ndarray, "n 2"], half: Float[np.ndarray, "2"]) -> np.ndarray:
    """Map the square from -1 to 1 onto a disc: squares within stay squarish in its middle."""
    reach = np.abs(square).max(axis=1, keepdims=True)
    length = np.linalg.norm(square, axis=1, keepdims=True)
    ratio = np.divide(reach, length, out=np.ones_like(reach), where=length > 0)
    return square * (1 + reach * (ratio - 1)) * half
