"""Points of the gel's face and the points of a body that are opposite to them."""

from dataclasses import dataclass
from typing import NamedTuple

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
    """A gel and a body in front of it, and maybe an equal gel on the other side; p pairs of points.

    Attributes:
        mesh: The body, then the gels, in the sensor frame, mm.
        points: Points of the face of a gel at rest, (p, 3), mm.
        gaps_mm: Distance of the surface of the shape from each along z, in the pose.
        areas_mm2: Area of the gel's face that each point stands for.
        nodes: Nodes of body and gel from which both points of each pair are interpolated.
        values: Their shape functions, negative for the gel; with the other sign for the opposed
            gel, so that the motion of both along z is the same where they approach each other.
        faces: Triangle of the body's surface of each pair, among those of the body's mesh.
        barycentric: Place in this triangle.
        others: Points of the gel's face at rest without one opposite to them, (r, 3), mm.
        opposed: Pairs of the opposed gel, (p,).
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
    opposed: Bool[np.ndarray, " p"]

    @property
    def first_touch(self) -> tuple[Float[np.ndarray, "2"], float]:
        """Position (x, y) of the first touch, and the motion along z until then, mm.

        With an opposed gel it is the motion of each until both touch: the body is free between
        them.
        """
        first = int(np.where(self.opposed, np.inf, self.gaps_mm).argmin())
        return self.points[first, :2], float(np.mean(np.unique(self._least)))

    @property
    def _least(self) -> Float[np.ndarray, " p"]:
        """Least gap of the gel of each pair, mm."""
        gaps, least = self.gaps_mm, np.zeros(len(self.gaps_mm))
        for side in (self.opposed, ~self.opposed):
            least[side] = gaps[side].min(initial=np.inf)
        return least

    def pairs(self, reach_mm: float) -> tuple[Pairs, Bool[np.ndarray, " p"]]:
        """Return pairs of up to this distance from each other at first touch, and which they are.

        Gaps are those at first touch.
        """
        gaps = self.gaps_mm - self._least
        near = gaps <= reach_mm
        coupled = CoupledDiscretisation(self.mesh, ELEMENTS[ELEMENT], self.nodes[near])
        arrays = self.values[near], gaps[near], self.areas_mm2[near], self.points[near]
        return Pairs(coupled, *arrays), near


class _Side(NamedTuple):
    """Points of a gel that are opposite to points of a body, in the frame of the gel."""

    points: Float[np.ndarray, "p 3"]
    gaps_mm: Float[np.ndarray, " p"]
    areas_mm2: Float[np.ndarray, " p"]
    faces: Int[np.ndarray, " p"]
    barycentric: Float[np.ndarray, "p 3"]
    triangles: Int[np.ndarray, "p 3"]  # of the gel
    rule: Float[np.ndarray, "p 3"]
    others: Float[np.ndarray, "r 3"]

    @staticmethod
    def of(
        body: TetMesh, shape: Shape | TetMesh, gel: GelMesh, pose: Pose, divisions: int
    ) -> "_Side | None":
        """Return them; None where there are none."""
        moved = transform_points(np.linalg.inv(pose), body.points)
        face = gel.mesh.surface
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
        return _Side(
            points[rows],
            heights[rows] - points[rows, 2],
            areas[rows // count] * weights[rows % count],
            hits.triangles[rows],
            hits.barycentric[rows],
            triangles[rows // count],
            rule[rows % count],
            np.delete(points, rows, axis=0),
        )


def opposed_frame(opening_mm: float) -> Pose:
    """Return the transform to the frame of a gel from that of one opposite to it.

    `opening_mm` is the distance of their faces at rest.
    """
    frame = np.diag([1.0, -1.0, -1.0, 1.0])
    frame[2, 3] = opening_mm
    return frame


def face_each_other(
    body: TetMesh,
    shape: Shape | TetMesh,
    gel: GelMesh,
    pose: Pose,
    divisions: int = _DIVISIONS,
    opening_mm: float = np.nan,
) -> Facing | None:
    """Pair the points of a gel with those of a body opposite to them; None where there are none.

    Distances are those of the shape itself, whose surface the mesh of the body follows within its
    elements, or of the curved surface through the nodes of a mesh. Triangles of the gel's face have
    six points in each part into which `divisions` of their sides divide them: the more there are,
    the better the area of a contact that ends within triangles is known.

    Where `opening_mm` is finite, an equal gel is on the other side of the body, with its face at
    this distance.
    """
    frames = [np.eye(4)] + ([opposed_frame(opening_mm)] if np.isfinite(opening_mm) else [])
    found = [_Side.of(body, shape, gel, pose @ frame, divisions) for frame in frames]
    sides = [side for side in found if side is not None]
    if len(sides) < len(frames):
        return None
    shifts = [body.n_points + k * gel.mesh.n_points for k in range(len(frames))]
    mesh = PartsMesh(
        np.concatenate(
            [
                transform_points(np.linalg.inv(pose), body.points),
                *(transform_points(frame, gel.mesh.points) for frame in frames),
            ]
        ),
        np.concatenate([body.tets, *(gel.mesh.tets + shift for shift in shifts)]),
    )
    nodes, values = _interpolation(
        mesh,
        body.surface.triangles[np.concatenate([side.faces for side in sides])],
        np.concatenate([side.barycentric for side in sides]),
        np.concatenate([s.triangles + shift for s, shift in zip(sides, shifts, strict=True)]),
        np.concatenate([side.rule for side in sides]),
    )
    opposed = np.repeat(np.arange(len(sides)) > 0, [len(side.points) for side in sides])
    placed = [transform_points(f, side.points) for f, side in zip(frames, sides, strict=True)]
    return Facing(
        mesh,
        np.concatenate(placed),
        np.concatenate([side.gaps_mm for side in sides]),
        np.concatenate([side.areas_mm2 for side in sides]),
        nodes,
        np.where(opposed[:, None], -values, values),
        np.concatenate([side.faces for side in sides]),
        np.concatenate([side.barycentric for side in sides]),
        sides[0].others,
        opposed,
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
