"""Presses from files of displacements and forces at points: nodes, or any of the surface."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from tactorch.config import Options, option
from tactorch.config.registry import unknown_choice
from tactorch.errors import ConfigError, FileError, RecordingError
from tactorch.fem import MATERIALS
from tactorch.files import natural_key
from tactorch.importers.loads import consistent_loads, push_direction
from tactorch.mesh import TetMesh
from tactorch.mesh.closest import Closest, closest_points
from tactorch.mesh.sharp_edges import distance_from_sharp_edges
from tactorch.mesh.tetmesh import FaceName
from tactorch.recording import MaterialSpec, Press, Recording, SurfaceReading

_log = logging.getLogger(__name__)
_SAME_NODE = 1e-4  # distance of a point from a node that it is, over the diagonal
_MAX_DISTANCE = 0.02  # of a point from the surface, over the diagonal
_UNIT = 0.2  # of the length of a unit normal, which rounding and averaging change
_AT_EDGE = 1e-4  # distance of a point from an edge that it is on, over the diagonal
_SIDE = 1e-3  # distance of supported nodes from a side, over the diagonal


@dataclass(frozen=True, kw_only=True)
class PointOptions(Options):
    """Settings of formats of displacements and forces at points."""

    section: ClassVar[str] = "format"
    unit: Literal["mm", "cm", "m"] = option("mm", "Length unit of the mesh")
    support: FaceName | None = option(
        "z-", "Side of the bounding box that is held, where the files do not state it; null: none"
    )
    spring_n_per_mm: float | None = option(
        None, "Stiffness of springs at each node of that side; null: fixed", unit="N/mm", gt=0
    )
    noise_mm: float | None = option(
        None, "Standard deviation of the displacements, where the files do not state it", unit="mm",
        gt=0,
    )  # fmt: skip
    max_distance_mm: float | None = option(
        None, "Largest distance of a point from the surface; null: 2 % of the diagonal",
        unit="mm", gt=0,
    )  # fmt: skip
    material: str = option("neo_hookean", "Material of the object")
    poisson: float = option(0.45, "Poisson's ratio of the object", gt=0, lt=0.5)
    check_units: bool = option(True, "Refuse magnitudes that suggest a wrong unit")

    def record(
        self, mesh: TetMesh, presses: "list[PointData]", source: str | Path, importer: str
    ) -> Recording:
        """Return the recording of presses."""
        if self.material not in MATERIALS:
            raise ConfigError(unknown_choice("format.material", self.material, MATERIALS.names()))
        try:
            made = tuple(_press(data, mesh, self) for data in presses)
            return Recording(
                mesh,
                made,
                MaterialSpec(self.material, self.poisson),
                provenance={"importer": importer, "files": Path(source).name},
                check_units=self.check_units,
            )
        except RecordingError as error:
            raise RecordingError(f"'{source}': {error}") from error


@dataclass(frozen=True, eq=False, kw_only=True)
class PointData:
    """Displacements and forces of one press at k points; NaN where there are none.

    The arrays are the columns of `tactorch.importers.quantities` in mm, N and MPa; the nodes are
    counted from 0, and -1 where a point is given by its position. `where` returns the text that
    names a point in messages, such as "'a.csv' line 3".
    """

    name: str
    where: Callable[[int], str]
    nodes: Int[np.ndarray, " k"]
    points: Float[np.ndarray, "k 3"]
    displacement: Float[np.ndarray, "k 3"]
    along_normal: Float[np.ndarray, " k"]
    normals: Float[np.ndarray, "k 3"]
    forces: Float[np.ndarray, "k 3"]
    tractions: Float[np.ndarray, "k 3"]
    pressure: Float[np.ndarray, " k"]
    areas: Float[np.ndarray, " k"]
    noise: Float[np.ndarray, " k"]
    fixed: Float[np.ndarray, "k 3"] | None = None
    springs: Float[np.ndarray, "k 3"] | None = None
    step: int = 0

    def refuse(self, wrong: Bool[np.ndarray, " k"], fault: str) -> None:
        """Raise an error that names the first of the points that are wrong, and their fault."""
        if wrong.any():
            raise FileError(self.where(int(wrong.argmax())) + fault)

    def located(self, mesh: TetMesh, max_distance_mm: float) -> tuple["PointData", Closest]:
        """Return the data with nodes and positions, and the closest points of the surface."""
        beyond = self.nodes >= mesh.n_points
        self.refuse(
            beyond,
            f" names node {self.nodes[beyond.argmax()]}, but the mesh has {mesh.n_points} "
            f"(0 to {mesh.n_points - 1}); is it counted from 1, or of another mesh?",
        )
        placed = self.nodes >= 0
        self.refuse(
            ~placed & ~np.isfinite(self.points).all(axis=1),
            " has neither a node nor a position x, y, z; give one of them.",
        )
        points = np.where(placed[:, None], mesh.points[self.nodes], self.points)
        nearest_mm, nearest = cKDTree(mesh.points).query(points)
        nodes = np.where(nearest_mm < _SAME_NODE * mesh.diagonal, nearest, -1)
        nodes = np.where(placed, self.nodes, nodes)
        closest = closest_points(mesh.points, mesh.surface.triangles, points)
        far = (closest.distances > max_distance_mm) & (nodes < 0)
        if far.any():
            row = int(np.where(far, closest.distances, 0.0).argmax())
            place = ", ".join(f"{x:.4g}" for x in points[row])
            raise FileError(
                f"{self.where(row)}: the point ({place}) mm is {closest.distances[row]:.3g} mm "
                f"from the surface of the mesh, more than {max_distance_mm:.3g} mm, as {far.sum()} "
                f"of {len(far)} points are; check units and axes, or raise format.max_distance_mm."
            )
        order = np.flatnonzero((nodes >= 0) & self._nodal())
        order = order[np.argsort(nodes[order], kind="stable")]
        twice = np.flatnonzero(np.diff(nodes[order]) == 0)
        if len(twice):
            first, second = order[twice[0]], order[twice[0] + 1]
            raise FileError(
                f"{self.where(int(second))} has node {nodes[second]} of press '{self.name}' again, "
                f"after {self.where(int(first))}; remove one, or distinguish presses by a "
                "column 'press'."
            )
        normals = self._outward(mesh, nodes, closest)
        return replace(self, nodes=nodes, points=points, normals=normals), closest

    def _nodal(self) -> Bool[np.ndarray, " k"]:
        """Return whether there is more than a displacement along a normal."""
        parts = [self.displacement, self.forces, self.tractions, self.pressure[:, None]]
        parts += [values for values in (self.fixed, self.springs) if values is not None]
        return np.isfinite(np.column_stack(parts)).any(axis=1)

    def _outward(
        self, mesh: TetMesh, nodes: Int[np.ndarray, " k"], closest: Closest
    ) -> Float[np.ndarray, "k 3"]:
        """Return unit normals: those given, else those of the mesh."""
        surface = mesh.surface
        at_nodes, vectors = np.zeros((mesh.n_points, 3)), surface.areas[:, None] * surface.normals
        np.add.at(at_nodes, surface.triangles, vectors[:, None])
        normals = np.where(
            (nodes < 0)[:, None], surface.normals[closest.triangles], at_nodes[nodes]
        )
        given = np.isfinite(self.normals).all(axis=1)
        self._warn_at_edges(mesh, nodes, closest, given)
        lengths = np.linalg.norm(self.normals, axis=1)
        wrong = given & ~(np.abs(lengths - 1.0) < _UNIT)
        length = lengths[wrong.argmax()]
        self.refuse(wrong, f" has a normal of length {length:.3g}; give unit vectors.")
        normals = np.where(given[:, None], self.normals, normals)
        return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)

    def _warn_at_edges(
        self,
        mesh: TetMesh,
        nodes: Int[np.ndarray, " k"],
        closest: Closest,
        given: Bool[np.ndarray, " k"],
    ) -> None:
        """Warn of values along a normal at sharp edges of the mesh, where it is not unique."""
        along = np.nan_to_num(self.pressure) * np.nan_to_num(self.areas) != 0.0
        rows = np.flatnonzero((along | np.isfinite(self.along_normal)) & ~given)
        if not len(rows):
            return
        places = np.where((nodes >= 0)[:, None], mesh.points[nodes], closest.points)[rows]
        at_edge = rows[distance_from_sharp_edges(mesh)(places) < _AT_EDGE * mesh.diagonal]
        if len(at_edge):
            _log.warning(
                "%s and %d other points have a pressure or displacement along the normal at a sharp"
                " edge of the mesh, where the normal is not unique; give nx, ny and nz, or forces.",
                self.where(int(at_edge[0])), len(at_edge) - 1,
            )  # fmt: skip


def press_files(path: Path, suffixes: Sequence[str], kind: str) -> list[Path]:
    """Return a file, or the files with these suffixes in a folder, press2 before press10.

    `kind` names them in messages.
    """
    if not path.is_dir():
        if path.suffix.lower() not in suffixes:
            known = ", ".join(suffixes)
            raise FileError(f"'{path}' has the unknown suffix '{path.suffix}'; use one of {known}.")
        return [path]
    files = sorted((f for f in path.iterdir() if f.suffix.lower() in suffixes), key=natural_key)
    if not files:
        raise FileError(
            f"'{path}' contains no {kind} ({', '.join(suffixes)}); give one for each press."
        )
    return files


def _press(given: PointData, mesh: TetMesh, options: PointOptions) -> Press:
    reach = options.max_distance_mm or _MAX_DISTANCE * mesh.diagonal
    data, closest = given.located(mesh, reach)
    at_node = data.nodes >= 0
    displacement = np.full((mesh.n_points, 3), np.nan)
    rows, axes = np.nonzero(at_node[:, None] & np.isfinite(data.displacement))
    displacement[data.nodes[rows], axes] = data.displacement[rows, axes]
    forces = _forces(data, mesh, closest)
    fixed, springs = _supports(data, mesh, options)
    noise = np.where(np.isfinite(data.noise), data.noise, options.noise_mm or np.nan)
    return Press(
        forces,
        np.isfinite(displacement),
        displacement,
        fixed=fixed,
        springs=springs,
        noise_mm=_one_noise(data, noise, at_node & np.isfinite(data.displacement).any(axis=1)),
        direction=push_direction(forces),
        name=data.name,
        step=data.step,
        surface=_readings(data, at_node, noise),
    )


def _readings(
    data: PointData, at_node: Bool[np.ndarray, " k"], noise: Float[np.ndarray, " k"]
) -> SurfaceReading | None:
    """Return displacements along normals, and components at points that are no nodes."""
    components = np.isfinite(data.displacement) & ~at_node[:, None]
    rows, axes = np.nonzero(components)
    along = np.flatnonzero(np.isfinite(data.along_normal))
    every = np.concatenate([rows, along])
    if not len(every):
        return None
    unknown = (components.any(axis=1) | np.isfinite(data.along_normal)) & ~(noise > 0.0)
    data.refuse(
        unknown,
        ": a displacement at a point that is no node, or along a normal, needs its noise; give "
        "format.noise_mm, or a column 'noise'.",
    )
    return SurfaceReading(
        data.points[every],
        np.concatenate([np.eye(3)[axes], data.normals[along]]),
        np.concatenate([data.displacement[rows, axes], data.along_normal[along]]),
        noise[every],
    )


def _forces(data: PointData, mesh: TetMesh, closest: Closest) -> Float[np.ndarray, "n 3"]:
    """Return the nodal forces, N.

    A force at a point is divided by its barycentric coordinates among the nodes of the triangle,
    which is consistent with linear elements.
    """
    at_node, by_area = data.nodes >= 0, np.isfinite(data.areas)
    tractions, pressure = np.nan_to_num(data.tractions), np.nan_to_num(data.pressure)
    bare = (tractions.any(axis=1) | (pressure != 0.0)) & ~by_area
    data.refuse(
        bare & ~at_node,
        ": a traction or pressure at a point that is no node needs a column 'area'; give it, or "
        "forces.",
    )
    stresses = tractions - pressure[:, None] * data.normals
    at_points = np.nan_to_num(data.forces) + np.nan_to_num(data.areas)[:, None] * stresses
    forces = np.zeros((mesh.n_points, 3))
    np.add.at(forces, data.nodes[at_node], at_points[at_node])
    corners = mesh.surface.triangles[closest.triangles[~at_node]]
    shares = closest.barycentric[~at_node, :, None] * at_points[~at_node, None, :]
    np.add.at(forces, corners, shares)
    if bare.any():
        nodes, triangles = data.nodes[bare], mesh.surface.triangles
        field, scalar = np.zeros((mesh.n_points, 3)), np.zeros(mesh.n_points)
        field[nodes], scalar[nodes] = tractions[bare], pressure[bare]
        forces += consistent_loads(mesh.points, triangles, field)
        forces += consistent_loads(mesh.points, triangles, scalar)
    return forces


def _supports(
    data: PointData, mesh: TetMesh, options: PointOptions
) -> tuple[Bool[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    fixed, springs = np.zeros((mesh.n_points, 3), dtype=bool), np.zeros((mesh.n_points, 3))
    at_node = data.nodes >= 0
    given = [np.nan_to_num(v) for v in (data.fixed, data.springs) if v is not None]
    if given:
        data.refuse(
            ~at_node & np.hstack(given).any(axis=1),
            " is fixed or on springs, but is no node of the mesh; state supports at nodes.",
        )
        nodes = data.nodes[at_node]
        if data.fixed is not None:
            np.logical_or.at(fixed, nodes, np.nan_to_num(data.fixed[at_node]) != 0.0)
        if data.springs is not None:
            np.add.at(springs, nodes, np.nan_to_num(data.springs[at_node]))
        return fixed, springs
    if options.support is not None:
        axis, high = "xyz".index(options.support[0]), int(options.support[1] == "+")
        height = np.abs(mesh.points[:, axis] - mesh.bounds[high, axis])
        held = height < _SIDE * mesh.diagonal
        if options.spring_n_per_mm is None:
            fixed[held] = True
        else:
            springs[held] = options.spring_n_per_mm
    return fixed, springs


def _one_noise(
    data: PointData, noise: Float[np.ndarray, " k"], rows: Bool[np.ndarray, " k"]
) -> float | None:
    """Return the noise of the displacements of nodes, which is the same for all."""
    known = noise[rows]
    if not len(known) or np.isnan(known).all():
        return None
    data.refuse(
        rows & ~np.isclose(noise, known[0], rtol=1e-6),
        f": the noise at nodes differs within press '{data.name}'; give one value for each press.",
    )
    return float(known[0])
