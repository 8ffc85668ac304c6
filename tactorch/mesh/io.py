"""Reading and writing meshes and surfaces (through meshio); lengths are converted to mm."""

import contextlib
import importlib
import io
import re
import struct
import warnings
from collections.abc import Iterator, Mapping
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tactorch.errors import ConfigError, FileError, MeshError
from tactorch.files import atomic_path, require_file
from tactorch.mesh.checks import as_cells, as_points, listing, unreferenced
from tactorch.mesh.geometry import bounding_diagonal
from tactorch.mesh.tetmesh import TetMesh, compact
from tactorch.mesh.values import Points, Rows, Triangles

if TYPE_CHECKING:
    import meshio

# meshio's modules by file suffix. Its own dispatcher guesses ANSYS for .msh and ends the process
# on a damaged file, so the modules are called directly.
_MESH_FORMATS = {".msh": "gmsh", ".vtu": "vtu", ".inp": "abaqus"}
_SURFACE_FORMATS = {".stl": "stl", ".obj": "obj", ".ply": "ply"}
#: Suffixes of files that `write_mesh` writes.
MESH_SUFFIXES = tuple(_MESH_FORMATS)
#: Name of the regions in the cell data of a file.
REGION = "region"
_MM_PER_UNIT = {"mm": 1.0, "cm": 10.0, "m": 1000.0}
#: Bounding-box diagonals between which an object pressed by hand or robot is plausible, mm.
PLAUSIBLE_MM = (0.5, 5000.0)


def read_mesh(path: str | Path, unit: str = "mm", *, drop_unreferenced: bool = False) -> TetMesh:
    """Return the tetrahedral mesh (mm) of a .msh (gmsh), .vtu or .inp (Abaqus, CalculiX) file.

    Nodes and tetrahedra keep the order of the file, because other files refer to them by index.
    Points, lines and surface cells are ignored; inverted tetrahedra are reoriented. A warning names
    the likely unit of an object that is implausibly small or large. The regions are those of the
    cell data `region`, or else the physical groups of gmsh.

    Args:
        path: Path of the file.
        unit: Length unit of the file: "mm", "cm" or "m".
        drop_unreferenced: Whether to drop nodes that no tetrahedron uses, which renumbers the
            others.
    """
    scale, source = _mm_per(unit), require_file(path, "Mesh")
    content = read_any(source, _MESH_FORMATS)
    with naming(source):
        points = as_points(content.points) * scale
        tets = as_cells(_solid_cells(content), 4, len(points))
        unused = unreferenced(len(points), tets)
        if unused.any() and not drop_unreferenced:
            raise MeshError(
                f"no tetrahedron uses {listing(unused, 'nodes')}."
                " Remove them from the file, or read it with drop_unreferenced=True, which"
                " renumbers the others."
            )
        points, tets, _ = compact(points, tets)
        mesh = TetMesh.create(points, tets, regions=_regions(content))
    _warn_of_unit(f"Mesh '{source}'", mesh.diagonal, unit)
    return mesh


def write_mesh(
    path: str | Path,
    mesh: TetMesh,
    cell_data: Mapping[str, Rows] | None = None,
    point_data: Mapping[str, Rows] | None = None,
) -> None:
    """Write a mesh, in mm, to .msh (gmsh 4.1), .vtu (ParaView) or .inp (Abaqus, CalculiX).

    Args:
        path: Path of the file; it is replaced atomically.
        mesh: Mesh to write.
        cell_data: Fields of m values or m rows, such as Young's modulus; not for .inp. The regions
            of the mesh are the field `region`; .inp files do not have them.
        point_data: Fields of n values or n rows, such as displacement; not for .inp.
    """
    cells = _fields("cell_data", cell_data, mesh.n_tets)
    nodes = _fields("point_data", point_data, mesh.n_points)
    name = _format(path, _MESH_FORMATS)
    if name == "abaqus" and (cells or nodes):
        raise FileError(f"'{path}': .inp files cannot hold fields; write .vtu or .msh instead.")
    import meshio

    tets = [("tetra", np.array(mesh.tets))]
    data = {field: [values] for field, values in cells.items()}
    if mesh.regions is not None and name != "abaqus":
        data[REGION] = [np.array(mesh.regions, dtype=np.float64 if name == "gmsh" else np.int64)]
    _write(path, _MESH_FORMATS, meshio.Mesh(np.array(mesh.points), tets, nodes, data))


