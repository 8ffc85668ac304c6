"""Meshes and surfaces in files (through meshio), in mm inside and any unit outside."""

import contextlib
import importlib
import io
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import NDArray

from tactorch.errors import FileError, MeshError
from tactorch.files import atomic_path, require_file
from tactorch.mesh.checks import as_cells, as_points, listing, unreferenced
from tactorch.mesh.geometry import bounding_box
from tactorch.mesh.obj import read_obj
from tactorch.mesh.tetmesh import TetMesh, compact
from tactorch.mesh.units import mm_per, warn_of_units
from tactorch.mesh.values import Rows

if TYPE_CHECKING:
    import meshio

# meshio's modules by file suffix. Its own dispatcher guesses ANSYS for .msh and ends the process
# on a damaged file, so the modules are called directly.
_MESH_FORMATS = {".msh": "gmsh", ".vtu": "vtu", ".inp": "abaqus"}
_SURFACE_FORMATS = {".stl": "stl", ".obj": "obj", ".ply": "ply"}


def read_mesh(path: str | Path, unit: str = "mm", *, drop_unreferenced: bool = False) -> TetMesh:
    """Read a tetrahedral mesh from .msh (gmsh), .vtu or .inp (Abaqus, CalculiX).

    Nodes and tetrahedra keep the order of the file, because other files refer to them by index.
    Points, lines and surface cells are passed over; inverted tetrahedra are reoriented.

    Args:
        path: The file.
        unit: Length unit of the file: "mm", "cm" or "m".
        drop_unreferenced: Drop nodes that no tetrahedron uses, which renumbers the others.

    Returns:
        The mesh, in mm.

    Raises:
        FileError: The file is missing, damaged or of an unknown format.
        MeshError: The file holds no linear tetrahedra, other solid elements too, unreferenced
            nodes, or a mesh that cannot be used. Every message names the file.
        ConfigError: The unit is unknown.

    Warns:
        UserWarning: The object is implausibly small or large; the likely unit is named.
    """
    scale = mm_per(unit)
    source = require_file(path, "Mesh")
    content = _read(source, _MESH_FORMATS)
    with _naming(source):
        points = as_points(content.points) * scale
        tets = as_cells(_solid_cells(content), 4, len(points))
        bad = unreferenced(len(points), tets)
        if bad.size and not drop_unreferenced:
            raise MeshError(
                f"no tetrahedron uses {listing(bad, len(points), 'nodes')}."
                " Remove them from the file, or read it with drop_unreferenced=True, which"
                " renumbers the others."
            )
        if bad.size:
            points, tets, _ = compact(points, tets)
        mesh = TetMesh.create(points, tets)
    warn_of_units(f"Mesh '{source}'", mesh.diagonal, unit)
    return mesh


def write_mesh(
    path: str | Path,
    mesh: TetMesh,
    cell_data: Mapping[str, Rows] | None = None,
    point_data: Mapping[str, Rows] | None = None,
) -> None:
    """Write a mesh, in mm, to .msh (gmsh 4.1), .vtu (ParaView) or .inp (Abaqus, CalculiX).

    Args:
        path: The file; it is replaced whole or not at all.
        mesh: The mesh.
        cell_data: Fields of m values (or m rows), such as Young's modulus; not for .inp.
        point_data: Fields of n values (or n rows), such as displacement; not for .inp.

    Raises:
        FileError: The format is unknown, cannot hold data, or the file cannot be written.
        MeshError: A field does not fit the mesh.
    """
    target = Path(path)
    cells = _fields("cell_data", cell_data, mesh.n_tets)
    nodes = _fields("point_data", point_data, mesh.n_points)
    name = _format(target, _MESH_FORMATS)
    if name == "abaqus" and (cells or nodes):
        raise FileError(f"'{target}': .inp files cannot hold fields; write .vtu or .msh instead.")
    import meshio

    content = meshio.Mesh(
        np.array(mesh.points),
        [("tetra", np.array(mesh.tets))],
        point_data=nodes,
        cell_data={key: [values] for key, values in cells.items()},
    )
    _write(target, name, content)


def read_surface(
    path: str | Path, unit: str = "mm"
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "k 3"]]:
    """Read a triangle surface from .stl, .obj or .ply.

    Vertices with equal coordinates are merged, as STL stores each triangle apart; quadrangles are
    halved. The order of vertices is that of the file.

    Args:
        path: The file.
        unit: Length unit of the file: "mm", "cm" or "m".

    Returns:
        Vertices in mm and triangles, ready for `tetrahedralize`.

    Raises:
        FileError: The file is missing, damaged or of an unknown format.
        MeshError: The file holds no triangles, polygons of more than four sides, or coordinates
            that are not finite. Every message names the file.
        ConfigError: The unit is unknown.

    Warns:
        UserWarning: The object is implausibly small or large; the likely unit is named.
    """
    scale = mm_per(unit)
    source = require_file(path, "Surface")
    content = _read(source, _SURFACE_FORMATS)
    with _naming(source):
        vertices, triangles = _merged(as_points(content.points, "vertices"), _triangles(content))
    corners = bounding_box(vertices) * scale
    diagonal = float(np.linalg.norm(corners[1] - corners[0]))
    warn_of_units(f"Surface '{source}'", diagonal, unit)
    return vertices * scale, triangles


