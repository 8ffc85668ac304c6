"""Meshes of boxes, shapes and closed surfaces (fTetWild, through pytetwild), with a cache."""

import hashlib
import importlib.util
import logging
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tactorch.errors import ConfigError, MeshError, TactorchError
from tactorch.files import cache_folder, read_arrays, write_arrays
from tactorch.mesh.checks import closed_surface
from tactorch.mesh.decimate import decimated
from tactorch.mesh.edge_length import Progress, fit_edge_length
from tactorch.mesh.geometry import (
    bounding_box,
    bounding_diagonal,
    enclosed_volume,
    signed_volumes,
    surface_area,
)
from tactorch.mesh.intersections import require_no_crossing
from tactorch.mesh.shapes import Box, Shape
from tactorch.mesh.tetmesh import TetMesh, compact
from tactorch.mesh.values import (
    Points,
    Real,
    Rows,
    Tets,
    Triangles,
    Vector,
    positive,
    sizes,
    vector,
)
from tactorch.progress import progress_line

logger = logging.getLogger(__name__)

#: A larger expected number of elements indicates a mistake in the edge length.
MAX_ELEMENTS = 5_000_000
#: The same for the cells of a structured mesh.
MAX_CELLS = 1_000_000
GENERATORS = ("auto", "structured", "tetwild")
# Mean edge of a cube divided into five tetrahedra, per side: as many sides as diagonals.
_MEAN_EDGE = (1.0 + np.sqrt(2.0)) / 2.0
# Corners of a cell are numbered 4 ix + 2 iy + iz.
_FIVE = np.array([(0, 4, 2, 1), (6, 2, 4, 7), (5, 4, 1, 7), (3, 1, 2, 7), (1, 2, 7, 4)])
# Kuhn's subdivision: the paths along the axes from corner 0 to corner 7.
_SIX = [(0, 4, 6, 7), (0, 4, 7, 5), (0, 2, 7, 6), (0, 2, 3, 7), (0, 1, 5, 7), (0, 1, 7, 3)]
_EPSILON = 1e-3  # width of fTetWild's envelope over the bounding box's diagonal
_WORKER = Path(__file__).with_name("_tetwild_worker.py")


def mesh_shape(
    shape: Shape,
    edge_length_mm: Real | None,
    relative_edge_length: Real,
    generator: str,
    inner: Sequence[Shape] = (),
    cache: bool = True,
) -> TetMesh:
    """Mesh a shape, conforming to the surfaces of `inner` shapes; see `Phantom.mesh`."""
    if generator not in GENERATORS:
        raise ConfigError(f"generator={generator!r}: choose one of {', '.join(GENERATORS)}.")
    diagonal = bounding_diagonal(shape.bounds())
    length = _edge_length(edge_length_mm, relative_edge_length, diagonal)
    if generator == "structured" and inner:
        raise ConfigError("generator='structured' cannot follow inclusions; use 'tetwild'.")
    if generator == "tetwild" or inner or (generator == "auto" and not isinstance(shape, Box)):
        surfaces = [part.surface() for part in inner]
        mesh = tetrahedralize(
            *shape.surface(), length, epsilon=_EPSILON, inner=surfaces, cache=cache
        )
        return _with_plane_faces(mesh, shape) if isinstance(shape, Box) else mesh
    if not isinstance(shape, Box):
        raise ConfigError(
            f"generator='structured' meshes boxes only, not a {type(shape).__name__};"
            " use 'tetwild' or 'auto'."
        )
    # The subtraction keeps rounding from adding a layer of cells.
    counts = np.ceil(np.array(shape.size_mm) * _MEAN_EDGE / length - 1e-9).clip(1)
    require_few(length, float(np.prod(counts)), MAX_CELLS, "cells")
    return box_mesh(shape.size_mm, counts.astype(int), center_mm=shape.center_mm, tets_per_cell=5)


