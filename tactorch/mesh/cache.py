"""Meshes kept on disk under a hash of what they were made from."""

import logging
from pathlib import Path

import numpy as np

from tactorch.errors import TactorchError
from tactorch.files import atomic_path, cache_folder
from tactorch.mesh.tetmesh import TetMesh

logger = logging.getLogger(__name__)


def load_mesh(key: str) -> TetMesh | None:
    """Return the mesh stored under `key`; None if there is none or the file is damaged."""
    path = _path(key)
    if not path.is_file():
        return None
    try:
        with np.load(path, allow_pickle=False) as stored:
            mesh = TetMesh(stored["points"], stored["tets"])
            digest = str(stored["content_hash"])
    except Exception as error:  # what a damaged archive leads to has no common base
        logger.warning("Ignoring the damaged cached mesh '%s': %s", path, error)
        return None
    if digest != mesh.content_hash():
        logger.warning("Ignoring the cached mesh '%s': its content does not match its hash.", path)
        return None
    return mesh


def store_mesh(key: str, mesh: TetMesh) -> None:
    """Store the mesh under `key`; a cache that cannot be written is reported, never fatal."""
    try:
        with atomic_path(_path(key)) as temporary:
            np.savez_compressed(
                temporary,
                points=mesh.points,
                tets=mesh.tets,
                content_hash=np.array(mesh.content_hash()),
            )
    except (OSError, TactorchError) as error:
        logger.warning("The mesh could not be cached in '%s': %s", cache_folder(), error)


def _path(key: str) -> Path:
    return cache_folder() / "meshes" / f"{key}.npz"
