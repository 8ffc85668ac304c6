"""Metrics of a map against the truth; both are moduli per element, (m,), in MPa.

**Over the list of elements**, each counts once, regardless of its volume, as in the paper (section
IV-A, Metrics). The scores published with the cases of the paper (RMSE, SSIM, PSNR, "Cosine
Similarity") are reproduced to all six digits by `rmse_mpa`, `ssim_1d(..., range_mpa=R)`,
`psnr(..., range_mpa=R)` and `pearson`, where R is 1.499 MPa for box-3 and 3.999 MPa for box-torus:
a fixed scale of 0.001 to 1.5 (4.0) MPa, slightly wider than the range of the true moduli. With
`range_mpa="truth"` both differ in the second digit. Table II of the paper has a range of 1 MPa, the
default here.

**Position, contrast and shape of the inclusion**: both maps are segmented by the same rule
(`tactorch.metrics.segment`), on the side (stiff or soft) of the true inclusion. All segmented
elements count, so that artefacts elsewhere lower the scores. Position error is a figure of merit of
electrical impedance tomography (GREIT), and contrast recovery is akin to its amplitude response. A
homogeneous truth has no inclusion: all three measures are NaN. A smoothly varying truth is
segmented like any other; the measures then refer to its stiffest (softest) part.
"""

from typing import Literal

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError, MeshError
from tactorch.mesh import TetMesh, VoxelGrid
from tactorch.metrics.segment import Field, Mask, check_field, inclusion_side, segment, volume_mean

Array = Float[np.ndarray, "..."]
Range = float | Literal["truth"]
_NAN = float("nan")


def scores(mesh: TetMesh, youngs: Field, truth: Field) -> dict[str, float]:
    """Score a map against the truth.

    Returns:
        `rmse_mpa`, `pearson`, `normalised_correlation`, `ssim` (3-D, range 1 MPa), `psnr` (range
        1 MPa, dB), `position_error_mm`, `contrast_recovery`, `dice`, as defined by the functions of
        these names; NaN where a metric does not apply.
    """
    return {
        "rmse_mpa": rmse_mpa(youngs, truth),
        "pearson": pearson(youngs, truth),
        "normalised_correlation": normalised_correlation(youngs, truth),
        "ssim": ssim(mesh, youngs, truth),
        "psnr": psnr(youngs, truth),
        "position_error_mm": position_error_mm(mesh, youngs, truth),
        "contrast_recovery": contrast_recovery(mesh, youngs, truth),
        "dice": dice(mesh, youngs, truth),
    }


def rmse_mpa(youngs: Field, truth: Field) -> float:
    """Return the root mean square error over the elements, MPa."""
    _check_pair(youngs, truth)
    return float(np.sqrt(np.mean((youngs - truth) ** 2)))


def pearson(youngs: Field, truth: Field) -> float:
    """Return Pearson's correlation over the elements, -1 to 1; NaN if a field is constant.

    It is invariant under scaling and shift. The authors call it cosine similarity.
    """
    _check_pair(youngs, truth)
    a, b = _centred(youngs), _centred(truth)
    length = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(np.clip(a @ b / length, -1.0, 1.0)) if length > 0 else _NAN


def normalised_correlation(youngs: Field, truth: Field) -> float:
    """Return the normalised correlation s (section IV-A), 0 to 1; NaN if a field is constant.

    s = |<e_gt - mean e_gt, e - mean e>| / (||e_gt - mean e_gt|| ||e - mean e||), the magnitude of
    Pearson's correlation: a map with hard and soft exchanged scores as high as the correct one.
    """
    return abs(pearson(youngs, truth))


def psnr(youngs: Field, truth: Field, range_mpa: Range = 1.0) -> float:
    """Return the peak signal-to-noise ratio 20 log10(range / RMSE), dB; infinite if RMSE is 0.

    The range of the data is in MPa (1 in Table II), or "truth" for max - min of the truth.
    """
    error, peak = rmse_mpa(youngs, truth), _range(range_mpa, truth)
    return float(20 * np.log10(peak / error)) if error > 0 else float("inf")


def ssim_1d(youngs: Field, truth: Field, window: int = 401, range_mpa: Range = "truth") -> float:
    """Return the structural similarity of the two lists of elements, as the paper's authors do.

    The window slides over elements in mesh order, which has no spatial meaning: use it only to
    compare with the published numbers, and `tactorch.metrics.ssim` otherwise.

    Args:
        youngs: Moduli of the map.
        truth: True moduli.
        window: Length of the window, odd and at most m.
        range_mpa: Range of the data, MPa, or "truth" for max - min of the truth.
    """
    _check_pair(youngs, truth)
    peak = _range(range_mpa, truth)
    return float(local_ssim(youngs, truth, window, peak, "elements")[0])


