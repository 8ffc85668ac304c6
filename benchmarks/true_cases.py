"""Objects, presses and recordings of `true_objects.py`; lengths in mm, moduli in MPa.

The presses are solved with quadratic elements on a mesh that follows the object's interfaces and is
refined at them and under the contact (`true_meshes.py`); the recording is on a coarser mesh of the
body that knows nothing of its inside. Under patches and fingers it is fine enough for their
tractions, and on curved surfaces for the outline there. It carries neither truth nor provenance.
"""

import hashlib
import json
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from true_meshes import (
    LabelledMesh,
    Sizing,
    labels_at,
    make_truth_mesh,
    refine,
    refine_everywhere,
    volume,
)

from tactorch.fem import ELEMENTS, Discretisation, NewtonOptions, SoftBody, Supports, make_material
from tactorch.fem.boundary import pressure_forces
from tactorch.fem.transfer import Transfer
from tactorch.files import atomic_path, cache_folder
from tactorch.mesh import (
    Box,
    Cone,
    Cylinder,
    Ellipsoid,
    Hemisphere,
    Lathe,
    Rotated,
    Shape,
    Sphere,
    TetMesh,
    Union,
    face_nodes,
)
from tactorch.mesh.sharp_edges import distance_from_sharp_edges
from tactorch.phantoms import Gradient, Layers, Phantom, RandomField, make_phantom
from tactorch.recording import MaterialSpec, Press, Recording
from tactorch.simulation import noise_level
from tactorch.simulation.patch import nodes_within, patch_forces
from tactorch.simulation.plan import PressSite

FORMAT = 3  # of the cached recordings; raised when their computation changes
VOXELS = 36
N_RANDOM = 150  # objects of random shape
N_DOUBTFUL = 200  # cubes of which every second has a ball
MATERIAL = MaterialSpec("neo_hookean", 0.45)
SPRING_N_PER_MM = 1.0  # of each supported node of the recording's mesh
FORCE_ERROR, MISPLACEMENT_MM = 0.05, 0.3
WRONG_DEPTH, WRONG_POISSON = 1.1, 0.40  # depth over that of the object, and Poisson's ratio
LUMP_PER_RADIUS = 0.4  # edge length of the truth mesh at a lump, over its smallest half-width
# Edge length of the truth mesh at sharp edges, over the body's size: where a supported face ends
# the strain is singular.
CREASE_PER_SIZE = 0.035
LEVEL_MM = 0.5  # edge length of the truth mesh at interfaces of layers that reach the sides
RECORDED_PER_RADIUS = 0.3  # edge length of the recording's mesh under a contact, over its radius
# Edge length of the truth mesh at the rim of a patch, over its radius, and its growth with the
# distance: the pressure ends there, and the strain is singular.
RIM_PER_RADIUS, RIM_GROWTH = 0.05, 0.6
Point = tuple[float, float, float]
_FLANK = 0.5  # smallest cosine between a finger's push and the surface under it
_FINGER_POINTS = 8  # along the edge of a triangle, for the pressure of a finger


