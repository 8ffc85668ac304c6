"""Displacements and forces as fields of VTK files: .vtu, .vtk or .vtp, one for each press.

Fields are values at points: nodes of the mesh of the object or any other points of its surface.
Displacement is required, and force (N), traction (MPa) or pressure (MPa). The points are those of
the unloaded object. Of a file of tetrahedra the points of its boundary are read. NaN marks what was
not measured. Files in which nothing moves and nothing acts, such as the first of a series, are left
out.
"""

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float, Int

from tactorch.config import option
from tactorch.errors import FileError
from tactorch.importers.loads import consistent_loads
from tactorch.importers.points import PointData, PointOptions, press_files
from tactorch.importers.quantities import UNITS
from tactorch.importers.vtk_files import SUFFIXES, VtkFile, read_vtk
from tactorch.mesh import TetMesh, compact, read_mesh
from tactorch.mesh.closest import closest_points
from tactorch.mesh.geometry import area_vectors
from tactorch.mesh.io import naming
from tactorch.recording import Recording

_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class VtkOptions(PointOptions):
    """Read fields of displacement and force from VTK files (see the module's docstring)."""

    mesh: Path | None = option(
        None, "Mesh of the object at rest; null: the tetrahedra of the first file"
    )
    displacement: str | None = option(None, "Field of the displacement; null: by its name")
    force: str | None = option(None, "Field of the nodal force; null: by its name")
    traction: str | None = option(None, "Field of the traction; null: by its name")
    pressure: str | None = option(None, "Field of the pressure; null: by its name")
    file_unit: Literal["mm", "cm", "m"] | None = option(
        None, "Length unit of points and displacements; null: that of the mesh"
    )
    force_unit: Literal["N", "mN", "kN"] = option("N", "Unit of the force")
    stress_unit: Literal["MPa", "kPa", "Pa"] = option("MPa", "Unit of traction and pressure")
    deformed: bool = option(False, "Points of the files are displaced, which is subtracted")

    def __call__(self, *, path: str | Path) -> Recording:
        """Read a file or a folder; see `import_vtk`."""
        files = [read_vtk(file) for file in _files(Path(path))]
        if self.mesh is not None:
            mesh = read_mesh(self.mesh, self.unit, drop_unreferenced=False)
        else:
            mesh = self._rest(files[0])
            if not files[0].fields:
                files = files[1:]
        read = [self._read(file, mesh) for file in files]
        presses = [data for data in read if data is not None]
        if not presses:
            raise FileError(f"'{path}' has no file in which something moves and acts.")
        return self.record(mesh, presses, path, "vtk")

    @property
    def _scale(self) -> float:
        return UNITS["x"][self.file_unit or self.unit]

    def _rest(self, file: VtkFile) -> TetMesh:
        """Return the mesh of the first file."""
        if not len(file.tets):
            raise FileError(
                f"'{file.path}' has no tetrahedra; give the mesh of the object by format.mesh."
            )
        return _mesh_of(file, self._points(file))[0]

    def _points(self, file: VtkFile) -> Float[np.ndarray, "n 3"]:
        """Return the rest positions, mm."""
        points = self._scale * file.points
        if self.deformed:
            displacement = file.field("displacement", self.displacement, 3)
            points = points - self._scale * (0.0 if displacement is None else displacement)
        if not np.isfinite(points).all():
            raise FileError(
                f"'{file.path}' has points whose displacement is not known, with"
                " format.deformed=true; give the points of the unloaded object."
            )
        return points

    def _read(self, file: VtkFile, mesh: TetMesh) -> PointData | None:
        """Return the press of a file; None where nothing moves and acts."""
        displacement = file.field("displacement", self.displacement, 3)
        force = file.field("force", self.force, 3)
        traction = file.field("traction", self.traction, 3)
        pressure = file.field("pressure", self.pressure, 1)
        loads = {"force": force, "traction": traction, "pressure": pressure}
        given = [values for values in loads.values() if values is not None]
        if displacement is None or not given:
            lacking = ("displacement",) if displacement is None else loads
            raise FileError(
                f"'{file.path}' has no field that is recognised as {' or '.join(lacking)}; "
                f"{file.listing()} Choose one by {' or '.join(f'format.{w}' for w in lacking)}."
            )
        if not any(np.nan_to_num(values).any() for values in (displacement, *given)):
            _log.info("'%s' is left out: nothing moves and nothing acts.", file.path)
            return None
        for name, values in (("displacement", displacement), ("load", np.column_stack(given))):
            if np.isinf(values).any():
                row = int(np.isinf(values).any(axis=1).argmax())
                raise FileError(f"'{file.path}' point {row} has an infinite {name}; repair it.")
        points = self._points(file)
        triangles = _outward(points, _boundary(file, points), mesh)
        _, first, same = np.unique(points, axis=0, return_index=True, return_inverse=True)
        same, merged = first[same.ravel()], np.zeros_like(points)
        _check_repeated(same, {"displacement": displacement, "force": force}, file)
        scale = UNITS["p"][self.stress_unit.lower()]
        stresses = [scale * values for values in (traction, pressure) if values is not None]
        if stresses and not len(triangles):
            raise FileError(
                f"'{file.path}' has no triangles that traction or pressure act on; give a surface, "
                "or forces."
            )
        for values in stresses:
            acting = consistent_loads(points, triangles, np.nan_to_num(values), same)
            np.add.at(merged, same, acting)
        if force is not None:
            merged[first] += UNITS["fx"][self.force_unit.lower()] * np.nan_to_num(force[first])
        if len(file.tets):
            used = np.union1d(triangles, np.flatnonzero(merged.any(axis=1)))
            first = np.intersect1d(first, used)
        kept = np.sort(first)
        count, nowhere = len(kept), np.full(len(kept), np.nan)
        return PointData(
            name=file.path.stem,
            where=lambda row: f"'{file.path}' point {kept[row]}",
            nodes=np.full(count, -1),
            points=points[kept],
            displacement=self._scale * displacement[kept],
            along_normal=nowhere,
            normals=np.full((count, 3), np.nan),
            forces=merged[kept],
            tractions=np.full((count, 3), np.nan),
            pressure=nowhere,
            areas=nowhere,
            noise=nowhere,
        )


