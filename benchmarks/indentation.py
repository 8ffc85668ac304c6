"""Indentation of a gel by rigid indenters, without friction or without slip, on a fine mesh.

A quarter of a flat gel is meshed, with symmetry, in rings about the axis of the indenter; one ring
is at the edge of a punch, and elements are smaller near the contact. The nodes in contact are found
by an active-set iteration: nodes under tension are released, and nodes inside the indenter are
placed on it.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator

from tactorch.fem import SoftBody, Supports, make_material
from tactorch.mesh import TetMesh, box_mesh
from tactorch.sensor.description import GelLayer

_TURNS = 25  # of finding which nodes touch
_TIE = 1e-3  # of the depth: how well they lie on the indenter


@dataclass(frozen=True)
class Indenter:
    """A rigid indenter about the z axis that comes from above.

    Attributes:
        punch_mm: Radius of a flat punch.
        sphere_mm: Radius of a sphere, taken as a paraboloid as Hertz did; give one of both.
    """

    punch_mm: float | None = None
    sphere_mm: float | None = None

    def rises(self, away_mm: np.ndarray) -> np.ndarray:
        """Height over the tip at distances from the axis; infinite beyond a punch."""
        if self.punch_mm is not None:
            return np.where(away_mm <= self.punch_mm * (1 + 1e-9), 0.0, np.inf)
        assert self.sphere_mm is not None
        return away_mm**2 / (2.0 * self.sphere_mm)


@dataclass(frozen=True, eq=False)
class Pressed:
    """A gel under an indenter.

    Attributes:
        places_mm: Of nodes on its face at rest, (k, 2).
        moved_mm: How they moved, (k, 3).
        force_n: Total on the whole gel, (3,).
        edge_mm: Distance from the axis of the farthest node that touches.
        symmetric: Whether only x >= 0, y >= 0 is there.
    """

    places_mm: np.ndarray
    moved_mm: np.ndarray
    force_n: np.ndarray
    edge_mm: float
    symmetric: bool

    def at(self, places_mm: np.ndarray) -> np.ndarray:
        """Return how the face moved at places x, y."""
        asked = np.abs(places_mm) if self.symmetric else places_mm
        found = LinearNDInterpolator(self.places_mm, self.moved_mm)(asked)
        out = np.isnan(found[:, 0])  # rounded off the rim
        if out.any():
            found[out] = NearestNDInterpolator(self.places_mm, self.moved_mm)(asked[out])
        if self.symmetric:
            found[:, :2] *= np.where(places_mm < 0, -1.0, 1.0)
        return found


@dataclass(frozen=True, eq=False)
class FineGel:
    """A gel meshed for one contact.

    Attributes:
        mesh: Its tetrahedra, z out of the gel.
        held: Held degrees of freedom: the window, and symmetry.
        face: Nodes that may touch.
        youngs_mpa: Young's modulus.
        poisson: Poisson's ratio.
        symmetric: Whether it is a quarter.
    """

    mesh: TetMesh
    held: np.ndarray
    face: np.ndarray
    youngs_mpa: float
    poisson: float
    symmetric: bool = True

    def press(self, indenter: Indenter, depth_mm: float, *, slips: bool = True) -> Pressed:
        """Press an indenter in."""
        body = SoftBody(self.mesh, make_material("neo_hookean", self.poisson), element="tet10")
        youngs = np.full(self.mesh.n_tets, self.youngs_mpa)
        rest, face = self.mesh.points, self.face
        top = rest[face, 2].max()
        u, away = None, np.linalg.norm(rest[face, :2], axis=1)
        on = indenter.rises(away) + top - rest[face, 2] < 0.5 * depth_mm
        follows = slips and indenter.punch_mm is None
        for _ in range(_TURNS):
            goal = top - depth_mm + indenter.rises(away) - rest[face, 2]
            fixed, prescribed = self.held.copy(), np.zeros(rest.shape)
            fixed[face[on]] |= (not slips, not slips, True)
            prescribed[face[on], 2] = goal[on]
            nothing = np.zeros(rest.shape)
            found = body.equilibrate(youngs, nothing, Supports(fixed, prescribed), start=u)
            u = found.require().displacement
            inner = body.assembly.internal_force(found.response, youngs)
            pushed = _at_vertices(body, inner, fixed[:, 2])[face, 2] < 0
            new = np.where(on, pushed, u[face, 2] > goal + 1e-6 * depth_mm)
            if follows:
                away = np.linalg.norm((rest + u[: len(rest)])[face, :2], axis=1)
            lies = top - depth_mm + indenter.rises(away)[on] - rest[face[on], 2]
            if (new == on).all() and np.abs(lies - goal[on]).max() < _TIE * depth_mm:
                break
            on = new
        return self._pressed(body, u, inner, float(away[on].max()))

    def _pressed(self, body: SoftBody, u: np.ndarray, inner: np.ndarray, edge: float) -> Pressed:
        edges = body.discretisation.edges
        window = self.held[:, 2]
        held = np.concatenate([window, window[edges].all(axis=1)])
        top = np.zeros(len(window), dtype=bool)
        top[self.face] = True
        face = np.concatenate([top, top[edges].all(axis=1)])
        force = -inner[held].sum(axis=0)
        if self.symmetric:
            force = np.array([0.0, 0.0, 4.0 * force[2]])
        places = body.discretisation.positions[face, :2]
        return Pressed(places, u[face], force, edge, self.symmetric)


def fine_gel(gel: GelLayer, edge_mm: float, fineness: float = 1.0, *, sharp: bool) -> FineGel:
    """Mesh a quarter of a flat gel for a contact.

    Args:
        gel: The soft layer.
        edge_mm: Radius of the contact.
        fineness: Elements along each direction, relative to the usual.
        sharp: Whether pressure is infinite at the contact's edge, as under a punch.
    """
    outline, thickness = min(gel.half_size_mm), float(gel.thickness_mm)
    growth = 1.45 ** (1.0 / fineness)
    if sharp:
        first = 0.04 * edge_mm / fineness
        inner = edge_mm - _growing(0.0, edge_mm, first, growth)[::-1]
    else:
        inner = np.linspace(0.0, 1.3 * edge_mm, round(12 * fineness) + 1)
        first = inner[1]
    radii = np.concatenate([inner, _growing(inner[-1], outline, first, growth)[1:]])
    depths = _growing(0.0, thickness, 0.06 * edge_mm / fineness, growth)
    turns = max(4, round(8 * fineness))
    corner = np.arctan2(gel.half_size_mm[1], gel.half_size_mm[0])
    half = turns // 2
    angles = np.concatenate(
        [np.linspace(0, corner, half + 1), np.linspace(corner, np.pi / 2, turns - half + 1)[1:]]
    )
    mesh = _rings(gel, radii, angles, -depths[::-1])
    points = mesh.points
    held = np.stack([points[:, 0] < 1e-9, points[:, 1] < 1e-9, np.zeros(len(points), bool)], axis=1)
    held[points[:, 2] < 1e-9 - thickness] = True
    face = np.flatnonzero(points[:, 2] > -1e-9)
    return FineGel(mesh, held, face, float(gel.youngs_mpa), float(gel.poisson))


def _rings(gel: GelLayer, radii: np.ndarray, angles: np.ndarray, heights: np.ndarray) -> TetMesh:
    """Mesh rings that turn from circles to the gel's outline in their outer part."""
    counts = (len(radii) - 1, len(angles) - 1, len(heights) - 1)
    half = gel.half_size_mm
    rim = np.full(len(angles), half[0])
    if gel.size_mm is not None:
        with np.errstate(divide="ignore"):
            rim = np.minimum(half[0] / np.cos(angles), half[1] / np.sin(angles))
    last, begin = radii[-1], 0.6 * radii[-1]
    share = np.clip((radii - begin) / (last - begin), 0.0, 1.0)[:, None]
    away = radii[:, None] * (1 - share) + share * (
        begin + (radii[:, None] - begin) / (last - begin) * (rim - begin)
    )
    x, y = away * np.cos(angles), away * np.sin(angles)
    grid = np.stack(
        [np.repeat(v[:, :, None], len(heights), axis=2) for v in (x, y)]
        + [np.broadcast_to(heights, (*x.shape, len(heights)))],
        axis=-1,
    )
    number = np.arange(grid[..., 0].size).reshape(grid.shape[:3])
    number[0] = number[0, 0]  # the axis
    tets = number.ravel()[box_mesh((1.0, 1.0, 1.0), counts).tets]
    tets = tets[[len(set(tet)) == 4 for tet in tets]]
    used, tets = np.unique(tets, return_inverse=True)
    points = grid.reshape(-1, 3)[used]
    points[np.abs(points) < 1e-12] = 0.0
    return TetMesh.create(points, tets.reshape(-1, 4))


