"""Position, contrast and shape of the inclusion against the truth.

Both maps are segmented by the same rule (`tactorch.metrics.segment`): past half way from the
background to the extreme, on the side (stiff or soft) of the true inclusion. All segmented
elements count, so that artefacts elsewhere lower the scores. Position error is a figure of merit of
electrical impedance tomography (GREIT), and contrast recovery is akin to its amplitude response.

A homogeneous truth has no inclusion: all three measures are NaN. A smoothly varying truth is
segmented like any other; the measures then refer to its stiffest (softest) part.
"""

import numpy as np
from jaxtyping import Bool, Float

from tactorch.mesh import TetMesh
from tactorch.metrics.checks import check_on_mesh
from tactorch.metrics.segment import inclusion_side, segment, volume_mean

_NAN = float("nan")


def position_error_mm(
    mesh: TetMesh, youngs: Float[np.ndarray, " m"], truth: Float[np.ndarray, " m"]
) -> float:
    """Return the distance between the centroids of the segmented and the true inclusion, mm.

    NaN if the truth or the map has no inclusion.
    """
    masks = _segments(mesh, youngs, truth)
    if not all(mask.any() for mask in masks):
        return _NAN
    centres = [volume_mean(mesh, mesh.centroids, mask) for mask in masks]
    return float(np.linalg.norm(centres[0] - centres[1]))


def contrast_recovery(
    mesh: TetMesh, youngs: Float[np.ndarray, " m"], truth: Float[np.ndarray, " m"]
) -> float:
    """Return the contrast of true inclusion and background in the map over the true contrast.

    1 is perfect, 0 shows no inclusion, below 0 has stiff and soft exchanged. Contrast is the
    difference of the volume means. NaN if the truth has no inclusion.
    """
    _, true = _segments(mesh, youngs, truth)
    if not true.any():
        return _NAN
    contrast, true_contrast = (
        float(volume_mean(mesh, field, true) - volume_mean(mesh, field, ~true))
        for field in (youngs, truth)
    )
    return contrast / true_contrast


def dice(mesh: TetMesh, youngs: Float[np.ndarray, " m"], truth: Float[np.ndarray, " m"]) -> float:
    """Return the volume overlap of segmented and true inclusion, 2 |A n B| / (|A| + |B|), 0 to 1.

    0 if the map has no inclusion; NaN if the truth has none.
    """
    segmented, true = _segments(mesh, youngs, truth)
    if not true.any():
        return _NAN
    volumes = mesh.volumes
    overlap = volumes[segmented & true].sum()
    return float(2 * overlap / (volumes[segmented].sum() + volumes[true].sum()))


def _segments(
    mesh: TetMesh, youngs: Float[np.ndarray, " m"], truth: Float[np.ndarray, " m"]
) -> tuple[Bool[np.ndarray, " m"], Bool[np.ndarray, " m"]]:
    """Segment both maps on the side of the true inclusion; empty masks if there is none."""
    check_on_mesh(mesh, "youngs", youngs)
    check_on_mesh(mesh, "truth", truth)
    side = inclusion_side(mesh, truth)
    if side is None:
        empty = np.zeros(mesh.n_tets, dtype=bool)
        return empty, empty
    return segment(mesh, youngs, side), segment(mesh, truth, side)
