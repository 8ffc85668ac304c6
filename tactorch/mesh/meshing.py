"""Tetrahedral meshing of closed surfaces (fTetWild, through pytetwild), with a cache on disk."""

import hashlib
import importlib.util
import logging
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from tactorch.errors import ConfigError, MeshError, TactorchError
from tactorch.files import atomic_path, cache_folder
from tactorch.mesh.checks import closed_surface
from tactorch.mesh.geometry import (
    bounding_box,
    bounding_diagonal,
    enclosed_volume,
    surface_area,
)
from tactorch.mesh.tetmesh import TetMesh, compact
from tactorch.mesh.values import Real, Rows, positive

logger = logging.getLogger(__name__)

#: A larger expected number of elements indicates a mistake in the edge length.
MAX_ELEMENTS = 5_000_000
_WORKER = Path(__file__).with_name("_tetwild_worker.py")


def tetrahedralize(
    vertices: Rows,
    triangles: Rows,
    edge_length_mm: Real | None = None,
    *,
    relative_edge_length: Real = 0.1,
    epsilon: Real = 1e-3,
    inner: Sequence[tuple[Rows, Rows]] = (),
    cache: bool = True,
) -> TetMesh:
    """Mesh the inside of a closed triangle surface with tetrahedra.

    fTetWild is not deterministic. Its first result is therefore cached under a hash of the inputs
    (see `tactorch.files.cache_folder`) and returned by later calls.

    Args:
        vertices: (n, 3) positions, mm.
        triangles: (k, 3) vertex indices; closed, manifold and consistently oriented.
        edge_length_mm: Target edge length, mm.
        relative_edge_length: Target edge length as a fraction of the bounding box's diagonal,
            where `edge_length_mm` is not given; default: the paper's 10 %.
        epsilon: Envelope of the surface that the result stays within, as a fraction of the
            diagonal.
        inner: Closed inner surfaces (vertices and triangles) that element faces conform to;
            their inside is meshed too.
        cache: Whether to look up and store the result.

    Returns:
        The mesh.

    Raises:
        MeshError: The surface is open, not a manifold, not finite or encloses no volume; or
            meshing fails, loses part of the volume or returns degenerate elements.
        ConfigError: A setting has an invalid value, or pytetwild is not installed.
    """
    points, faces = closed_surface(vertices, triangles)
    points, faces, _ = compact(points, faces)
    diagonal = bounding_diagonal(points)
    length = _edge_length(edge_length_mm, relative_edge_length, diagonal)
    tolerance = positive("epsilon", epsilon)
    volume = enclosed_volume(points, faces)
    _check_count(volume, length)
    all_points, all_faces = _with_inner(points, faces, inner)
    key = _key(all_points, all_faces, length, tolerance)
    mesh = _load_cached(key) if cache else None
    if mesh is None:
        mesh = _validated(*_run_tetwild(all_points, all_faces, length, tolerance))
        # The result stays within epsilon of the surface, so this much volume may differ.
        _check_volume(mesh, volume, 2 * tolerance * diagonal * surface_area(points, faces))
        logger.info("Meshed: %r, target edge length %.4g mm.", mesh, length)
        if cache:
            _store_cached(key, mesh)
    return mesh


def _with_inner(
    points: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "k 3"],
    inner: Sequence[tuple[Rows, Rows]],
) -> tuple[Float[np.ndarray, "p 3"], Int[np.ndarray, "q 3"]]:
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


def _edge_length(edge_length_mm: Real | None, relative: Real, diagonal: float) -> float:
    if edge_length_mm is None:
        length = positive("relative_edge_length", relative) * diagonal
    else:
        length = positive("edge_length_mm", edge_length_mm)
    if length > diagonal:
        raise ConfigError(
            f"The edge length {length:.4g} mm exceeds the object's diagonal {diagonal:.4g} mm;"
            " choose a smaller one, and check the units of the surface."
        )
    return length


def _check_count(volume: float, length: float) -> None:
    expected = volume / (0.118 * length**3)  # regular tetrahedra
    if expected > MAX_ELEMENTS:
        raise ConfigError(
            f"An edge length of {length:.4g} mm would take about {expected:.2g} elements"
            f" (limit {MAX_ELEMENTS:.0e}); choose a larger one, and check the units."
        )


def _key(
    points: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "k 3"], length: float, epsilon: float
) -> str:
    digest = hashlib.sha256(f"tetwild 1 {len(points)} {length!r} {epsilon!r} ".encode())
    digest.update(points.astype("<f8").tobytes())
    digest.update(faces.astype("<i8").tobytes())
    return digest.hexdigest()


def _run_tetwild(
    points: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "k 3"], length: float, epsilon: float
) -> tuple[Float[np.ndarray, "p 3"], Int[np.ndarray, "m 4"]]:
    if importlib.util.find_spec("pytetwild") is None:
        raise ConfigError("Meshing a surface needs pytetwild: pip install pytetwild.")
    with tempfile.TemporaryDirectory(prefix="tactorch-") as folder:
        source, target = Path(folder, "surface.npz"), Path(folder, "tets.npz")
        np.savez(
            source,
            vertices=points,
            triangles=faces.astype(np.int32),
            edge_length_mm=length,
            epsilon=epsilon,
        )
        # -P: keeps the worker's folder off the module search path.
        process = subprocess.run(
            [sys.executable, "-P", str(_WORKER), str(source), str(target)],
            cwd=folder,
            capture_output=True,
            text=True,
            errors="replace",
            check=False,
        )
        if process.returncode or not target.is_file():
            reason = (
                process.stderr.strip() or process.stdout.strip() or "no message"
            ).splitlines()[-1]
            raise MeshError(
                f"fTetWild could not mesh the surface of {len(faces)} triangles"
                f" (exit status {process.returncode}): {reason}"
            )
        with np.load(target) as result:
            return result["points"], result["tets"]


def _validated(points: Float[np.ndarray, "p 3"], tets: Int[np.ndarray, "m 4"]) -> TetMesh:
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


def _check_volume(mesh: TetMesh, expected: float, allowed: float) -> None:
    volume = float(mesh.volumes.sum())
    if abs(volume - expected) > allowed:
        raise MeshError(
            f"The mesh fills {volume:.4g} mm^3 where the surface encloses {expected:.4g} mm^3:"
            " the surface intersects itself, or has parts thinner than epsilon. Repair it, or"
            " choose a smaller epsilon."
        )


def _load_cached(key: str) -> TetMesh | None:
    """Return the mesh stored under `key`; None if it is missing or damaged."""
    path = _cache_path(key)
    if not path.is_file():
        return None
    try:
        with np.load(path, allow_pickle=False) as stored:
            mesh = TetMesh(stored["points"], stored["tets"])
            digest = str(stored["content_hash"])
    except Exception as error:  # damaged archives raise errors of many types
        logger.warning("Ignoring the damaged cached mesh '%s': %s", path, error)
        return None
    if digest != mesh.content_hash():
        logger.warning("Ignoring the cached mesh '%s': its content does not match its hash.", path)
        return None
    return mesh


def _store_cached(key: str, mesh: TetMesh) -> None:
    """Store the mesh under `key`; failure to write is logged only."""
    try:
        with atomic_path(_cache_path(key)) as temporary:
            np.savez_compressed(
                temporary,
                points=mesh.points,
                tets=mesh.tets,
                content_hash=np.array(mesh.content_hash()),
            )
    except (OSError, TactorchError) as error:
        logger.warning("The mesh could not be cached in '%s': %s", cache_folder(), error)


def _cache_path(key: str) -> Path:
    return cache_folder() / "meshes" / f"{key}.npz"