def _growing(start: float, stop: float, first: float, growth: float) -> np.ndarray:
    """Steps that grow, fitted to end where they must."""
    steps = [first]
    while sum(steps) < stop - start:
        steps.append(steps[-1] * growth)
    out = np.concatenate([[0.0], np.cumsum(steps)])
    return start + out * (stop - start) / out[-1]


def _at_vertices(body: SoftBody, inner: np.ndarray, fixed: np.ndarray) -> np.ndarray:
    """Hand forces on held midsides to their ends."""
    n = len(fixed)
    at, edges = inner[:n].copy(), body.discretisation.edges
    both = fixed[edges].all(axis=1)
    for end in (0, 1):
        np.add.at(at, edges[both, end], 0.5 * inner[n:][both])
    return at


def published_gel(folder: Path, youngs_mpa: float, poisson: float) -> FineGel:
    """Read the published mesh of a sensor's gel (CalculiX), whose face is y, curved and rounded."""
    numbers: dict[str, list[float]] = {"*NODE": [], "*ELEMENT": []}
    mode = ""
    for line in (folder / "mesh_ccx" / "gelsight_miniMesh.inp").read_text().splitlines():
        if line.startswith("*"):
            mode = line.upper().split(",")[0].strip()
        elif mode in numbers:
            numbers[mode] += [float(x) for x in line.split(",") if x.strip()]
    nodes = np.array(numbers["*NODE"]).reshape(-1, 4)
    tets = np.array(numbers["*ELEMENT"]).reshape(-1, 11)[:, 1:5].astype(int)
    used, cells = np.unique(tets, return_inverse=True)
    order = np.argsort(nodes[:, 0])
    points = nodes[order[np.searchsorted(nodes[order, 0], used)], 1:]
    low, high = points.min(axis=0), points.max(axis=0)
    points = points - (*(0.5 * (low + high))[:1], high[1], 0.5 * (low + high)[2])
    mesh = TetMesh.create(points[:, [0, 2, 1]] * (1.0, -1.0, 1.0), cells.reshape(-1, 4))
    window = mesh.points[:, 2] < low[1] - high[1] + 1e-6
    held = np.repeat(window[:, None], 3, axis=1)
    face = np.unique(mesh.surface.triangles[mesh.surface.normals[:, 2] > 0.5])
    return FineGel(mesh, held, face, youngs_mpa, poisson, symmetric=False)
