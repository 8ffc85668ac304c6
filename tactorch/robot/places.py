"""Candidates that lie on the surface as a whole."""

from collections.abc import Sequence

import numpy as np

from tactorch.errors import ConfigError
from tactorch.mesh import TetMesh
from tactorch.mesh.geometry import farthest_point_order
from tactorch.sampling import Patch

_MIN_COVERED = 0.93  # of the area of a patch, by the surface that faces it


def pressable_patches(
    patches: Sequence[Patch], mesh: TetMesh, count: int, *, margin_mm: float = 0.0
) -> list[Patch]:
    """Return patches that lie on the surface as a whole, in farthest-point order.

    The first is the one nearest to the middle of them.

    Args:
        patches: Patches, such as those of `tactorch.sampling.candidate_patches`.
        mesh: The object, mm.
        count: Largest number of patches.
        margin_mm: Distance by which the pose may be wrong, mm.
    """
    whole = [patch for patch in patches if _covered(patch, mesh, margin_mm) >= _MIN_COVERED]
    if not whole:
        raise ConfigError(
            f"no candidate of radius {patches[0].radius_mm:g} mm is on the surface as a whole with "
            f"a margin of {margin_mm:g} mm; use a smaller radius."
            if patches
            else "there is no candidate."
        )
    centers = np.array([patch.center for patch in whole])
    first = int(np.linalg.norm(centers - centers.mean(axis=0), axis=1).argmin())
    return [whole[i] for i in farthest_point_order(centers, min(count, len(whole)), first)]


def _covered(patch: Patch, mesh: TetMesh, margin_mm: float) -> float:
    radius = patch.radius_mm + margin_mm
    wide = Patch(patch.center, patch.inward, radius)
    inside = wide._inside(mesh).mean(axis=1) * mesh.surface.areas
    return float(inside @ np.maximum(wide._cosines(mesh), 0.0) / (np.pi * radius**2))
