"""A gel pressed on a box with inclusions: one body of quadratic elements, refined where they meet.

Gel and object share the nodes of the contact, which does not slip. Elements are bisected toward the
edge of the contact, where the traction is singular, and around the inclusion, whose modulus is
evaluated at the quadrature points.
"""

from dataclasses import dataclass

import numpy as np

from tactorch.fem import SoftBody, Supports, make_material
from tactorch.mesh import TetMesh, box_mesh, refine
from tactorch.sensor.description import GelLayer

_GROWTH = 0.6  # of the edge length with the distance from the edge of the contact
# Edge lengths far from both, and at an inclusion, mm. With 1.25, 1.0 and 0.5 at the rim markers are
# off by 0.5 um at a depth of 1.1 mm, more than those of an image; with these and 0.4 by 0.06 um.
_COARSE_MM, _INCLUSION_MM = 0.8, 0.8


@dataclass(frozen=True)
class Ball:
    """A spherical inclusion: centre and radius in mm, Young's modulus in MPa."""

    center_mm: tuple[float, float, float]
    radius_mm: float
    youngs_mpa: float


@dataclass(frozen=True)
class PressedBox:
    """A cube of side `side_mm` at the origin, and a gel that covers its top.

    Attributes:
        side_mm: Side of the cube, mm.
        youngs_mpa: Young's modulus around the ball, MPa.
        poisson: Poisson's ratio of cube and gel.
        ball: Inclusion, or None.
        gel: Gel; wider than the cube.
        offset_mm: Of the gel's axis from the middle of the cube, x and y.
    """

    side_mm: float
    youngs_mpa: float
    poisson: float
    ball: Ball | None
    gel: GelLayer
    offset_mm: tuple[float, float] = (0.0, 0.0)

    def gel_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest corner of the gel, mm."""
        center = self.side_mm / 2 + np.array(self.offset_mm)
        half = np.array(self.gel.half_size_mm)
        low = np.array([*(center - half), self.side_mm])
        return low, np.array([*(center + half), self.side_mm + self.gel.thickness_mm])


@dataclass(frozen=True, eq=False)
class Contact:
    """Equilibrium of gel and cube.

    Attributes:
        points: Nodes of the gel's face at rest, mm, in the frame of the cube.
        moved: Their displacement, mm.
        force: Of the gel on the cube, N.
        nodes: All nodes of the cube at rest, mm.
        displacement: Their displacement, mm.
    """

    points: np.ndarray
    moved: np.ndarray
    force: np.ndarray
    nodes: np.ndarray
    displacement: np.ndarray


def press_box(scene: PressedBox, motions: list[np.ndarray], rim_mm: float) -> list[Contact]:
    """Move the gel's window by each motion (mm) from first touch; edges at the rim are `rim_mm`."""
    mesh = union_mesh(scene, rim_mm)
    body = SoftBody(mesh, make_material("neo_hookean", scene.poisson), element="tet10")
    youngs, nodes = moduli(scene, body), body.discretisation.positions
    low, high = scene.gel_bounds()
    window = mesh.points[:, 2] > high[2] - 1e-6
    fixed = np.zeros(mesh.points.shape, dtype=bool)
    fixed[window | (mesh.points[:, 2] < 1e-6)] = True
    in_gel = np.zeros(len(nodes), dtype=bool)
    in_gel[body.discretisation.nodes[mesh.centroids[:, 2] > low[2]]] = True
    face = in_gel & (nodes[:, 2] < low[2] + 1e-6)
    in_cube = nodes[:, 2] < scene.side_mm + 1e-6
    in_cube &= ((nodes > -1e-6) & (nodes < scene.side_mm + 1e-6)).all(axis=1)
    held_up = nodes[:, 2] > high[2] - 1e-6
    nothing, u, contacts = np.zeros(mesh.points.shape), None, []
    for motion in motions:
        prescribed = np.where(window[:, None], motion, 0.0)
        found = body.equilibrate(youngs, nothing, Supports(fixed, prescribed), start=u).require()
        u = found.displacement
        force = body.assembly.internal_force(found.response, youngs)[held_up].sum(axis=0)
        contacts.append(Contact(nodes[face], u[face], force, nodes[in_cube], u[in_cube]))
    return contacts


def union_mesh(scene: PressedBox, rim_mm: float) -> TetMesh:
    """Mesh cube and gel with shared nodes, refined at the edge of their contact and the ball."""
    low, high = scene.gel_bounds()
    side = scene.side_mm
    across = [_lines(low[k], 0.0, side, high[k]) for k in (0, 1)]
    up = np.concatenate([_split(0.0, side), _split(low[2], high[2])[1:]])
    axes = [*across, up]
    counts = [len(axis) - 1 for axis in axes]
    grid = box_mesh(tuple(map(float, counts)), counts)
    index = np.round(grid.points).astype(int)
    points = np.column_stack([axis[index[:, k]] for k, axis in enumerate(axes)])
    centers = points[grid.tets].mean(axis=1)
    kept = (centers[:, 2] > side) | ((centers > 0) & (centers < side)).all(axis=1)
    used, tets = np.unique(grid.tets[kept], return_inverse=True)
    mesh = TetMesh.create(points[used], tets.reshape(-1, 4))
    return refine(mesh, lambda at: sizes(scene, at, rim_mm)).mesh


def sizes(scene: PressedBox, at: np.ndarray, rim_mm: float) -> np.ndarray:
    """Largest edge length of elements at these points, mm."""
    side = scene.side_mm
    outside = np.maximum(np.abs(at[:, :2] - side / 2) - side / 2, 0.0)
    inside = side / 2 - np.abs(at[:, :2] - side / 2).max(axis=1)
    across = np.where(inside > 0, inside, np.linalg.norm(outside, axis=1))
    limits = np.clip(_GROWTH * np.hypot(across, at[:, 2] - side), rim_mm, _COARSE_MM * 1.75)
    if scene.ball is not None:
        center, radius = np.array(scene.ball.center_mm), scene.ball.radius_mm
        apart = np.abs(np.linalg.norm(at - center, axis=1) - radius)
        limits = np.minimum(limits, np.maximum(_INCLUSION_MM, 0.8 * apart))
    return limits


def moduli(scene: PressedBox, body: SoftBody) -> np.ndarray:
    """Young's modulus at the quadrature points of each element, MPa."""
    mesh, low = body.mesh, scene.gel_bounds()[0]
    at = body.discretisation.element.points @ mesh.points[mesh.tets]  # quadrature points
    youngs = np.full(at.shape[:2], scene.youngs_mpa)
    if scene.ball is not None:
        apart = np.linalg.norm(at - np.array(scene.ball.center_mm), axis=-1)
        youngs[apart < scene.ball.radius_mm] = scene.ball.youngs_mpa
    youngs[mesh.centroids[:, 2] > low[2]] = float(scene.gel.youngs_mpa)
    return youngs


def _lines(low: float, first: float, last: float, high: float) -> np.ndarray:
    parts = [_split(low, first), _split(first, last)[1:], _split(last, high)[1:]]
    return np.concatenate(parts)


def _split(low: float, high: float) -> np.ndarray:
    return np.linspace(low, high, max(1, round((high - low) / _COARSE_MM)) + 1)