def write_surface(path: str | Path, vertices: Rows, triangles: Rows) -> None:
    """Write a triangle surface, in mm, to .stl, .obj or .ply, whole or not at all.

    Raises:
        FileError: The format is unknown or the file cannot be written.
        MeshError: The arrays are no surface.
    """
    target = Path(path)
    name = _format(target, _SURFACE_FORMATS)
    points = as_points(vertices, "vertices")
    faces = as_cells(triangles, 3, len(points), "triangles")
    import meshio

    _write(target, name, meshio.Mesh(points, [("triangle", faces.astype(np.int32))]))


def _format(path: Path, formats: Mapping[str, str]) -> str:
    suffix = path.suffix.lower()
    if suffix not in formats:
        raise FileError(
            f"'{path}' has the unknown suffix '{suffix}'; use one of {', '.join(formats)}."
        )
    return formats[suffix]


def _read(path: Path, formats: Mapping[str, str]) -> "meshio.Mesh":
    name = _format(path, formats)
    with _quiet() as said:
        try:
            content = _read_as(name, path)
        # meshio's readers raise whatever they stumble over, and may call sys.exit.
        except (Exception, SystemExit) as error:
            reason = " ".join(f"{said.getvalue()} {error}".split()) or type(error).__name__
            raise FileError(
                f"'{path}' cannot be read as {name}: {reason}. Is the file whole, and of the format"
                " its suffix says?"
            ) from error
    if not len(content.points):
        raise FileError(f"'{path}' holds no points: it is empty, or not of the {name} format.")
    return content


def _read_as(name: str, path: Path) -> "meshio.Mesh":
    import meshio

    if name == "obj":
        return meshio.Mesh(*read_obj(path))
    return importlib.import_module(f"meshio.{name}").read(str(path))


def _write(path: Path, name: str, content: "meshio.Mesh") -> None:
    options = {"binary": True} if name == "stl" else {}
    with _quiet() as said:
        try:
            with atomic_path(path) as temporary:
                importlib.import_module(f"meshio.{name}").write(str(temporary), content, **options)
        except FileError:
            raise
        except (Exception, SystemExit) as error:
            reason = " ".join(f"{said.getvalue()} {error}".split()) or type(error).__name__
            raise FileError(f"'{path}' cannot be written as {name}: {reason}.") from error


@contextlib.contextmanager
def _quiet() -> Iterator[io.StringIO]:
    """Keep meshio's remarks off the terminal."""
    said = io.StringIO()
    with (
        contextlib.redirect_stdout(said),
        contextlib.redirect_stderr(said),
        warnings.catch_warnings(),
    ):
        warnings.simplefilter("ignore")
        yield said


@contextlib.contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Name the file in every `MeshError` raised inside."""
    try:
        yield
    except MeshError as error:
        raise MeshError(f"'{path}': {error}") from error


def _solid_cells(content: "meshio.Mesh") -> NDArray:
    tets = [block.data for block in content.cells if block.type == "tetra" and len(block.data)]
    solid = {b.type for b in content.cells if b.dim == 3 and b.type != "tetra"}
    others = ", ".join(sorted(solid))
    if others:
        raise MeshError(f"it holds solid elements other than 4-node tetrahedra: {others}.")
    if not tets:
        held = ", ".join(sorted({b.type for b in content.cells})) or "no cells at all"
        raise MeshError(
            f"it holds no tetrahedra, only {held}. If it is a surface, fill it with tetrahedralize."
        )
    return np.concatenate(tets)


def _triangles(content: "meshio.Mesh") -> NDArray:
    found: list[NDArray] = []
    for block in content.cells:
        if block.type == "triangle":
            found.append(block.data)
        elif block.type == "quad":
            # Both halves of a quadrangle side by side keep the order of the file.
            found.append(block.data[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3))
        elif block.dim == 2:
            raise MeshError(f"it holds faces other than triangles and quadrangles: {block.type}.")
    if not found:
        raise MeshError("it holds no triangles.")
    return np.concatenate(found)


def _merged(
    vertices: Float[np.ndarray, "n 3"], triangles: NDArray
) -> tuple[Float[np.ndarray, "r 3"], Int[np.ndarray, "k 3"]]:
    """Merge vertices that coincide exactly, and drop those that no triangle uses."""
    faces = as_cells(triangles, 3, len(vertices), "triangles")
    _, first, same = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
    points, cells, _ = compact(vertices, first[same.reshape(-1)][faces])
    return points, cells


def _fields(what: str, data: Mapping[str, Rows] | None, rows: int) -> dict[str, NDArray]:
    fields: dict[str, Any] = {}
    for name, values in (data or {}).items():
        array = np.asarray(values)
        if array.ndim not in (1, 2) or len(array) != rows or array.dtype.kind not in "bfiu":
            raise MeshError(
                f"{what} '{name}' must hold {rows} rows of numbers, not shape {array.shape}"
                f" of {array.dtype}."
            )
        # No format stores truth values; float16 and the like neither.
        fields[name] = array.astype(np.int32 if array.dtype.kind == "b" else np.float64)
    return fields
