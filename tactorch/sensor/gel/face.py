"""Mesh of a gel with small elements at the edge of a contact."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.linalg import eigh
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial.distance import cdist

from tactorch.mesh import TetMesh
from tactorch.mesh.geometry import vertex_areas, without_flat_elements
from tactorch.mesh.refine import Sizing
from tactorch.mesh.topology import triangle_edges
from tactorch.sensor.description import GelLayer
from tactorch.sensor.gel.model import GelMesh, face_triangles

_GROWTH = 0.7  # of the edge length with the distance from the edge of the contact
# Step of differences of the distance, and distance of points on the edge, over the edge length.
_STEP, _ON_EDGE = 0.03, 0.05
_EDGE_LAYER, _LAYER = 1.0, 0.05  # deviation of a layer at the edge, and its width
_LENGTH = 0.5  # of the covariance of the displacement, over the size of the contact

#: Distance of points of the face at rest (n, 2) from the edge of the contact, mm; positive inside.
EdgeDistance = Callable[[Float[np.ndarray, "n 2"]], Float[np.ndarray, " n"]]


class GelFace:
    """Mesh of a gel and the nodes of its outer face and window.

    Attributes:
        mesh: Mesh, mm.
        nodes: Nodes of the outer face, (k,).
        window: Nodes bonded to the window.
        points: Rest positions of the nodes of the face, (k, 3), mm.
        triangles: Triangles of the face, as indices among its nodes, (t, 3).
        touching: Nodes of the face in contact, (k,).
        inside_mm: Distance of the nodes of the face from the edge of the contact, (k,), mm;
            negative outside.
    """

    def __init__(
        self,
        mesh: TetMesh,
        on_face: Bool[np.ndarray, " n"],
        on_window: Bool[np.ndarray, " n"],
        touching: Bool[np.ndarray, " n"],
        distance: EdgeDistance,
    ) -> None:
        self.mesh = mesh
        self.nodes, self.window = np.flatnonzero(on_face), np.flatnonzero(on_window)
        self.points = mesh.points[self.nodes]
        self.inside_mm = distance(self.points[:, :2])
        self.triangles = face_triangles(mesh, on_face)
        inside = touching[self.nodes][self.triangles].all(axis=1)
        self.touching = np.zeros(len(self.nodes), dtype=bool)
        self.touching[self.triangles[inside]] = True
        self._contact_triangles = (np.cumsum(self.touching) - 1)[self.triangles[inside]]

    @staticmethod
    def refined(coarse: GelMesh, distance: EdgeDistance, edge_mm: float) -> "GelFace":
        """Bisect elements near the edge of a contact, and move nodes of the face onto it.

        `edge_mm` is the longest edge of elements at the edge of the contact.
        """
        gel = coarse.layer
        fine = coarse.refined(edge_sizing(distance, edge_mm, gel))
        on_face, half = fine.on_face, np.array(gel.half_size_mm)
        points, tets = fine.mesh.points.copy(), fine.mesh.tets
        flat, triangles = points[on_face, :2], fine.face_triangles
        moved = _onto_edge(flat, triangles, distance, _STEP * edge_mm, half)
        target = points.copy()
        target[on_face] = np.column_stack([moved, gel.height_mm(moved)])
        points = without_flat_elements(points, target, tets)
        touching = np.zeros(len(points), dtype=bool)
        touching[on_face] = distance(points[on_face, :2]) >= -_ON_EDGE * edge_mm
        return GelFace(TetMesh.create(points, tets), on_face, fine.on_window, touching, distance)

    @property
    def contact(self) -> Int[np.ndarray, " c"]:
        """Nodes of the mesh in contact."""
        return self.nodes[self.touching]

    def smooth_modes(self, count: int) -> tuple[Float[np.ndarray, "c u"], Float[np.ndarray, "c r"]]:
        """Return linear functions over the contact, and smooth ones of unit prior deviation.

        Each part of the contact has separate linear functions. The others are the principal
        functions of a Gaussian process with a Matern covariance of smoothness 3/2 (Rasmussen and
        Williams, Gaussian Processes for Machine Learning, 2006, sec. 4.2), whose length is half
        that of a square of the area of the contact. At the edge of a soft object, where the
        traction is singular, the displacement changes within a short distance: its variance
        increases toward the edge, to twice that inside. `count` is the number of principal
        functions.
        """
        flat = self.points[self.touching, :2]
        areas, part = self._contact_areas(flat), self._parts()
        linear = []
        for k in range(int(part.max()) + 1):
            own = (part == k).astype(float)
            offset = (flat - flat[part == k].mean(axis=0)) * own[:, None]
            linear += [own, *(offset / max(float(np.abs(offset).max()), 1e-9)).T]
        apart = np.sqrt(3.0) * cdist(flat, flat) / (_LENGTH * np.sqrt(areas.sum()))
        covariance, roots = (1.0 + apart) * np.exp(-apart), np.sqrt(areas)
        inside = np.maximum(self.inside_mm[self.touching], 0.0)
        layer = _EDGE_LAYER * np.exp(-inside / (_LAYER * np.sqrt(areas.sum())))
        covariance *= 1.0 + layer[:, None] * layer
        n, last = len(flat), min(count, len(flat))
        values, vectors = eigh(
            covariance * roots[:, None] * roots, subset_by_index=[n - last, n - 1]
        )
        return np.column_stack(linear), vectors / roots[:, None] * np.sqrt(np.maximum(values, 0.0))

    def _contact_areas(self, flat: Float[np.ndarray, "c 2"]) -> Float[np.ndarray, " c"]:
        """Areas of the nodes in contact, mm^2."""
        return vertex_areas(np.pad(flat, ((0, 0), (0, 1))), self._contact_triangles)

    def _parts(self) -> Int[np.ndarray, " c"]:
        """Part of the contact of each of its nodes."""
        first = self._contact_triangles.ravel()
        second = np.roll(self._contact_triangles, -1, axis=1).ravel()
        n = int(self.touching.sum())
        graph = coo_matrix((np.ones(len(first)), (first, second)), shape=(n, n))
        _, part = connected_components(graph, directed=False)
        return part


def edge_sizing(distance: EdgeDistance, edge_mm: float, gel: GelLayer) -> Sizing:
    """Return longest edges of elements that grow with the distance from the contact's edge."""

    def sizing(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        below = gel.height_mm(points[:, :2]) - points[:, 2]
        return np.maximum(_GROWTH * np.hypot(distance(points[:, :2]), below), edge_mm)

    return sizing


def _onto_edge(
    points: Float[np.ndarray, "k 2"],
    triangles: Int[np.ndarray, "t 3"],
    distance: EdgeDistance,
    step_mm: float,
    half_size_mm: Float[np.ndarray, "2"],
) -> Float[np.ndarray, "k 2"]:
    """Move points onto the edge of the contact so that it crosses no edge of the mesh.

    Points on the border of the face remain. An edge of the contact that cuts through elements would
    change the force by some per cent.
    """
    away = distance(points)
    slopes = [
        (distance(points + e) - distance(points - e)) / (2.0 * step_mm) for e in step_mm * np.eye(2)
    ]
    gradient = np.stack(slopes, axis=1)
    square = (gradient**2).sum(axis=1)
    inner = (np.abs(points) < half_size_mm * (1.0 - 1e-6)).all(axis=1)
    chosen = _closest_to_edge(np.where(inner & (square > 0.25), away, np.inf), away, triangles)
    moved = points.copy()
    moved[chosen] -= (away / np.maximum(square, 0.25))[chosen, None] * gradient[chosen]
    return moved


def _closest_to_edge(
    movable: Float[np.ndarray, " k"],
    away: Float[np.ndarray, " k"],
    triangles: Int[np.ndarray, "t 3"],
) -> Bool[np.ndarray, " k"]:
    """Return the points to be moved onto the edge of the contact: the closest ones, one by one.

    Of the three points of a triangle, which would become flat, one remains. `movable` are the
    distances of points that may move, infinite for others.
    """
    edges = np.unique(triangle_edges(triangles), axis=0)
    crossed = edges[away[edges[:, 0]] * away[edges[:, 1]] < 0.0]
    neighbors: dict[int, list[int]] = {}
    for first, second in crossed.tolist():
        neighbors.setdefault(first, []).append(second)
        neighbors.setdefault(second, []).append(first)
    others: dict[int, list[list[int]]] = {point: [] for point in neighbors}
    for corners in triangles.tolist():
        for point in others.keys() & set(corners):
            others[point].append([corner for corner in corners if corner != point])
    chosen = np.zeros(len(away), dtype=bool)
    for point in sorted(neighbors, key=lambda k: abs(float(movable[k]))):
        if np.isinf(movable[point]) or chosen[neighbors[point]].all():
            continue
        chosen[point] = not any(chosen[pair].all() for pair in others[point])
    return chosen