def ssim(
    mesh: TetMesh,
    youngs: Field,
    truth: Field,
    *,
    voxels: int = 24,
    window: int = 7,
    range_mpa: float = 1.0,
) -> float:
    """Return the mean structural similarity over the body, on the scale of the paper's tables.

    The bounding box is divided into `voxels` in each direction; each voxel takes the modulus of the
    element with the nearest centroid. Voxels outside the body extend its modulus outward, so that
    windows across the surface contain no artificial step; they are excluded from the mean. So are
    voxels whose window exceeds the grid, unless no voxel of the body would be left. For a box this
    equals `skimage.metrics.structural_similarity` of the two grids.

    Args:
        mesh: The body, m elements.
        youngs: Moduli, (m,), MPa.
        truth: True moduli, (m,), MPa.
        voxels: Voxels in each direction.
        window: Edge of the cubic window, voxels, odd.
        range_mpa: Range of the data, MPa.
    """
    _check_pair(youngs, truth, mesh)
    peak, grid = _range(range_mpa, truth), VoxelGrid(mesh, voxels)
    _, similarity = local_ssim(grid.fill(youngs), grid.fill(truth), window, peak, "voxels")
    inner, margin = np.zeros_like(grid.inside), window // 2
    inner[(slice(margin, -margin),) * 3] = True
    counted = grid.inside & inner
    return float(similarity[counted if counted.any() else grid.inside].mean())


def local_ssim(
    youngs: Array, truth: Array, window: int, range_mpa: float, of: str
) -> tuple[float, Array]:
    """Return the structural similarity of two arrays, its mean and around each entry."""
    from skimage.metrics import structural_similarity

    if window % 2 == 0 or not 3 <= window <= len(truth):
        raise ConfigError(f"window is {window}; it must be odd, and from 3 to {len(truth)} {of}")
    mean, local = structural_similarity(
        youngs, truth, win_size=window, data_range=range_mpa, full=True
    )
    return mean, local


def position_error_mm(mesh: TetMesh, youngs: Field, truth: Field) -> float:
    """Return the distance between the centroids of the segmented and the true inclusion, mm.

    NaN if the truth or the map has no inclusion.
    """
    masks = _segments(mesh, youngs, truth)
    if not all(mask.any() for mask in masks):
        return _NAN
    first, second = (volume_mean(mesh, mesh.centroids, mask) for mask in masks)
    return float(np.linalg.norm(first - second))


def contrast_recovery(mesh: TetMesh, youngs: Field, truth: Field) -> float:
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


def dice(mesh: TetMesh, youngs: Field, truth: Field) -> float:
    """Return the volume overlap of segmented and true inclusion, 2 |A n B| / (|A| + |B|), 0 to 1.

    0 if the map has no inclusion; NaN if the truth has none.
    """
    segmented, true = _segments(mesh, youngs, truth)
    if not true.any():
        return _NAN
    volumes = mesh.volumes
    overlap = volumes[segmented & true].sum()
    return float(2 * overlap / (volumes[segmented].sum() + volumes[true].sum()))


def _segments(mesh: TetMesh, youngs: Field, truth: Field) -> tuple[Mask, Mask]:
    """Segment both maps on the side of the true inclusion; empty masks if there is none."""
    _check_pair(youngs, truth, mesh)
    side = inclusion_side(mesh, truth)
    if side is None:
        empty = np.zeros(mesh.n_tets, dtype=bool)
        return empty, empty
    return segment(mesh, youngs, side), segment(mesh, truth, side)


def _check_pair(youngs: Field, truth: Field, mesh: TetMesh | None = None) -> None:
    """Raise MeshError unless both fields are valid, of equal length, and fit the mesh if given."""
    for name, values in (("youngs", youngs), ("truth", truth)):
        check_field(name, values, mesh)
    if len(youngs) != len(truth):
        raise MeshError(
            f"youngs has {len(youngs)} values and truth {len(truth)}; compare fields of one mesh"
        )


def _range(range_mpa: Range, truth: Field) -> float:
    peak = float(np.ptp(truth)) if range_mpa == "truth" else float(range_mpa)
    if not (np.isfinite(peak) and peak > 0):
        raise ConfigError(
            f"range_mpa is {range_mpa!r}, that is {peak:g} MPa; give a range above 0 "
            "(a homogeneous truth has none)"
        )
    return peak


def _centred(values: Field) -> Field:
    """Remove the mean; the round-off that is left of a constant field is set to zero."""
    centred = values - values.mean()
    return centred if np.ptp(values) > 1e-12 * np.abs(values).max() else np.zeros_like(values)