def import_vtk(path: str | Path, **options: Any) -> Recording:
    """Read fields of displacement and force from VTK files (see the module's docstring).

    Args:
        path: File, or folder of files in the order of their names.
        options: Settings, see `VtkOptions`.

    Returns:
        A recording with a press for each file, named by it.

    Raises:
        ConfigError: A setting is not valid.
        FileError: A file cannot be used; names file, field or point, and remedy.
        MeshError: The mesh cannot be used.
        RecordingError: The files do not make a valid recording.
    """
    return VtkOptions(**options)(path=path)


def _files(path: Path) -> list[Path]:
    files = press_files(path, SUFFIXES, "file")
    stems = [file.stem for file in files]
    twice = next((stem for stem in stems if stems.count(stem) > 1), None)
    if twice is not None:
        raise FileError(f"'{path}' has two files of the press '{twice}'; rename one.")
    return files


def _mesh_of(
    file: VtkFile, points: Float[np.ndarray, "n 3"]
) -> tuple[TetMesh, Int[np.ndarray, " used"]]:
    """Return the mesh of the tetrahedra of a file, and the points that are its nodes."""
    nodes, tets, used = compact(points, file.tets)
    with naming(file.path):
        return TetMesh.create(nodes, tets), used


def _boundary(file: VtkFile, points: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, "k 3"]:
    """Return the outward boundary triangles of tetrahedra, else the triangles of the file."""
    if not len(file.tets):
        return file.triangles
    mesh, used = _mesh_of(file, points)
    return used[mesh.surface.triangles]


def _check_repeated(
    same: Int[np.ndarray, " n"], fields: dict[str, np.ndarray | None], file: VtkFile
) -> None:
    """Refuse repeated points whose values differ; `same` is the first at the position of each.

    Filters repeat points where normals differ, and copy their values: the force acts once.
    """
    for name, values in fields.items():
        if values is None:
            continue
        unlike = ~np.isclose(values, values[same], rtol=0.0, atol=0.0, equal_nan=True)
        if unlike.any():
            row = int(unlike.any(axis=1).argmax())
            raise FileError(
                f"'{file.path}' point {row} is at the position of point {same[row]}, but has "
                f"another {name}; merge them."
            )


def _outward(
    points: Float[np.ndarray, "n 3"], triangles: Int[np.ndarray, "k 3"], mesh: TetMesh
) -> Int[np.ndarray, "k 3"]:
    """Return the triangles, those turned whose normal is opposite to that of the mesh nearby."""
    if not len(triangles):
        return triangles
    surface = mesh.surface
    nearby = closest_points(mesh.points, surface.triangles, points[triangles].mean(axis=1))
    along = (area_vectors(points, triangles) * surface.normals[nearby.triangles]).sum(axis=1)
    return np.where((along < 0.0)[:, None], triangles[:, ::-1], triangles)
