"""Contacts of a round sensor on meshes: loads, and meshes that are fine at the rim."""

import numpy as np
from jaxtyping import Bool, Float

from tactorch.mesh import TetMesh
from tactorch.mesh.closest import closest_points
from tactorch.mesh.refine import Refinement, refine
from tactorch.sampling import Patch

_RIM, _GROWTH = 0.2, 0.6  # longest edge at the rim, over the radius, and its growth with distance


def loads(patch: Patch, mesh: TetMesh, force_n: Float[np.ndarray, "3"]) -> Float[np.ndarray, "n 3"]:
    """Return nodal forces of a uniform traction on the patch with this resultant, N."""
    shares = patch.forces(mesh) @ patch.inward
    return (shares / shares.sum())[:, None] * force_n


def refined_at_rim(mesh: TetMesh, patch: Patch) -> Refinement:
    """Return the mesh refined at the rim of a patch, where its traction ends."""
    radius = patch.radius_mm

    def longest_mm(points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        across, along = patch.coordinates(points)
        return np.asarray(radius * _RIM + _GROWTH * np.hypot(across - radius, along))

    return refine(mesh, longest_mm)


def held_on(mesh: TetMesh, coarse: TetMesh, held: Bool[np.ndarray, " n"]) -> np.ndarray:
    """Return the fixed nodes of a refined mesh: those of surface triangles within fixed ones."""
    result = np.zeros(mesh.n_points, dtype=bool)
    result[: coarse.n_points] = held
    corners = coarse.surface.triangles
    fixed = corners[held[corners].all(axis=1)]
    new = np.arange(coarse.n_points, mesh.n_points)
    if len(fixed) and len(new):
        size = float(np.ptp(coarse.bounds, axis=0).max())
        result[new] = closest_points(coarse.points, fixed, mesh.points[new]).distances < 1e-9 * size
    return result
