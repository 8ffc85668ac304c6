"""Filling a closed surface with tetrahedra (fTetWild, through pytetwild)."""

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

from tactorch.errors import ConfigError, MeshError
from tactorch.mesh.cache import load_mesh, store_mesh
from tactorch.mesh.closed import closed_surface, enclosed_volume, surface_area
from tactorch.mesh.geometry import bounding_box
from tactorch.mesh.tetmesh import TetMesh, compact
from tactorch.mesh.values import Real, Rows, positive

logger = logging.getLogger(__name__)

#: More elements than this are taken for a mistake in the edge length.
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
    """Fill a closed triangle surface with tetrahedra.

    fTetWild does not give the same mesh twice. The first result is therefore cached under a hash
    of the inputs (see `cache_folder`) and returned from then on.

    Args:
        vertices: (n, 3) positions, mm.
        triangles: (k, 3) vertex indices; closed, manifold and consistently turned (either way).
        edge_length_mm: Target edge length.
        relative_edge_length: Target as a share of the bounding box's diagonal, where
            `edge_length_mm` is not given; the paper's 10 % by default.
        epsilon: How far the result may leave the surface, as a share of the diagonal.
        inner: Closed surfaces inside, vertices and triangles of each, that elements shall follow
            rather than cut; what they enclose is filled too.
        cache: Whether to look up and store the result.

    Returns:
        The mesh.

    Raises:
        MeshError: The surface is open, not manifold, not finite or encloses nothing; or meshing
            failed, lost part of the volume or left degenerate elements.
        ConfigError: A setting has a value that cannot be used, or pytetwild is not installed.
    """
    points, faces = closed_surface(vertices, triangles)
    points, faces, _ = compact(points, faces)
    corners = bounding_box(points)
    diagonal = float(np.linalg.norm(corners[1] - corners[0]))
    length = _edge_length(edge_length_mm, relative_edge_length, diagonal)
    tolerance = positive("epsilon", epsilon)
    volume = enclosed_volume(points, faces)
    _check_count(volume, length)
    whole, all_faces = _with_inner(points, faces, inner)
    key = _key(whole, all_faces, length, tolerance)
    mesh = load_mesh(key) if cache else None
    if mesh is None:
        mesh = _sound(*_run_tetwild(whole, all_faces, length, tolerance))
        # The result stays within epsilon of the surface, so this much volume may differ.
        _check_volume(mesh, volume, 2 * tolerance * diagonal * surface_area(points, faces))
        logger.info("Meshed: %r, target edge length %.4g mm.", mesh, length)
        if cache:
            store_mesh(key, mesh)
    return mesh


def _with_inner(
    points: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "k 3"],
    inner: Sequence[tuple[Rows, Rows]],
) -> tuple[Float[np.ndarray, "p 3"], Int[np.ndarray, "q 3"]]:
    """Add closed surfaces, which must lie inside, to the outer one."""
    all_points, all_faces, count = [points], [faces], len(points)
    low, high = bounding_box(points)
    slack = 1e-6 * float(np.linalg.norm(high - low))  # of surfaces that touch the outer one
    for vertices, triangles in inner:
        new, sides = closed_surface(vertices, triangles)
        if (new < low - slack).any() or (new > high + slack).any():
            raise MeshError("An inner surface reaches out of the outer one's bounding box.")
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
        # -P: the worker's own folder must not come first on the module search path.
        done = subprocess.run(
            [sys.executable, "-P", str(_WORKER), str(source), str(target)],
            cwd=folder,
            capture_output=True,
            text=True,
            errors="replace",
            check=False,
        )
        if done.returncode or not target.is_file():
            reason = (done.stderr.strip() or done.stdout.strip() or "no message").splitlines()[-1]
            raise MeshError(
                f"fTetWild could not mesh the surface of {len(faces)} triangles"
                f" (exit status {done.returncode}): {reason}"
            )
        with np.load(target) as result:
            return result["points"], result["tets"]


def _sound(points: Float[np.ndarray, "p 3"], tets: Int[np.ndarray, "m 4"]) -> TetMesh:
    """Make a mesh of what fTetWild returned: drop stray points, reorient, check."""
    if not len(tets):
        raise MeshError(
            "fTetWild found no inside: the surface is thinner than epsilon, or folds over itself."
        )
    try:
        nodes, cells, kept = compact(points, tets)
        if len(kept) < len(points):
            logger.info("Dropped %d points without elements.", len(points) - len(kept))
        return TetMesh.create(nodes, cells)
    except MeshError as error:
        raise MeshError(
            f"The result of fTetWild cannot be used. {error} Change edge_length_mm or epsilon, or"
            " repair the surface."
        ) from error


def _check_volume(mesh: TetMesh, expected: float, allowed: float) -> None:
    found = float(mesh.volumes.sum())
    if abs(found - expected) > allowed:
        raise MeshError(
            f"The mesh fills {found:.4g} mm^3 where the surface encloses {expected:.4g} mm^3:"
            " the surface intersects itself, or has parts thinner than epsilon. Repair it, or"
            " choose a smaller epsilon."
        )
