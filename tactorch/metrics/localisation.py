"""Was the inclusion found: where it is, how strongly, and in which shape?

Both maps are segmented by the same rule (`tactorch.metrics.segment`): past half way from the
background to the extreme, on the side, stiff or soft, on which the truth stands out. All segmented
elements count, so that artefacts elsewhere cost. Position error is a figure of merit of electrical
impedance tomography (GREIT), and contrast recovery is akin to its amplitude response.

A homogeneous truth has no inclusion: all three measures are NaN, "does not apply". A truth that
varies smoothly is segmented like any other, and its measures say how well its stiffest (softest)
part was found.
"""

import numpy as np
from jaxtyping import Bool, Float

from tactorch.mesh import TetMesh
from tactorch.metrics.checks import check_on_mesh
from tactorch.metrics.segment import segment, standing_out, volume_mean

_NAN = float("nan")


def position_error_mm(
    mesh: TetMesh, youngs: Float[np.ndarray, " m"], truth: Float[np.ndarray, " m"]
) -> float:
    """Distance between the centroids of the found and the true inclusion, mm.

    NaN where the truth has no inclusion, or the map shows none.
    """
    found, true = _segments(mesh, youngs, truth)
    if not (found.any() and true.any()):
        return _NAN
    centres = [volume_mean(mesh, mesh.centroids, mask) for mask in (found, true)]
    return float(np.linalg.norm(centres[0] - centres[1]))


def contrast_recovery(
    mesh: TetMesh, youngs: Float[np.ndarray, " m"], truth: Float[np.ndarray, " m"]
) -> float:
    """Contrast of the map between true inclusion and true background, over the true contrast.

    1 is perfect, 0 tells nothing of the inclusion, below 0 has stiff and soft exchanged. Contrast
    is the difference of the means over the volume. NaN where the truth has no inclusion.
    """
    _, true = _segments(mesh, youngs, truth)
    if not true.any():
        return _NAN
    found, right = (
        float(volume_mean(mesh, field, true) - volume_mean(mesh, field, ~true))
        for field in (youngs, truth)
    )
    return found / right


def dice(mesh: TetMesh, youngs: Float[np.ndarray, " m"], truth: Float[np.ndarray, " m"]) -> float:
    """Overlap of the found and the true inclusion by volume, 2 |A n B| / (|A| + |B|), 0 to 1.

    0 where the map shows no inclusion; NaN where the truth has none.
    """
    found, true = _segments(mesh, youngs, truth)
    if not true.any():
        return _NAN
    volumes = mesh.volumes
    both = volumes[found & true].sum()
    return float(2 * both / (volumes[found].sum() + volumes[true].sum()))


def _segments(
    mesh: TetMesh, youngs: Float[np.ndarray, " m"], truth: Float[np.ndarray, " m"]
) -> tuple[Bool[np.ndarray, " m"], Bool[np.ndarray, " m"]]:
    """Segment both maps on the side on which the truth stands out; nothing where it does not."""
    check_on_mesh(mesh, "youngs", youngs)
    check_on_mesh(mesh, "truth", truth)
    side = standing_out(mesh, truth)
    if side is None:
        nothing = np.zeros(mesh.n_tets, dtype=bool)
        return nothing, nothing
    return segment(mesh, youngs, side), segment(mesh, truth, side)