def read_surface(path: str | Path, unit: str = "mm") -> tuple[Points, Triangles]:
    """Return vertices (mm) and triangles of the surface in a .stl, .obj or .ply file.

    Vertices with equal coordinates are merged, as STL stores the vertices of each triangle
    separately; triangles that become points or lines are dropped, and quadrangles are halved.
    Vertices keep the order of the file. See `read_mesh` for the
    unit.
    """
    scale, source = _mm_per(unit), require_file(path, "Surface")
    content = read_any(source, _SURFACE_FORMATS)
    with naming(source):
        vertices = as_points(content.points, "vertices")
        # The reader of STL files merges vertices, so that triangles may have become lines already.
        faces = as_cells(_without_lines(_triangles(content)), 3, len(vertices), "triangles")
        _, first, same = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
        merged = _without_lines(first[same.reshape(-1)][faces])
        vertices, triangles, _ = compact(vertices, merged)
    _warn_of_unit(f"Surface '{source}'", bounding_diagonal(vertices) * scale, unit)
    return vertices * scale, triangles


def _without_lines(triangles: NDArray) -> NDArray:
    """Return the triangles that repeat no vertex."""
    repeats = (np.diff(np.sort(triangles, axis=1), axis=1) == 0).any(axis=1)
    if repeats.all():
        raise MeshError("all its triangles are points or lines.")
    return triangles[~repeats]


def write_surface(path: str | Path, vertices: Rows, triangles: Rows) -> None:
    """Write a triangle surface, in mm, to .stl, .obj or .ply; the file is replaced atomically."""
    points = as_points(vertices, "vertices")
    faces = as_cells(triangles, 3, len(points), "triangles").astype(np.int32)
    import meshio

    _write(path, _SURFACE_FORMATS, meshio.Mesh(points, [("triangle", faces)]))


def _format(path: str | Path, formats: Mapping[str, str]) -> str:
    suffix = Path(path).suffix.lower()
    if suffix not in formats:
        raise FileError(
            f"'{path}' has the unknown suffix '{suffix}'; use one of {', '.join(formats)}."
        )
    return formats[suffix]


def read_any(path: Path, formats: Mapping[str, str]) -> "meshio.Mesh":
    """Return the content of a file, with meshio's module for its suffix.

    Raises:
        FileError: The suffix is unknown, or the file is damaged or has no points.
    """
    name = _format(path, formats)
    hint = " Is the file complete, and of the format its suffix says?"
    with _meshio(f"'{path}' cannot be read as {name}", hint):
        import meshio

        _check_header(path, name)
        if name == "obj":
            content = meshio.Mesh(*_read_obj(path))
        elif name == "ply":  # meshio knows one of the two names that files have
            text = path.read_bytes().replace(b" vertex_index\n", b" vertex_indices\n", 1)
            content = meshio.ply.read(io.BytesIO(text))
        else:
            content = importlib.import_module(f"meshio.{name}").read(str(path))
    if not len(content.points):
        raise FileError(f"'{path}' contains no points: it is empty, or not of the {name} format.")
    return content


def _check_header(path: Path, name: str) -> None:
    """Refuse damaged headers that meshio would read without end or with excessive memory."""
    if name == "ply" and not re.search(rb"^end_header\s*?$", path.read_bytes(), re.MULTILINE):
        raise ValueError("the header has no end")
    if name == "gmsh":
        content = path.read_bytes()
        start = content.find(b"$Nodes\n") + len(b"$Nodes\n")
        if not re.match(rb"\$MeshFormat\s+4\.1 1 8\s", content) or start < len(b"$Nodes\n"):
            return
        blocks, *_ = struct.unpack_from("=4Q", content, start)
        start += 32
        for _ in range(blocks):
            (nodes,) = struct.unpack_from("=Q", content, start + 12)
            tags = np.frombuffer(content, np.uint64, nodes, start + 20)
            if tags.size and int(tags.max()) > len(content):  # meshio makes an array of this size
                raise ValueError(f"there is no node {tags.max()}")
            start += 20 + 32 * nodes


def _write(path: str | Path, formats: Mapping[str, str], content: "meshio.Mesh") -> None:
    name = _format(path, formats)
    options = {"binary": True} if name == "stl" else {}
    writer = importlib.import_module(f"meshio.{name}")
    with _meshio(f"'{path}' cannot be written as {name}"), atomic_path(path) as temporary:
        writer.write(str(temporary), content, **options)


@contextlib.contextmanager
def _meshio(failure: str, hint: str = "") -> Iterator[None]:
    """Silence meshio and turn its failures into `FileError`.

    Its readers raise any exception on damaged files, and may call sys.exit.
    """
    output = io.StringIO()
    try:
        with (
            contextlib.redirect_stdout(output),
            contextlib.redirect_stderr(output),
            warnings.catch_warnings(),
        ):
            warnings.simplefilter("ignore")
            yield
    except FileError:
        raise
    except (Exception, SystemExit) as error:
        reason = " ".join(f"{output.getvalue()} {error}".split()) or type(error).__name__
        raise FileError(f"{failure}: {reason}.{hint}") from error


@contextlib.contextmanager
def naming(path: str | Path) -> Iterator[None]:
    """Name the file in every `MeshError` raised inside."""
    try:
        yield
    except MeshError as error:
        raise MeshError(f"'{path}': {error}") from error