def require_few(edge_mm: float, count: float, limit: int, what: str) -> None:
    """Raise `ConfigError` where an edge length takes more elements or cells than the limit."""
    if count > limit:
        raise ConfigError(
            f"An edge length of {edge_mm:.4g} mm would take about {count:.2g} {what} (limit"
            f" {limit:.0e}); choose a larger one, and check the units."
        )


def _with_plane_faces(mesh: TetMesh, box: Box) -> TetMesh:
    """Move the boundary nodes of a mesh of a box onto its faces and edges.

    fTetWild leaves them within its envelope, so that faces are tilted and edges cut off a little.
    The mesh remains where an element would be inverted.
    """
    low, high = box.bounds()
    tolerance = 2.0 * _EPSILON * bounding_diagonal(box.bounds())
    nodes, points = np.unique(mesh.surface.triangles), mesh.points.copy()
    outer = points[nodes]
    for plane in (low, high):
        outer = np.where(np.abs(outer - plane) < tolerance, plane, outer)
    points[nodes] = outer
    if signed_volumes(points, mesh.tets).min() <= 0.0:
        return mesh
    return TetMesh.create(points, mesh.tets)


def box_mesh(
    size_mm: Vector | Real = 10.0,
    divisions: int | Sequence[int] | np.ndarray = 4,
    *,
    origin_mm: Vector | None = None,
    center_mm: Vector | None = None,
    tets_per_cell: int = 6,
) -> TetMesh:
    """Mesh a cuboid with a regular grid of cells, each cut into tetrahedra.

    Args:
        size_mm: Edge lengths, three or one for a cube.
        divisions: Cells along each edge, three or one for all.
        origin_mm: Lowest corner; the default is (0, 0, 0).
        center_mm: Centre, instead of `origin_mm`.
        tets_per_cell: 6 (around the cell's space diagonal) or 5 (mirrored from cell to cell,
            without a preferred direction).

    Returns:
        The mesh; node (ix, iy, iz) has index (ix (ny + 1) + iy) (nz + 1) + iz.
    """
    size, origin = np.array(sizes("size_mm", size_mm)), np.zeros(3)
    if origin_mm is not None and center_mm is not None:
        raise ConfigError("Give origin_mm or center_mm, not both.")
    if origin_mm is not None:
        origin = np.array(vector("origin_mm", origin_mm))
    if center_mm is not None:
        origin = np.array(vector("center_mm", center_mm)) - size / 2
    three = np.asarray(divisions)
    three = np.broadcast_to(three, 3) if three.ndim == 0 else three
    if three.shape != (3,) or three.dtype.kind not in "iu" or three.min() < 1:
        raise ConfigError(f"divisions={divisions!r} must be one or three positive integers.")
    counts = three.tolist()
    axes = [o + s * np.arange(n + 1) / n for o, s, n in zip(origin, size, counts, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    # The eight nodes of each cell, from its index (ix, iy, iz).
    cells = np.indices(counts).reshape(3, -1).T
    strides = np.array([(counts[1] + 1) * (counts[2] + 1), counts[2] + 1, 1])
    nodes = (cells @ strides)[:, None] + np.indices((2, 2, 2)).reshape(3, -1).T @ strides
    if tets_per_cell == 6:
        tets = nodes[:, _SIX]
    elif tets_per_cell == 5:
        # 7 - corner mirrors a cell through its centre: diagonals of neighbours then agree.
        mirrored = 7 - _FIVE[:, [0, 1, 3, 2]]
        odd = cells.sum(axis=1) % 2 == 1
        tets = np.where(odd[:, None, None], nodes[:, mirrored], nodes[:, _FIVE])
    else:
        raise ConfigError(f"tets_per_cell={tets_per_cell} must be 5 or 6.")
    return TetMesh.create(points, tets.reshape(-1, 4))


def tetrahedralize(
    vertices: Rows,
    triangles: Rows,
    edge_length_mm: Real | None = None,
    *,
    relative_edge_length: Real = 0.1,
    epsilon: Real | None = None,
    inner: Sequence[tuple[Rows, Rows]] = (),
    cache: bool = True,
    progress: Progress | None = None,
) -> TetMesh:
    """Mesh the inside of a closed triangle surface with tetrahedra.

    The median edge length is within about 20 % of the target, and the boundary nodes are on the
    surface. Where curvature, thin parts or small features need smaller elements, a warning tells
    the median. A surface whose triangles are far finer is made coarser before, within 0.05 edge
    lengths, and a message says so. With a fixed `epsilon` the target is an upper limit instead: the
    median may be less than half of it.

    fTetWild is not deterministic. Its first result is therefore cached under a hash of the inputs
    (see `tactorch.files.cache_folder`) and returned by later calls.

    Args:
        vertices: (n, 3) positions, mm.
        triangles: (k, 3) vertex indices; closed, manifold and consistently oriented.
        edge_length_mm: Target edge length, mm.
        relative_edge_length: Target edge length as a fraction of the bounding box's diagonal,
            where `edge_length_mm` is not given; default: the paper's 10 %.
        epsilon: Envelope of the surface that the result stays within, as a fraction of the
            diagonal; None for the one, of at most 0.15 edge lengths, that gives the median edge
            length, and for 1e-3 with inner surfaces.
        inner: Closed inner surfaces (vertices and triangles) that element faces conform to;
            their inside is meshed too.
        cache: Whether to look up and store the result.
        progress: Called with the number of meshes made, their largest number and a note while the
            median edge length is fitted.

    Raises:
        ConfigError: The edge length is larger than the object, or would take too many elements.
        MeshError: The surface is not closed, manifold and consistently oriented, intersects itself,
            or fTetWild cannot mesh it.
    """
    points, faces, _ = compact(*closed_surface(vertices, triangles))
    diagonal, volume = bounding_diagonal(points), enclosed_volume(points, faces)
    length = _edge_length(edge_length_mm, relative_edge_length, diagonal)
    if length > diagonal:
        raise ConfigError(
            f"The edge length {length:.4g} mm exceeds the object's diagonal {diagonal:.4g} mm;"
            " choose a smaller one, and check the units of the surface."
        )
    if epsilon is None and len(inner):
        epsilon = _EPSILON
    tolerance = None if epsilon is None else positive("epsilon", epsilon)
    expected = volume / (0.118 * length**3)  # regular tetrahedra
    require_few(length, expected, MAX_ELEMENTS, "elements")
    all_points, all_faces = _with_inner(points, faces, inner)
    digest = hashlib.sha256(f"tetwild 1 {len(all_points)} {length!r} {tolerance!r} ".encode())
    digest.update(all_points.astype("<f8").tobytes())
    digest.update(all_faces.astype("<i8").tobytes())
    path = cache_folder() / "meshes" / f"{digest.hexdigest()}.npz"
    mesh = _load_cached(path) if cache else None
    if mesh is not None:
        return mesh

    if tolerance is None:
        all_points, all_faces = decimated(points, faces, length)
        if len(all_faces) == len(faces):
            require_no_crossing(points, faces)

    def mesher(target_mm: float, envelope_mm: float) -> TetMesh:
        relative, coarsen = envelope_mm / diagonal, tolerance is None
        return _validated(*_run_tetwild(all_points, all_faces, target_mm, relative, coarsen))

    if tolerance is None:
        mesh = fit_edge_length(mesher, points, faces, length, progress)
    else:
        mesh = mesher(length, tolerance * diagonal)
        # The result stays within epsilon of the surface, so this much volume may differ.
        allowed = 2 * tolerance * diagonal * surface_area(points, faces)
        if abs(mesh.volumes.sum() - volume) > allowed:
            raise MeshError(
                f"The mesh fills {mesh.volumes.sum():.4g} mm^3 where the surface encloses"
                f" {volume:.4g} mm^3: the surface intersects itself, or has parts thinner than"
                " epsilon. Repair it, or choose a smaller epsilon."
            )
    logger.info("Meshed: %r, target edge length %.4g mm.", mesh, length)
    if cache:
        _store_cached(path, mesh)
    return mesh


def _edge_length(edge_length_mm: Real | None, relative: Real, diagonal: float) -> float:
    if edge_length_mm is None:
        return positive("relative_edge_length", relative) * diagonal
    return positive("edge_length_mm", edge_length_mm)


def _with_inner(
    points: Points, faces: Triangles, inner: Sequence[tuple[Rows, Rows]]
) -> tuple[np.ndarray, np.ndarray]:
    """Append closed surfaces, which must be inside, to the outer one."""
    all_points, all_faces, count = [points], [faces], len(points)
    low, high = bounding_box(points)
    margin = 1e-6 * float(np.linalg.norm(high - low))  # for surfaces that touch the outer one
    for vertices, triangles in inner:
        new, sides = closed_surface(vertices, triangles)
        if (new < low - margin).any() or (new > high + margin).any():
            raise MeshError(
                "An inner surface extends beyond the outer surface's bounding"
                " box; move or shrink it."
            )
        all_points.append(new)
        all_faces.append(sides + count)
        count += len(new)
    return np.concatenate(all_points), np.concatenate(all_faces)


def _run_tetwild(
    points: Points, faces: Triangles, length: float, epsilon: float, coarsen: bool
) -> tuple[np.ndarray, np.ndarray]:
    if importlib.util.find_spec("pytetwild") is None:
        raise ConfigError("Meshing a surface needs pytetwild: pip install pytetwild.")
    with tempfile.TemporaryDirectory(prefix="tactorch-") as folder:
        source, target = Path(folder, "surface.npz"), Path(folder, "tets.npz")
        surface = {"vertices": points, "triangles": faces.astype(np.int32)}
        write_arrays(
            source, {**surface, "edge_length_mm": length, "epsilon": epsilon, "coarsen": coarsen}
        )
        # -P: keeps the worker's folder off the module search path.
        with progress_line(f"meshing with edges of {length:.3g} mm"):
            process = subprocess.run(
                [sys.executable, "-P", str(_WORKER), str(source), str(target)],
                cwd=folder,
                capture_output=True,
                text=True,
                errors="replace",
                check=False,
            )
        if process.returncode or not target.is_file():
            output = process.stderr.strip() or process.stdout.strip() or "no message"
            raise MeshError(
                f"fTetWild could not mesh the surface of {len(faces)} triangles"
                f" (exit status {process.returncode}): {output.splitlines()[-1]}"
            )
        with np.load(target) as result:
            return result["points"], result["tets"]


def _validated(points: Points, tets: Tets) -> TetMesh:
    """Drop unreferenced points, reorient and check the elements."""
    if not len(tets):
        raise MeshError(
            "fTetWild returned no elements: the surface is thinner than epsilon, or folds over"
            " itself."
        )
    try:
        nodes, cells, used = compact(points, tets)
        if len(used) < len(points):
            logger.info("Dropped %d points without elements.", len(points) - len(used))
        return TetMesh.create(nodes, cells)
    except MeshError as error:
        raise MeshError(
            f"The result of fTetWild is invalid. {error} Change edge_length_mm or epsilon, or"
            " repair the surface."
        ) from error


def _load_cached(path: Path) -> TetMesh | None:
    if not path.is_file():
        return None
    try:
        stored = read_arrays(path, "Cached mesh", "it is computed again.")
        mesh = TetMesh(stored["points"], stored["tets"])
        if str(stored["content_hash"]) != mesh.content_hash():
            raise MeshError("Its content does not match its hash.")
    except (KeyError, TactorchError) as error:
        logger.warning("Ignoring the damaged cached mesh '%s': %s", path, error)
        return None
    return mesh


def _store_cached(path: Path, mesh: TetMesh) -> None:
    arrays = {"points": mesh.points, "tets": mesh.tets, "content_hash": mesh.content_hash()}
    try:
        write_arrays(path, arrays, compressed=True)
    except (OSError, TactorchError) as error:
        logger.warning("The mesh could not be cached in '%s': %s", cache_folder(), error)
