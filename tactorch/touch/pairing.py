"""Points of the gel's face and the points of a body that are opposite to them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from tactorch.fem import ELEMENTS
from tactorch.fem.contact.contact import TRIANGLE_POINTS, TRIANGLE_WEIGHTS
from tactorch.fem.contact.pair import CoupledDiscretisation, Pairs
from tactorch.fem.elements import Discretisation
from tactorch.mesh import Shape, TetMesh
from tactorch.mesh.geometry import frozen
from tactorch.sensor.gel import GelMesh
from tactorch.sensor.poses import Pose, transform_points
from tactorch.touch.rays import first_hits, surface_heights

#: Element of gel and body: linear ones of an almost incompressible gel are too stiff.
ELEMENT = "tet10"
# Of the sides of triangles of the gel's face. With one, the area of a contact that ends within
# triangles was off by some per cent.
_DIVISIONS = 3


class PartsMesh(TetMesh):
    """Mesh of two parts that share no node and are valid meshes each; others are of one part."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", frozen(self.points))
        object.__setattr__(self, "tets", frozen(self.tets))


@dataclass(frozen=True, eq=False)
class Facing:
    """A gel and a body in front of it; p pairs of points.

    Attributes:
        mesh: The body, then the gel, in the sensor frame, mm.
        points: Points of the gel's face at rest, (p, 3), mm.
        gaps_mm: Distance of the surface of the shape from each along z, in the pose.
        areas_mm2: Area of the gel's face that each point stands for.
        nodes: Nodes of body and gel from which both points of each pair are interpolated.
        values: Their shape functions, negative for the gel.
        faces: Triangle of the body's surface of each pair, among those of the body's mesh.
        barycentric: Place in this triangle.
        others: Points of the gel's face at rest without one opposite to them, (r, 3), mm.
    """

    mesh: PartsMesh
    points: Float[np.ndarray, "p 3"]
    gaps_mm: Float[np.ndarray, " p"]
    areas_mm2: Float[np.ndarray, " p"]
    nodes: Int[np.ndarray, "p k"]
    values: Float[np.ndarray, "p k"]
    faces: Int[np.ndarray, " p"]
    barycentric: Float[np.ndarray, "p 3"]
    others: Float[np.ndarray, "r 3"]

    @property
    def first_touch(self) -> tuple[Float[np.ndarray, "2"], float]:
        """Position (x, y) of the first touch, and the motion along z until then, mm."""
        first = int(self.gaps_mm.argmin())
        return self.points[first, :2], float(self.gaps_mm[first])

    def pairs(self, reach_mm: float) -> tuple[Pairs, Bool[np.ndarray, " p"]]:
        """Return pairs of up to this distance from each other at first touch, and which they are.

        Gaps are those at first touch.
        """
        gaps = self.gaps_mm - self.gaps_mm.min()
        near = gaps <= reach_mm
        coupled = CoupledDiscretisation(self.mesh, ELEMENTS[ELEMENT], self.nodes[near])
        arrays = self.values[near], gaps[near], self.areas_mm2[near], self.points[near]
        return Pairs(coupled, *arrays), near


def face_each_other(
    body: TetMesh,
    shape: Shape | TetMesh,
    gel: GelMesh,
    pose: Pose,
    divisions: int = _DIVISIONS,
) -> Facing | None:
    """Pair the points of a gel with those of a body opposite to them; None where there are none.

    Distances are those of the shape itself, whose surface the mesh of the body follows within its
    elements, or of the curved surface through the nodes of a mesh. Triangles of the gel's face have
    six points in each part into which `divisions` of their sides divide them: the more there are,
    the better the area of a contact that ends within triangles is known.
    """
    moved = transform_points(np.linalg.inv(pose), body.points)
    face, shift = gel.mesh.surface, body.n_points
    cells = np.concatenate([body.tets, gel.mesh.tets + shift])
    mesh = PartsMesh(np.concatenate([moved, gel.mesh.points]), cells)
    outer = gel.on_face[face.triangles].all(axis=1)
    triangles, areas = face.triangles[outer], face.areas[outer]
    rule, weights = _divided(divisions)
    count = len(rule)
    points = np.einsum("pc,tcd->tpd", rule, gel.mesh.points[triangles]).reshape(-1, 3)
    # Elements have straight sides; the gaps are those of the face itself.
    points[:, 2] = gel.layer.height_mm(points[:, :2])
    hits = first_hits(moved, body.surface.triangles, points[:, :2])
    heights = surface_heights(shape, pose, points[:, :2])
    rows = np.flatnonzero((hits.triangles >= 0) & np.isfinite(heights))
    if not len(rows):
        return None
    nodes, values = _interpolation(
        mesh, body.surface.triangles[hits.triangles[rows]], hits.barycentric[rows],
        triangles[rows // count] + shift, rule[rows % count],
    )  # fmt: skip
    return Facing(
        mesh,
        points[rows],
        heights[rows] - points[rows, 2],
        areas[rows // count] * weights[rows % count],
        nodes,
        values,
        hits.triangles[rows],
        hits.barycentric[rows],
        np.delete(points, rows, axis=0),
    )


def _divided(divisions: int) -> tuple[Float[np.ndarray, "p 3"], Float[np.ndarray, " p"]]:
    """Return barycentric points and weights of a triangle whose sides are divided."""
    steps = range(divisions)
    up = [(i, j, 1) for i in steps for j in steps if i + j < divisions]
    down = [(i + 1, j + 1, -1) for i in steps for j in steps if i + j < divisions - 1]
    points = []
    for i, j, sign in up + down:
        corners = np.array([(i, j), (i + sign, j), (i, j + sign)]) / divisions
        first = np.column_stack([corners, 1.0 - corners.sum(axis=1)])
        points.append(TRIANGLE_POINTS @ first)
    return np.concatenate(points), np.tile(TRIANGLE_WEIGHTS, len(points)) / divisions**2


def _interpolation(
    mesh: TetMesh,
    first: Int[np.ndarray, "p 3"],
    at_first: Float[np.ndarray, "p 3"],
    second: Int[np.ndarray, "p 3"],
    at_second: Float[np.ndarray, "p 3"],
) -> tuple[Int[np.ndarray, "p c"], Float[np.ndarray, "p c"]]:
    """Nodes of pairs of triangles, and shape functions at their points, negative for the second."""
    parts = Discretisation(mesh, ELEMENTS[ELEMENT])
    nodes = np.hstack([parts.surface_nodes(first), parts.surface_nodes(second)])
    values = np.hstack([parts.surface_values(at_first), -parts.surface_values(at_second)])
    return nodes, values
