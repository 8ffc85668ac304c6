"""Reading and writing meshes and surfaces; lengths are converted to mm."""

import contextlib
import importlib
import io
import logging
import warnings
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Int
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from tactorch.errors import ConfigError, FileError, MeshError, TactorchError
from tactorch.files import atomic_path, require_file
from tactorch.mesh.checks import as_cells, as_points, listing, unreferenced
from tactorch.mesh.formats.abaqus import read_abaqus
from tactorch.mesh.formats.cells import SOLIDS, MeshFile, as_tets
from tactorch.mesh.formats.gmsh import read_gmsh
from tactorch.mesh.formats.surfaces import Polygons, read_obj, read_ply, read_stl, triangulated
from tactorch.mesh.formats.vtk import read_xml
from tactorch.mesh.geometry import bounding_diagonal
from tactorch.mesh.tetmesh import TetMesh, compact
from tactorch.mesh.values import Points, Rows, Triangles

if TYPE_CHECKING:
    import meshio

_log = logging.getLogger(__name__)
# meshio's modules by file suffix, which write all formats. Its own dispatcher guesses
# ANSYS for .msh and ends the process on a damaged file, so the modules are called directly.
_MESH_FORMATS = {".msh": "gmsh", ".vtu": "vtu", ".inp": "abaqus"}
_SURFACE_FORMATS = {".stl": "stl", ".obj": "obj", ".ply": "ply"}
#: Suffixes of files that `write_mesh` writes.
MESH_SUFFIXES = tuple(_MESH_FORMATS)
#: Name of the regions in the cell data of a file.
REGION = "region"
# The names of others, without underscores and capitals: meshio, gmsh, OpenGeoSys, ParaView, SOFA.
_REGIONS = f"""{REGION} gmsh:physical cellentityids materialids material materialid regionid regions
label labels celltags subdomain domain""".split()
_MM_PER_UNIT = {"mm": 1.0, "cm": 10.0, "m": 1000.0}
#: Bounding-box diagonals between which an object pressed by hand or robot is plausible, mm.
PLAUSIBLE_MM = (0.5, 5000.0)
# Vertices closer than this are one, over the diagonal: the digits of many files.
_SAME = 1e-6
_MAX_DIAGONAL = 1e100  # whose square is a number
_MAX_NEAR = 50  # pairs of close vertices for each vertex


def read_mesh(
    path: str | Path, unit: str = "mm", *, drop_unreferenced: bool | None = None
) -> TetMesh:
    """Return the tetrahedral mesh (mm) of a .msh (gmsh), .vtu or .inp (Abaqus, CalculiX) file.

    Nodes and elements keep the order of the file. Hexahedra, wedges and pyramids are divided into
    tetrahedra that fit together, and elements of higher order are read with their corner nodes;
    messages say so. Points, lines and surface cells are ignored; inverted tetrahedra are
    reoriented. A warning names the likely unit of an object that is implausibly small or large.

    Regions are the cell data `region` or a field of a similar name; the physical groups of gmsh; or
    the sets of elements of Abaqus, numbered in their order. Where some of these contain one
    another, the smallest that has an element is its region.

    Args:
        path: Path of the file.
        unit: Length unit of the file: "mm", "cm" or "m".
        drop_unreferenced: Whether to drop nodes that no tetrahedron uses, which renumbers the
            others; by default with a warning. False refuses such files: for data of other files,
            which refer to nodes by number.

    Raises:
        ConfigError: The unit is not known.
        FileError: The file is missing, damaged, of an unknown format, or too large.
        MeshError: It has no solid elements, or the mesh cannot be used.
    """
    scale, source = _mm_per(unit), require_file(path, "Mesh")
    name = _format(source, _MESH_FORMATS)
    with naming(source):
        with reading(source, name):
            content = _MESH_READERS[name](source)
        if not len(content.points):
            raise FileError(f"'{source}' has no points: it is empty, or not of the {name} format.")
        points = as_points(content.points) * scale
        found, regions = as_tets(content, source)
        tets = as_cells(found, 4, len(points))
        unused = unreferenced(len(points), tets)
        if unused.any():
            _drop(unused, drop_unreferenced, source)
        points, tets, _ = compact(points, tets)
        mesh = TetMesh.create(points, tets, regions=regions)
    _warn_of_unit(f"Mesh '{source}'", mesh.diagonal, unit)
    return mesh