def _solid_cells(content: "meshio.Mesh") -> NDArray:
    tets = [block.data for block in content.cells if block.type == "tetra" and len(block.data)]
    solid = sorted({b.type for b in content.cells if b.dim == 3 and b.type != "tetra"})
    if solid:
        raise MeshError(
            f"it contains solid elements other than 4-node tetrahedra: {', '.join(solid)}."
        )
    if not tets:
        types = ", ".join(sorted({b.type for b in content.cells})) or "no cells"
        raise MeshError(
            f"it contains no tetrahedra, only {types}. If it is a surface, mesh it with"
            " tetrahedralize."
        )
    return np.concatenate(tets)


def _regions(content: "meshio.Mesh") -> NDArray | None:
    """Return the region number of each tetrahedron; None where the file has none."""
    name = next((name for name in (REGION, "gmsh:physical") if name in content.cell_data), None)
    if name is None:
        return None
    pairs = zip(content.cells, content.cell_data[name], strict=True)
    return np.concatenate([data for block, data in pairs if block.type == "tetra"])


def _triangles(content: "meshio.Mesh") -> NDArray:
    # Consecutive halves of a quadrangle keep the order of the file.
    columns = {"triangle": [0, 1, 2], "quad": [0, 1, 2, 0, 2, 3]}
    faces = [block for block in content.cells if block.dim == 2]
    others = [block.type for block in faces if block.type not in columns]
    if others:
        raise MeshError(f"it contains faces other than triangles and quadrangles: {others[0]}.")
    triangles = [block.data[:, columns[block.type]].reshape(-1, 3) for block in faces]
    if not triangles:
        raise MeshError("it contains no triangles.")
    return np.concatenate(triangles)


def _fields(what: str, data: Mapping[str, Rows] | None, rows: int) -> dict[str, NDArray]:
    fields: dict[str, Any] = {}
    for name, values in (data or {}).items():
        array = np.asarray(values)
        if array.ndim not in (1, 2) or len(array) != rows or array.dtype.kind not in "bfiu":
            raise MeshError(
                f"{what} '{name}' must have {rows} rows of numbers, not shape {array.shape}"
                f" of {array.dtype}."
            )
        # No format stores booleans or half precision.
        fields[name] = array.astype(np.int32 if array.dtype.kind == "b" else np.float64)
    return fields


def _mm_per(unit: str) -> float:
    if unit not in _MM_PER_UNIT:
        raise ConfigError(f"Unknown length unit '{unit}'; choose one of {', '.join(_MM_PER_UNIT)}.")
    return _MM_PER_UNIT[unit]


def _warn_of_unit(what: str, diagonal_mm: float, unit: str) -> None:
    low, high = PLAUSIBLE_MM
    if low <= diagonal_mm <= high:
        return
    number = diagonal_mm / _MM_PER_UNIT[unit]
    likely = [u for u, mm in _MM_PER_UNIT.items() if low <= number * mm <= high]
    hint = " or ".join(f"unit='{u}' ({number * _MM_PER_UNIT[u]:.4g} mm)" for u in likely)
    advice = f"Is it {hint}?" if hint else "Check the unit and scale of the file."
    warnings.warn(
        f"{what} is {diagonal_mm:.4g} mm across when read in {unit}: implausible. {advice}",
        UserWarning,
        stacklevel=3,
    )


def _read_obj(path: Path) -> tuple[Points, list[tuple[str, NDArray]]]:
    """Read vertices and runs of faces of one kind of a Wavefront .obj file, in its order.

    meshio refuses files whose texture or normal lists differ in length from the vertex list, which
    is most files that have any.
    """
    vertices: list[list[float]] = []
    faces: list[list[int]] = []
    with path.open(encoding="utf-8", errors="strict") as lines:
        for number, line in enumerate(lines, start=1):
            key, *fields = line.split("#")[0].split() or [""]
            try:
                if key == "v":
                    if len(fields) < 3:
                        raise ValueError(f"a vertex needs three coordinates, not {len(fields)}")
                    vertices.append([float(field) for field in fields[:3]])
                elif key == "f":
                    # Vertices count from 1, or back from the latest from -1.
                    indices = [int(field.split("/")[0]) for field in fields]
                    for index in indices:
                        if index == 0 or index < -len(vertices):
                            raise ValueError(f"there is no vertex {index}")
                    faces.append([i - 1 if i > 0 else len(vertices) + i for i in indices])
            except ValueError as error:
                raise ValueError(f"line {number}: {error}") from error
    kinds = {3: "triangle", 4: "quad"}
    runs = [(kinds.get(n, "polygon"), np.array(list(run))) for n, run in groupby(faces, key=len)]
    return np.array(vertices, dtype=np.float64).reshape(-1, 3), runs
