"""The six sides of an object, by name: `x-`, `x+`, `y-`, `y+`, `z-`, `z+`."""

import numpy as np
from jaxtyping import Int

from tactorch.errors import ConfigError, MeshError
from tactorch.mesh.tetmesh import TetMesh
from tactorch.mesh.values import Real

FACE_NAMES = ("x-", "x+", "y-", "y+", "z-", "z+")
# A triangle belongs to a side if it turns less than 45 degrees away from it.
_FACING = np.sqrt(0.5)


def select_face(mesh: TetMesh, name: str, tolerance: Real = 2e-3) -> Int[np.ndarray, " k"]:
    """Find the boundary triangles on one side of the bounding box.

    Args:
        mesh: The mesh.
        name: One of `FACE_NAMES`.
        tolerance: How far a vertex may lie from the side's plane, as a share of the bounding
            box's diagonal. The default leaves room for the envelope of `tetrahedralize`.

    Returns:
        Ascending indices into `mesh.surface.triangles`; at least one.

    Raises:
        ConfigError: The name or tolerance has no meaning.
        MeshError: No triangle lies on that side: the object is round there.
    """
    axis, high = _parse(name)
    if not 0 <= tolerance < 0.5:
        raise ConfigError(f"tolerance={tolerance} must be in [0, 0.5), a share of the diagonal.")
    surface = mesh.surface
    depth = np.abs(mesh.points[surface.triangles, axis] - mesh.bounds[high, axis]).max(axis=1)
    outward = surface.normals[:, axis] * (1 if high else -1)
    found = np.flatnonzero((depth <= tolerance * mesh.diagonal) & (outward > _FACING))
    if not found.size:
        raise MeshError(
            f"No boundary triangle lies on side '{name}' within {tolerance:g} of the bounding"
            f" box's diagonal ({mesh.diagonal:.4g} mm): the mesh is not flat there."
            " Raise the tolerance, or select triangles by their position."
        )
    return found


def face_nodes(mesh: TetMesh, name: str, tolerance: Real = 2e-3) -> Int[np.ndarray, " k"]:
    """Return the nodes of `select_face`, ascending, each once; same arguments and errors."""
    return np.unique(mesh.surface.triangles[select_face(mesh, name, tolerance)])


def _parse(name: str) -> tuple[int, int]:
    if name not in FACE_NAMES:
        raise ConfigError(f"Unknown face '{name}'; choose one of {', '.join(FACE_NAMES)}.")
    return "xyz".index(name[0]), int(name[1] == "+")