@dataclass(frozen=True)
class Contact:
    """Location of a press.

    Attributes:
        kind: "side" (uniform pressure on a whole face), "patch" (the same on a disc of a face) or
            "finger" (pressure p (1 - r^2 / R^2) at distance r from an axis).
        face: Face of the bounding box, for sides and patches.
        center_mm: Centre of a patch or finger on the surface.
        inward: Direction of a finger's push.
        radius_mm: Radius R of the patch or finger.
    """

    kind: str
    face: str = ""
    center_mm: Point | None = None
    inward: Point | None = None
    radius_mm: float | None = None

    @property
    def name(self) -> str:
        """Name of the press."""
        where = "" if self.center_mm is None else f" at {np.round(self.center_mm, 2).tolist()} mm"
        return f"{self.kind} {self.face}".strip() + where

    @property
    def site(self) -> PressSite:
        """Face and centre, of sides and patches."""
        return PressSite(self.face, self.center_mm)

    @property
    def direction(self) -> np.ndarray:
        """Unit vector of the push."""
        return self.site.direction if self.inward is None else np.array(self.inward)

    @property
    def has_sharp_rim(self) -> bool:
        """Whether the pressure ends with a jump within a face."""
        return self.kind == "patch"

    def beyond(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return distances of points from the cylinder of a patch or finger, and depths, mm.

        The distances are negative within the cylinder.
        """
        offsets = points - np.array(self.center_mm)
        depth = offsets @ self.direction
        across = np.linalg.norm(offsets - np.outer(depth, self.direction), axis=1)
        return across - float(self.radius_mm or 0.0), depth

    def shifted(self, shift: np.ndarray) -> "Contact":
        """Return the contact at another place."""
        return replace(self, center_mm=_point(np.array(self.center_mm) + shift))

    def unit_forces(self, discretisation: Discretisation) -> np.ndarray:
        """Return the consistent nodal forces of 1 MPa, (nodes, 3), N."""
        if self.kind == "side":
            return np.asarray(pressure_forces(discretisation, self.face, 1.0).numpy())
        assert self.radius_mm is not None
        if self.kind == "patch":
            return patch_forces(discretisation, self.site, self.radius_mm)
        return self._finger_forces(discretisation, self.radius_mm)

    def observed(self, mesh: TetMesh) -> np.ndarray:
        """Return the observed nodes: those of the face, or within the radius of the centre."""
        if self.kind == "finger":
            nodes = np.unique(mesh.surface.triangles[self._under(mesh)])
            return nodes[self._distances(mesh.points[nodes]) <= self.radius_mm]
        nodes = face_nodes(mesh, self.face)
        if self.radius_mm is None:
            return nodes
        return nodes_within(mesh, nodes, self.site, self.radius_mm)

    def _under(self, mesh: TetMesh) -> np.ndarray:
        """Surface triangles that face a finger and have a vertex under it, or near."""
        facing = mesh.surface.normals @ self.direction < -_FLANK
        corners = mesh.points[mesh.surface.triangles]
        offsets = corners - np.array(self.center_mm)
        size = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
        near = np.linalg.norm(offsets, axis=2).min(axis=1) < 1.5 * (self.radius_mm or 0.0) + size
        return np.flatnonzero(facing & near)

    def _distances(self, points: np.ndarray) -> np.ndarray:
        """Distances from a finger's axis."""
        offsets = points - np.array(self.center_mm)
        across = offsets - (offsets @ self.direction)[..., None] * self.direction
        return np.asarray(np.linalg.norm(across, axis=-1))

    def _finger_forces(self, discretisation: Discretisation, radius: float) -> np.ndarray:
        """Integrate the pressure over the surface with the element's shape functions.

        The total is the exact one, pi R^2 / 2 along the push, on any mesh.
        """
        mesh, n = discretisation.mesh, _FINGER_POINTS
        under = self._under(mesh)
        triangles = mesh.surface.triangles[under]
        projected = -mesh.surface.areas[under] * (mesh.surface.normals[under] @ self.direction)
        centroids = [(i + k, j + k) for k, m in ((1 / 3, n), (2 / 3, n - 1))
                     for i in range(m) for j in range(m - i)]  # fmt: skip
        forces = np.zeros(discretisation.n_nodes)
        for i, j in centroids:
            L = np.array([1.0 - (i + j) / n, i / n, j / n])
            distances = self._distances(np.einsum("c,tcd->td", L, mesh.points[triangles]))
            load = np.maximum(1.0 - (distances / radius) ** 2, 0.0) * projected / len(centroids)
            quadratic = discretisation.element.quadratic
            at_vertices = L * (2.0 * L - 1.0) if quadratic else L
            for c in range(3):
                np.add.at(forces, triangles[:, c], at_vertices[c] * load)
                if quadratic:
                    d = (c + 1) % 3
                    midsides = discretisation.midside(triangles[:, c], triangles[:, d])
                    np.add.at(forces, midsides, 4.0 * L[c] * L[d] * load)
        return np.outer(forces * (0.5 * np.pi * radius**2 / forces.sum()), self.direction)


@dataclass(frozen=True)
class Presses:
    """Contacts and their pressures, MPa; with springs on the opposite side, or one side held."""

    name: str
    contacts: tuple[Contact, ...]
    pressures: tuple[float, ...]
    held_face: str | None = None  # None: springs
    refined_mm: float | None = None  # edge length of the truth mesh under the contacts
    recorded_per_radius: float = RECORDED_PER_RADIUS

    @property
    def recorded_mm(self) -> float | None:
        """Edge length of the recording's mesh under the contacts; None for whole sides."""
        radius = self.contacts[0].radius_mm
        return None if radius is None else self.recorded_per_radius * radius

    def sizing(self, edge_mm: float, growth: float) -> Sizing:
        """Return the edge length `edge_mm` under the contacts, plus `growth` times the distance."""

        def sizes(points: np.ndarray) -> np.ndarray:
            out = np.full(len(points), np.inf)
            for contact in self.contacts:
                beyond, depth = contact.beyond(points)
                out = np.minimum(out, edge_mm + growth * np.hypot(np.maximum(beyond, 0.0), depth))
            return out

        return sizes

    def rims(self, points: np.ndarray) -> np.ndarray:
        """Return the edge length of the truth mesh by the rims of patches, infinite without any."""
        out = np.full(len(points), np.inf)
        for contact in self.contacts:
            if contact.has_sharp_rim:
                assert contact.radius_mm is not None
                distances = np.hypot(*contact.beyond(points))
                out = np.minimum(out, RIM_PER_RADIUS * contact.radius_mm + RIM_GROWTH * distances)
        return out

    @property
    def parts(self) -> "tuple[Presses, ...]":
        """Presses that are solved on a separate truth mesh: each patch or finger, or all sides."""
        if any(contact.radius_mm is None for contact in self.contacts):
            return (self,)
        return tuple(replace(self, contacts=(contact,)) for contact in self.contacts)


@dataclass(frozen=True, eq=False)
class Body:
    """An object and its meshes.

    Attributes:
        phantom: Body and inclusions.
        lumps: Inclusions to be found; the others are part of the background.
        edge_mm: Edge length of the recording's mesh.
        truth_edge_mm: Edge length of the truth mesh.
        interface_mm: Edge length of the truth mesh at interfaces.
    """

    phantom: Phantom
    lumps: tuple[int, ...]
    edge_mm: float = 1.4
    truth_edge_mm: float = 0.9
    interface_mm: float = 0.9

    def lump_labels(self, points: np.ndarray) -> np.ndarray:
        """Return the lump at points (mm): 0 for none, k for the k-th lump."""
        labels = labels_at(self.phantom, points)
        out = np.zeros(len(points), dtype=np.int64)
        for k, index in enumerate(self.lumps, start=1):
            out[labels == index + 1] = k
        return out

    def mesh(self, presses: Presses) -> TetMesh:
        """Return the recording's mesh, which does not depend on the inclusions."""
        outline = Phantom(self.phantom.body)
        mesh = outline.mesh(self.edge_mm)
        if presses.recorded_mm is None:
            return mesh
        return refine(outline, mesh, presses.sizing(presses.recorded_mm, 1.5)).mesh

    def sizing(self, presses: Presses) -> Sizing:
        """Return the edge length of the truth mesh: small at interfaces, creases and contacts."""
        outline = Phantom(self.phantom.body).mesh(self.edge_mm)
        from_crease = distance_from_sharp_edges(outline)
        crease_mm = CREASE_PER_SIZE * float(np.cbrt(outline.volumes.sum()))
        edges = []
        levels = self._levels()
        for k, (shape, _) in enumerate(self.phantom.inclusions):
            radius = float(np.ptp(shape.bounds(), axis=0).min()) / 2
            lump_mm = LUMP_PER_RADIUS * radius if k in self.lumps else np.inf
            edges.append((shape, min(self.interface_mm, lump_mm)))

        def sizes(points: np.ndarray) -> np.ndarray:
            out = np.minimum(1.6 * self.truth_edge_mm, crease_mm + 0.8 * from_crease(points))
            for shape, edge in edges:
                out = np.minimum(out, edge + 0.4 * np.abs(shape.signed_distance(points)))
            for level in levels:
                out = np.minimum(out, LEVEL_MM + 0.4 * np.abs(points[:, 2] - level))
            if presses.refined_mm is not None:
                out = np.minimum(out, presses.sizing(presses.refined_mm, 0.5)(points))
            return np.minimum(out, presses.rims(points))

        return sizes

    def _levels(self) -> tuple[float, ...]:
        """Heights of the interfaces of layers that reach the sides, which no faces follow."""
        background = self.phantom.youngs_mpa
        return background.levels_mm if isinstance(background, Layers) else ()


@dataclass(frozen=True)
class Case:
    """One recording to invert.

    Attributes:
        object: Key of `OBJECTS`.
        presses: Key of `PRESSES`.
        snr_db: Signal-to-noise ratio of each press.
        fault: "forces" (each press' forces wrong by a random factor), "places" (presses misplaced),
            "depth" (the recording's mesh is too deep), "poisson" (its Poisson's ratio is wrong) or
            "".
        held_out: Whether the case belongs to the set that is run at the end only.
        seed: Seed of noise and fault.
    """

    object: str
    presses: str
    snr_db: float
    fault: str = ""
    held_out: bool = False
    seed: int = 0

    @property
    def name(self) -> str:
        """Name in tables and on the command line."""
        parts = [self.object, self.presses, f"{self.snr_db:g}db", self.fault]
        seed = f"s{self.seed}" if self.seed else ""
        return "-".join(part for part in (*parts, seed) if part)

    @property
    def body(self) -> Body:
        """The object."""
        return OBJECTS[self.object]()

    @property
    def solution(self) -> "Solution":
        """What is solved for this case: independent of noise and of wrong forces."""
        misplaced = MISPLACEMENT_MM if self.fault == "places" else 0.0
        return Solution(self.object, self.presses, misplaced)


def _point(values: np.ndarray) -> Point:
    """Coordinates as numbers, rounded so that the hash of a definition is reproducible."""
    x, y, z = (round(float(value), 6) for value in values)
    return x, y, z


def _patches(radius: float, places: tuple[float, ...]) -> tuple[Contact, ...]:
    return tuple(
        Contact("patch", "z+", (x, y, 10.0), radius_mm=radius) for x in places for y in places
    )


def _fingers(
    shape: Shape, radius: float, rings: tuple[tuple[float, int], ...]
) -> tuple[Contact, ...]:
    """Fingers along the normals of a body that stands on z = 0, at rings of polar angles."""
    contacts, reach = [], 2.0 * float(np.abs(shape.bounds()).max())
    for polar, count in rings:
        for k in range(count):
            turn = 2.0 * np.pi * k / count
            ray = np.array([
                np.sin(np.deg2rad(polar)) * np.cos(turn),
                np.sin(np.deg2rad(polar)) * np.sin(turn),
                np.cos(np.deg2rad(polar)),
            ])  # fmt: skip
            low, high = 0.0, reach
            while high - low > 1e-9 * reach:
                middle = (low + high) / 2
                inside = bool(shape.contains(middle * ray[None])[0])
                low, high = (middle, high) if inside else (low, middle)
            point, step = low * ray, 1e-4
            around = np.concatenate((point + step * np.eye(3), point - step * np.eye(3)))
            normal = np.subtract(*shape.signed_distance(around).reshape(2, 3))
            inward = -normal / np.linalg.norm(normal)
            contacts.append(Contact("finger", "", _point(point), _point(inward), radius))
    return tuple(contacts)


_CUBE = Box((5.0,) * 3, (10.0,) * 3)
_DOME = Hemisphere((0.0, 0.0, 0.0), 10.0)


def _breast_outline() -> np.ndarray:
    """Profile of a flattened dome of 30 mm radius and 24 mm height on its flat side."""
    angles = np.linspace(0.0, np.pi / 2, 33)
    radius, height = 30.0 * np.cos(angles) ** 0.8, 24.0 * np.sin(angles)
    return np.concatenate(([(0.0, 0.0)], np.column_stack((radius, height))[:-1], [(0.0, 24.0)]))


_BREAST = Lathe((0.0, 0.0, 0.0), _breast_outline())


def _cube(*inclusions: tuple[Shape, float], youngs: Any = 0.2, **settings: Any) -> Body:
    lumps = settings.pop("lumps", tuple(range(len(inclusions))))
    return Body(Phantom(_CUBE, inclusions, youngs), lumps, **settings)


def _layered() -> Body:
    """A stiff layer below and a soft one above, 0.4 mm from the sides, with a ball between."""
    # fTetWild leaves gaps between layers that end on the sides.
    layers = [
        (Box((5.0, 5.0, 1.6), (9.2, 9.2, 2.4)), 0.4),
        (Box((5.0, 5.0, 8.9), (9.2, 9.2, 1.4)), 0.12),
    ]
    lump = (Sphere((4.2, 5.6, 5.5), 1.7), 1.0)
    return _cube(*layers, lump, lumps=(2,))


def _spiculated() -> Shape:
    """A ball with ten spicules, along five axes."""
    center, turns = (5.0, 4.8, 6.0), ((0, 0, 20), (0, 0, 80), (0, 0, 140), (0, 50, 0), (0, -50, 0))
    spicules = (Rotated(Ellipsoid(center, (3.2, 0.45, 0.45)), turn) for turn in turns)
    return Union((Sphere(center, 1.5), *spicules))


def _breast(*lesions: tuple[Shape, float]) -> Body:
    """Fat with a random field of moduli, a gland, and lesions: an anatomy of 60 mm."""
    gland = (Ellipsoid((0.0, 0.0, 9.5), (17.0, 15.0, 9.0)), 0.05)
    fat = RandomField(0.02, 0.15, 12.0, 3)
    lumps = tuple(range(1, 1 + len(lesions)))
    phantom = Phantom(_BREAST, (gland, *lesions), fat)
    return Body(phantom, lumps, edge_mm=5.0, truth_edge_mm=3.0, interface_mm=3.0)


def _dome(*inclusions: tuple[Shape, float]) -> Body:
    phantom = Phantom(_DOME, inclusions, 0.1)
    return Body(phantom, tuple(range(len(inclusions))), 2.0, truth_edge_mm=1.3, interface_mm=1.3)


def _random(seed: int) -> Callable[[], Body]:
    """Return a ball or an ellipsoid of random place, size, form and modulus, in a cube."""

    def body() -> Body:
        rng = np.random.default_rng([seed, 77])
        radius = rng.uniform(1.3, 2.6)
        semi_axes = radius * np.exp(rng.uniform(-0.35, 0.35, 3) * (seed % 2))
        center = rng.uniform(0.6 + semi_axes.max(), 9.4 - semi_axes.max(), 3)
        contrast = np.exp(rng.uniform(np.log(1.8), np.log(8.0)))
        modulus = 0.2 * contrast if rng.random() < 0.7 else 0.2 / min(contrast, 4.0)
        if seed % 2:
            shape: Shape = Rotated(
                Ellipsoid(_point(center), _point(semi_axes)), _point(rng.uniform(0.0, 180.0, 3))
            )
        else:
            shape = Sphere(_point(center), round(float(radius), 6))
        return _cube((shape, round(float(modulus), 6)), edge_mm=1.6)

    return body


def _doubtful(seed: int) -> Callable[[], Body]:
    """Return a cube with a ball of any size and modulus, or for even seeds without any.

    Its modulus is uniform, linear, or a smooth random field.
    """

    def body() -> Body:
        rng = np.random.default_rng([seed, 91])
        radius = float(np.exp(rng.uniform(np.log(0.7), np.log(2.4))))
        center = _point(rng.uniform(0.6 + radius, 9.4 - radius, 3))
        contrast = float(np.exp(rng.uniform(np.log(1.5), np.log(8.0))))
        modulus = 0.2 * contrast if rng.random() < 0.7 else 0.2 / min(contrast, 4.0)
        direction = rng.standard_normal(3)
        end = _point(np.full(3, 5.0) + 9.0 * direction / np.linalg.norm(direction))
        start = _point(10.0 - np.array(end))
        youngs = (0.2, Gradient(start, end, 0.13, 0.3), RandomField(0.2, 0.1, 5.0, seed))
        lump = ((Sphere(center, round(radius, 6)), round(modulus, 6)),)
        background = youngs[seed // 2 % 3]
        return _cube(*lump[: seed % 2], youngs=background, edge_mm=1.6, truth_edge_mm=1.2)

    return body


OBJECTS: dict[str, Callable[[], Body]] = {
    "ball": lambda: Body(make_phantom("cube_sphere", depth=0.4, radius=0.2), (0,)),
    "deep_ball": lambda: Body(make_phantom("cube_deep_sphere"), (0,)),
    "small_ball": lambda: _cube((Sphere((6.0, 4.5, 7.2), 1.2), 1.0)),
    "soft_ball": lambda: _cube((Sphere((5.0, 5.0, 6.2), 2.0), 0.05)),
    "faint_ball": lambda: _cube((Sphere((4.4, 5.4, 6.0), 2.5), 0.4)),
    "cone": lambda: _cube((Cone((5.0, 5.0, 5.5), 2.6, 4.5), 1.0)),
    "two_balls": lambda: _cube(
        (Sphere((3.2, 5.0, 6.6), 1.4), 1.0), (Sphere((6.7, 5.3, 6.6), 1.4), 0.8)
    ),
    "ellipsoid": lambda: _cube(
        (Rotated(Ellipsoid((5.3, 4.6, 5.6), (2.6, 1.5, 1.3)), (20.0, 0.0, 35.0)), 2.0)
    ),
    "layers_ball": _layered,
    "skin_ball": lambda: _cube(
        (Sphere((4.2, 5.6, 5.5), 1.7), 1.0), youngs=Layers((2.8, 8.2), (0.4, 0.2, 0.12))
    ),
    "l_shape": lambda: _cube(
        (Union((Box((5.0, 3.4, 6.0), (5.6, 1.8, 1.8)), Box((3.1, 5.2, 6.0), (1.8, 5.4, 1.8)))), 1.0)
    ),
    "torus": lambda: Body(make_phantom("cube_torus"), (0,)),
    "two_tiers": lambda: Body(make_phantom("cube_two_tiers"), (0,)),
    "rod": lambda: _cube((Cylinder((5.0, 5.0, 6.0), 1.1, 6.0, (1.0, 0.5, 0.2)), 1.0)),
    "plate": lambda: _cube(
        (Rotated(Box((5.0, 5.0, 6.0), (5.5, 5.5, 1.3)), (10.0, 15.0, 20.0)), 1.0)
    ),
    "two_moduli": lambda: _cube(
        (Sphere((3.1, 4.6, 6.4), 1.5), 1.0), (Sphere((6.9, 5.5, 5.8), 1.6), 0.45)
    ),
    "spiculated": lambda: _cube((_spiculated(), 1.0)),
    "stiff_skin": lambda: _cube(
        (Sphere((5.8, 4.6, 5.8), 1.7), 1.0), youngs=Layers((8.8,), (0.2, 1.0))
    ),
    "dome": lambda: _dome((Ellipsoid((2.5, 1.0, 5.6), (2.4, 2.0, 1.7)), 0.5)),
    "breast": lambda: _breast((Sphere((7.0, 4.0, 12.0), 6.0), 0.25)),
    "uniform": lambda: _cube(),
    "gradient": lambda: _cube(youngs=Gradient((0.0, 0.0, 0.0), (0.0, 10.0, 10.0), 0.13, 0.3)),
    "uniform_dome": lambda: _dome(),
    "fat_gland": lambda: _breast(),
    **{f"random{seed}": _random(seed) for seed in range(N_RANDOM)},
    **{f"doubtful{seed}": _doubtful(seed) for seed in range(N_DOUBTFUL)},
}

_SIDES = tuple(Contact("side", face) for face in ("z+", "x+", "y+"))
_PATCHES = _patches(2.0, (2.5, 5.0, 7.5))
_FINGERS = _fingers(_DOME, 3.0, ((0.0, 1), (32.0, 5), (60.0, 6)))
_PALPATION = _fingers(_BREAST, 8.0, ((0.0, 1), (38.0, 5), (65.0, 6)))
PRESSES: dict[str, Presses] = {
    presses.name: presses
    for presses in (
        Presses("sides4", _SIDES, (0.005, 0.01, 0.015, 0.02)),
        Presses("sides", _SIDES, (0.01, 0.02)),
        # On a soft layer 20 kPa are near an instability at the sharp edges of the truth mesh.
        Presses("gentle", _SIDES, (0.005, 0.01)),
        Presses("patches", _PATCHES, (0.02,), refined_mm=0.35),
        Presses("fingers", _FINGERS, (0.012,), "z-", refined_mm=0.3),
        Presses("palpation", _PALPATION, (0.004,), "z-", refined_mm=0.8),
    )
}

CASES: tuple[Case, ...] = (
    Case("ball", "sides4", 40.0),
    Case("ball", "sides4", 30.0),
    Case("ball", "sides4", 40.0, "forces"),
    Case("ball", "patches", 40.0),
    Case("deep_ball", "sides4", 40.0),
    Case("small_ball", "patches", 40.0),
    Case("soft_ball", "sides", 40.0),
    Case("faint_ball", "sides", 30.0),
    Case("two_balls", "sides", 40.0),
    Case("layers_ball", "sides", 40.0),
    Case("skin_ball", "gentle", 40.0),
    Case("dome", "fingers", 40.0),
    Case("breast", "palpation", 40.0),
    Case("uniform", "sides", 30.0),
    Case("uniform_dome", "fingers", 40.0),
    Case("ball", "sides4", 20.0, held_out=True),
    Case("ball", "patches", 40.0, "places", held_out=True),
    Case("deep_ball", "sides4", 30.0, held_out=True),
    Case("small_ball", "sides", 40.0, held_out=True),
    Case("soft_ball", "sides", 30.0, held_out=True),
    Case("faint_ball", "patches", 40.0, held_out=True),
    Case("cone", "sides", 40.0, held_out=True),
    Case("ellipsoid", "sides", 40.0, held_out=True),
    Case("two_balls", "patches", 40.0, held_out=True),
    Case("layers_ball", "sides", 30.0, "forces", held_out=True),
    Case("skin_ball", "gentle", 30.0, held_out=True),
    Case("dome", "fingers", 40.0, "places", held_out=True),
    Case("breast", "palpation", 30.0, held_out=True),
    Case("uniform", "patches", 40.0, held_out=True),
    Case("gradient", "sides", 40.0, held_out=True),
)
# Inclusions that are no balls or ellipsoids, and those under a skin.
FORM_CASES: tuple[Case, ...] = tuple(
    Case(name, "gentle" if name == "stiff_skin" else "sides4", snr_db)
    for name in (
        "l_shape", "torus", "two_tiers", "rod", "plate", "two_moduli", "spiculated", "stiff_skin",
    )
    for snr_db in (40.0, 30.0)
)  # fmt: skip
RANDOM_CASES: tuple[Case, ...] = tuple(
    Case(f"random{seed}", "sides", (40.0, 30.0)[seed // 2 % 2], seed=1000 + seed)
    for seed in range(N_RANDOM)
)


def _doubtful_case(seed: int) -> Case:
    """Return presses of which a third have wrong forces, depth, or Poisson's ratio."""
    fault = ("forces", "depth", "poisson", *[""] * 6)[np.random.default_rng([seed, 92]).integers(9)]
    snr_db = (40.0, 30.0, 20.0)[seed // 6 % 3]
    return Case(f"doubtful{seed}", "sides", snr_db, fault, seed=5000 + seed)


DOUBTFUL_CASES: tuple[Case, ...] = tuple(_doubtful_case(seed) for seed in range(N_DOUBTFUL))


def random_cases(count: int, only: Sequence[str] | None) -> tuple[Case, ...]:
    """Return the first random cases, or those of the objects that are named."""
    if only:
        return tuple(case for case in RANDOM_CASES if case.object in only)
    return RANDOM_CASES[:count]


# Forty bodies without inclusion, of four truth solutions.
EMPTY_CASES: tuple[Case, ...] = tuple(
    Case(name, presses, snr_db, seed=100 * int(snr_db) + seed)
    for name, presses in (
        ("uniform", "sides"),
        ("uniform", "patches"),
        ("gradient", "sides"),
        ("uniform_dome", "fingers"),
    )
    for snr_db, count in ((40.0, 3), (30.0, 4), (20.0, 3))
    for seed in range(count)
)


@dataclass(frozen=True)
class Solution:
    """Presses on an object as they are, without noise; cached under a hash of their definition."""

    object: str
    presses: str
    misplaced_mm: float = 0.0

    def key(self) -> str:
        """Return the hash of the definition and of the format."""
        body, presses = OBJECTS[self.object](), PRESSES[self.presses]
        plain = asdict(presses)
        del plain["recorded_per_radius"]  # in recorded_mm
        definition = {
            "format": FORMAT,
            "phantom": body.phantom.to_config(),
            "meshes": [body.edge_mm, body.truth_edge_mm, body.interface_mm],
            **({"lumps": LUMP_PER_RADIUS} if body.lumps else {}),
            "creases": CREASE_PER_SIZE,
            **({"recorded_mm": presses.recorded_mm} if presses.recorded_mm else {}),
            **({"rims": [RIM_PER_RADIUS, RIM_GROWTH]} if len(presses.parts) > 1 else {}),
            "presses": plain,
            "misplaced": self.misplaced_mm,
            **({"shifts": "one for each contact"} if self.misplaced_mm else {}),
            "material": [MATERIAL.name, MATERIAL.poisson, SPRING_N_PER_MM],
        }
        text = json.dumps(definition, sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:24]

    def recording(self, cache: Path | None = None) -> Recording:
        """Return the noise-free recording, from the cache where it is there."""
        folder = cache_folder() / "true_objects" if cache is None else cache
        path = folder / f"{self.object}-{self.presses}-{self.key()}.h5"
        if not path.is_file():
            _log(f"{self.object}, {self.presses}: solving the presses (once; cached)")
            recording = self.solve()
            with atomic_path(path) as temporary:
                recording.save(temporary)
        return Recording.load(path)

    def solve(self) -> Recording:
        """Solve the presses on the truth mesh."""
        body, presses = OBJECTS[self.object](), PRESSES[self.presses]
        mesh = body.mesh(presses)
        motions = []
        for part in presses.parts:
            truth = make_truth_mesh(body.phantom, body.truth_edge_mm, body.sizing(part))
            motions += self._motions(body, part, mesh, truth, presses.pressures)
        recorded = []
        discretisation = Discretisation(mesh, ELEMENTS["tet4"])
        for contact, motion in zip(presses.contacts, motions, strict=True):
            given = vars(_supports(presses, contact, discretisation, mesh)).items()
            supports = {name: values for name, values in given if values is not None}
            forces = contact.unit_forces(discretisation)
            observed = np.zeros((mesh.n_points, 3), dtype=bool)
            observed[contact.observed(mesh)] = True
            for step, (pressure, displacement) in enumerate(
                zip(presses.pressures, motion, strict=True)
            ):
                press = Press(
                    pressure * forces,
                    observed,
                    displacement,
                    **supports,
                    step=step,
                    direction=contact.direction,
                    name=f"{contact.name}, {1e3 * pressure:g} kPa",
                )
                recorded.append(press)
        return Recording(mesh, tuple(recorded), MATERIAL)

    def check(self, cache: Path | None = None) -> dict[str, Any]:
        """Refine the truth mesh once more; return the change relative to the signal.

        The change is the root mean square, over the observed degrees of freedom, of the difference
        of the displacements of the highest pressure, over that of the displacements; the largest
        of all contacts.
        """
        body, presses = OBJECTS[self.object](), PRESSES[self.presses]
        recording, steps = self.recording(cache), len(presses.pressures)
        changes, elements, refined = [], 0, 0
        top = recording.presses[steps - 1 :: steps]
        for part in presses.parts:
            truth = make_truth_mesh(body.phantom, body.truth_edge_mm, body.sizing(part))
            finer = refine_everywhere(body.phantom, truth)
            elements = max(elements, truth.mesh.n_tets)
            refined = max(refined, finer.mesh.n_tets)
            pressures = presses.pressures[-1:]
            for (motion,) in self._motions(body, part, recording.mesh, finer, pressures):
                press = top[len(changes)]
                before = press.displacement[press.observed]
                change = motion[press.observed] - before
                changes.append(float(np.sqrt(np.mean(change**2) / np.mean(before**2))))
        return {
            "elements": elements,
            "refined_elements": refined,
            "change": max(changes),
            "median_change": float(np.median(changes)),
        }

    def _motions(
        self,
        body: Body,
        presses: Presses,
        mesh: TetMesh,
        truth: LabelledMesh,
        pressures: tuple[float, ...],
    ) -> list[list[np.ndarray]]:
        """Displacement of the recording's observed nodes, by contact and pressure; NaN elsewhere.

        A misplaced press acts beside its reported place, and the sensor reports what it sees there.
        """
        law = make_material(MATERIAL.name, MATERIAL.poisson)
        newton, solver = NewtonOptions(rtol=1e-7), "p_multigrid"
        soft = SoftBody(truth.mesh, law, element="tet10", newton=newton, solver=solver)
        youngs, began = truth.youngs(body.phantom), time.perf_counter()
        coarse, out, search = Discretisation(mesh, ELEMENTS["tet4"]), [], None
        contacts = PRESSES[self.presses].contacts  # of all parts
        for i, contact in enumerate(presses.contacts):
            actual, shift = contact, np.zeros(3)
            if self.misplaced_mm:
                shift = _shift(contact, contacts.index(contact), self.misplaced_mm)
                actual = contact.shifted(shift)
            if presses.held_face is None and i and contact.face != presses.contacts[i - 1].face:
                search = None  # other supports: the factorisation is of no use
            forces = actual.unit_forces(soft.discretisation)
            total = float((contact.unit_forces(coarse) @ contact.direction).sum())
            forces *= total / float((forces @ contact.direction).sum())
            supports = _supports(presses, contact, soft.discretisation, mesh)
            nodes = contact.observed(mesh)
            transfer = Transfer.between(soft.discretisation, mesh.points[nodes] + shift)
            displacement, motions = None, []
            for pressure in pressures:
                search = soft.search(youngs, pressure * forces, supports, after=search)
                displacement = search.run(displacement).require().displacement
                motion = np.full((mesh.n_points, 3), np.nan)
                motion[nodes] = transfer(displacement)
                motions.append(motion)
            out.append(motions)
            seconds = time.perf_counter() - began
            _log(f"    {truth.mesh.n_tets} elements, {contact.name}: {seconds:.0f} s")
        return out


def _supports(
    presses: Presses, contact: Contact, discretisation: Discretisation, recorded: TetMesh
) -> Supports:
    """Springs distributed evenly over the opposite side, or one side held.

    The total stiffness of the springs is that of one spring for each supported node of the
    recording's mesh.
    """
    if presses.held_face is not None:
        fixed = np.zeros((discretisation.mesh.n_points, 3), dtype=bool)
        fixed[face_nodes(discretisation.mesh, presses.held_face)] = True
        return Supports(fixed=fixed)
    site = contact.site
    reaction = pressure_forces(discretisation, site.opposite, 1.0).numpy() @ site.direction
    total = SPRING_N_PER_MM * len(face_nodes(recorded, site.opposite))
    springs = total * np.abs(reaction) / np.abs(reaction).sum()
    return Supports(springs=np.repeat(springs[:, None], 3, axis=1))


def _shift(contact: Contact, index: int, distance: float) -> np.ndarray:
    """Shift of a misplaced press across its push, in a random direction."""
    direction = np.random.default_rng([index, 31]).standard_normal(3)
    direction -= (direction @ contact.direction) * contact.direction
    return np.asarray(distance * direction / np.linalg.norm(direction))


def make_recording(case: Case, cache: Path | None = None) -> Recording:
    """Return the recording of a case: noisy, perhaps with wrong forces, without any truth."""
    exact = case.solution.recording(cache)
    factors = np.ones(len(exact.presses))
    if case.fault == "forces":
        rng = np.random.default_rng([case.seed, 1, 51])
        factors += FORCE_ERROR * rng.standard_normal(len(factors))
    presses = []
    for i, press in enumerate(exact.presses):
        rng = np.random.default_rng([case.seed, i])
        displacement = press.displacement.copy()
        sigma = noise_level(displacement[press.observed], case.snr_db)
        displacement[press.observed] += sigma * rng.standard_normal(int(press.observed.sum()))
        forces = factors[i] * press.forces
        presses.append(replace(press, forces=forces, displacement=displacement, noise_mm=sigma))
    mesh, material = exact.mesh, exact.material
    if case.fault == "depth":
        top = mesh.points.max(axis=0)
        mesh = TetMesh(top + (mesh.points - top) * [1.0, 1.0, WRONG_DEPTH], mesh.tets)
    elif case.fault == "poisson":
        material = replace(material, poisson=WRONG_POISSON)
    return Recording(mesh, tuple(presses), material)


@dataclass(frozen=True, eq=False)
class Truth:
    """The analytic object on voxels of the body's bounding box, those outside it excluded.

    Attributes:
        points: Centres of the n voxels within the body, (n, 3), mm.
        index: Their indices in the grid, (n, 3).
        size_mm: Edge lengths of a voxel.
        youngs: Young's modulus, (n,), MPa.
        lumps: Lump of each voxel, (n,): 0 for none, k for the k-th.
        lump_moduli_mpa: Young's modulus of each lump, MPa.
        lump_radii_mm: Radius of the ball of each lump's volume, mm.
        count: Voxels along each axis.
    """

    points: np.ndarray
    index: np.ndarray
    size_mm: np.ndarray
    youngs: np.ndarray
    lumps: np.ndarray
    lump_moduli_mpa: np.ndarray
    lump_radii_mm: np.ndarray
    count: int = field(default=VOXELS)

    @staticmethod
    def of(body: Body, count: int = VOXELS) -> "Truth":
        """Sample an object."""
        low, high = body.phantom.body.bounds()
        size = (high - low) / count
        index = np.indices((count,) * 3).reshape(3, -1).T
        points = low + (index + 0.5) * size
        inside = body.phantom.body.contains(points)
        points, index = points[inside], index[inside]
        lumps = [body.phantom.inclusions[k] for k in body.lumps]
        return Truth(
            points,
            index,
            size,
            body.phantom.youngs_at(points),
            body.lump_labels(points),
            np.array([modulus for _, modulus in lumps]),
            np.array([_radius(shape) for shape, _ in lumps]),
            count,
        )


def _radius(shape: Shape) -> float:
    """Radius of the ball of a shape's volume, by points in its bounding box, mm."""
    return float(np.cbrt(volume(shape) * 3.0 / (4.0 * np.pi)))


def _log(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
