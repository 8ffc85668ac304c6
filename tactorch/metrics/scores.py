"""All metrics of a map."""

import numpy as np
from jaxtyping import Float

from tactorch.mesh import TetMesh
from tactorch.metrics.fields import normalised_correlation, pearson, psnr, rmse_mpa
from tactorch.metrics.localisation import contrast_recovery, dice, position_error_mm
from tactorch.metrics.volume import ssim


def scores(
    mesh: TetMesh, youngs: Float[np.ndarray, " m"], truth: Float[np.ndarray, " m"]
) -> dict[str, float]:
    """Score a map against the truth.

    Args:
        mesh: The body, m elements.
        youngs: Moduli, (m,), MPa.
        truth: True moduli, (m,), MPa.

    Returns:
        `rmse_mpa`, `pearson`, `normalised_correlation`, `ssim` (3-D, range 1 MPa), `psnr` (range
        1 MPa, dB), `position_error_mm`, `contrast_recovery`, `dice`, as defined by the functions of
        these names; NaN where a metric does not apply.

    Raises:
        MeshError: A field does not fit the mesh.
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
