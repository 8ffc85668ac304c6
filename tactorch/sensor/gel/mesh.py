"""Tetrahedral mesh of the gel in the sensor frame. Lengths in mm."""

import numpy as np
from jaxtyping import Bool, Float, Int

from tactorch.errors import ConfigError
from tactorch.mesh import TetMesh, box_mesh
from tactorch.mesh.values import Real, positive
from tactorch.sensor.description import GelLayer

_MAX_CELLS = 200_000


class GelMesh:
    """Regular tetrahedra that become thinner toward the outer face near z = 0.

    `edge_mm` is the edge length of a cell on this face, `layers` the number of cells through the
    thickness. The nodes `window` at z = -thickness are bonded to the rigid window.
    """

    def __init__(self, gel: GelLayer, edge_mm: Real, layers: int) -> None:
        edge, half = positive("edge_mm", edge_mm), np.array(gel.half_size_mm)
        counts = np.maximum(np.round(2 * half / edge).astype(int), 1)
        if counts.min() < 4 or layers < 1:
            raise ConfigError(
                f"edge_mm={edge:g}, layers={layers}: a gel of {2 * half[0]:g} x {2 * half[1]:g} mm"
                " needs at least 4 cells across and 1 layer."
            )
        if counts.prod() * layers > _MAX_CELLS:
            raise ConfigError(
                f"edge_mm={edge:g} makes {counts.prod() * layers} cells; give a larger."
            )
        cube = box_mesh((2.0, 2.0, 1.0), (*counts.tolist(), layers), origin_mm=(-1.0, -1.0, -1.0))
        square = cube.points[:, :2]
        flat = square * half if gel.size_mm is not None else _square_to_disc(square) * half
        depth = -cube.points[:, 2]  # 0 at the outer face, 1 at the window
        graded = depth * (0.5 + 0.5 * depth)  # the outermost cells are about half as thick
        face_height = gel.height_mm(flat)
        height = face_height - graded * (gel.thickness_mm + face_height)
        self.mesh = TetMesh.create(np.column_stack([flat, height]), cube.tets)
        self.on_face = depth < 1e-9
        self.face, self.window = np.flatnonzero(self.on_face), np.flatnonzero(depth > 1 - 1e-9)
        self.face_points = self.mesh.points[self.face]  # at rest
        surface = self.mesh.surface
        outer = self.on_face[surface.triangles].all(axis=1)
        self.face_triangles = (np.cumsum(self.on_face) - 1)[surface.triangles[outer]]
        shares = np.repeat(surface.areas[outer] / 3.0, 3)  # of the adjacent triangles, mm^2
        self.face_areas = np.bincount(self.face_triangles.ravel(), shares, len(self.face))

    def edges(self, selected: Bool[np.ndarray, " k"]) -> Int[np.ndarray, "e 2"]:
        """Return pairs of neighbors among selected nodes of the face, as indices among these."""
        index = np.where(selected, np.cumsum(selected) - 1, -1)
        pairs = index[self.face_triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)]
        return np.unique(np.sort(pairs[(pairs >= 0).all(axis=1)], axis=1), axis=0)


def _square_to_disc(square: Float[np.ndarray, "n 2"]) -> np.ndarray:
    """Map the square from -1 to 1 to a disc; cells near the center stay nearly square."""
    largest = np.abs(square).max(axis=1, keepdims=True)
    length = np.linalg.norm(square, axis=1, keepdims=True)
    ratio = np.divide(largest, length, out=np.ones_like(largest), where=length > 0)
    return square * (1 + largest * (ratio - 1))