def _drop(unused: Bool[np.ndarray, " n"], allowed: bool | None, source: Path) -> None:
    """Refuse nodes that no element uses, or report them."""
    shown = f"no tetrahedron uses {listing(unused, 'nodes')}"
    if allowed is False:
        raise MeshError(
            f"{shown}, and other files refer to nodes by number. Write it without them, and take "
            "the numbers of the new file: tactorch.write_mesh('new.vtu', tactorch.read_mesh(...))."
        )
    if allowed is None:
        _log.warning("'%s': %s; they are left out, which renumbers the others.", source, shown)


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

    Vertices that are equal within 1e-6 of the diagonal are merged, as STL stores the vertices of
    each triangle separately; triangles that become points or lines are dropped, and polygons are
    divided. Vertices keep the order of the file. See `read_mesh` for the unit.

    Raises:
        ConfigError: The unit is not known.
        FileError: The file is missing, damaged, of an unknown format, or too large.
        MeshError: It has no faces, or vertices that cannot be used.
    """
    scale, source = _mm_per(unit), require_file(path, "Surface")
    name = _format(source, _SURFACE_FORMATS)
    with naming(source):
        with reading(source, name):
            points, nodes, widths = _SURFACE_READERS[name](source)
        vertices = as_points(points, "vertices")
        if not len(widths):
            raise MeshError(_cloud(len(vertices), source))
        with _meshio(f"'{source}' cannot be read as {name}"):
            triangles = triangulated(vertices, nodes, widths)
        # Files may have triangles that are lines already.
        faces = as_cells(_without_lines(triangles), 3, len(vertices), "triangles")
        merged = _without_lines(_first_of_same(vertices, source)[faces])
        vertices, triangles, _ = compact(vertices, merged)
    _warn_of_unit(f"Surface '{source}'", bounding_diagonal(vertices) * scale, unit)
    return vertices * scale, triangles


def _cloud(count: int, source: Path) -> str:
    hull = f"pyvista.read({str(source)!r}).delaunay_3d().extract_surface().triangulate()"
    return (
        f"{count} points and no faces: a cloud of points. Make a closed triangle surface of it "
        "first, such as by Screened Poisson Surface Reconstruction in MeshLab, or for a convex "
        f"body by python -c \"import pyvista; {hull}.save('surface.ply')\"."
    )


def _first_of_same(vertices: Points, source: Path) -> Int[np.ndarray, " n"]:
    """Return for each vertex the first one at the same place."""
    _, first, same = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
    distinct, diagonal = vertices[first], bounding_diagonal(vertices)
    if diagonal > _MAX_DIAGONAL:
        raise MeshError(f"its vertices are {diagonal:.3g} apart; repair the coordinates.")
    tree, radius = cKDTree(distinct), _SAME * diagonal
    if tree.count_neighbors(tree, radius) > _MAX_NEAR * len(distinct):
        raise MeshError(
            f"many of its vertices are closer than {_SAME:g} of its size; remove far points, or "
            "make the surface coarser."
        )
    pairs = tree.query_pairs(radius, output_type="ndarray")
    if len(pairs):
        links = coo_array((np.ones(len(pairs), bool), pairs.T), (len(distinct),) * 2)
        count, labels = connected_components(links, directed=False)
        _log.warning(
            "'%s': %d vertices are merged with others within %.2g (in the unit of the file).",
            source, len(distinct) - count, radius,
        )  # fmt: skip
        earliest = np.full(count, len(vertices))
        np.minimum.at(earliest, labels, first)
        first = earliest[labels]
    return first[same.reshape(-1)]


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


def _read_vtu(path: Path) -> MeshFile:
    """Read a file of VTK."""
    content = read_xml(path)
    fields = {key.lower().replace("_", "").replace(" ", ""): key for key in content.cell_fields}
    solid = np.repeat(
        [c.shape in SOLIDS for c in content.cells], [len(c.nodes) for c in content.cells]
    )
    for name in _REGIONS:
        values = content.cell_fields[fields[name]] if name in fields else None
        if values is None or values.size != len(solid):
            continue
        regions = np.ravel(values)[solid]
        if (regions == np.round(regions)).all():
            return MeshFile(content.points, content.cells, regions)
        _log.warning(
            "'%s': '%s' has values that are not whole numbers, and is not read as regions.",
            path, fields[name],
        )  # fmt: skip
    return MeshFile(content.points, content.cells)


_MESH_READERS: dict[str, Callable[[Path], MeshFile]] = {
    "gmsh": read_gmsh, "abaqus": read_abaqus, "vtu": _read_vtu,
}  # fmt: skip
_SURFACE_READERS: dict[str, Callable[[Path], Polygons]] = {
    "stl": read_stl, "obj": read_obj, "ply": read_ply,
}  # fmt: skip
_HINT = " Is the file complete, and of the format its suffix says?"


def _write(path: str | Path, formats: Mapping[str, str], content: "meshio.Mesh") -> None:
    name = _format(path, formats)
    options = {"binary": True} if name == "stl" else {}
    writer = importlib.import_module(f"meshio.{name}")
    with _meshio(f"'{path}' cannot be written as {name}"), atomic_path(path) as temporary:
        writer.write(str(temporary), content, **options)


def reading(path: Path, name: str) -> contextlib.AbstractContextManager[io.StringIO]:
    """Turn failures of a reader of a format into `FileError`; see `_meshio`."""
    return _meshio(f"'{path}' cannot be read as {name}", _HINT)


@contextlib.contextmanager
def _meshio(failure: str, hint: str = "") -> Iterator[io.StringIO]:
    """Silence a reader or writer and turn its failures into `FileError`.

    Readers raise any exception on damaged files; those of meshio print, and may call sys.exit.
    """
    output = io.StringIO()
    try:
        with (
            contextlib.redirect_stdout(output),
            contextlib.redirect_stderr(output),
            warnings.catch_warnings(),
        ):
            warnings.simplefilter("ignore")
            yield output
    except TactorchError:
        raise
    except MemoryError as error:
        raise FileError(f"{failure}: it states more than the memory can hold.{hint}") from error
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
