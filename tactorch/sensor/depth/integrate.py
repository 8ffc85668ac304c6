"""From slopes to heights: Poisson's equation with free edges, solved by cosine transforms.

Heights minimise the squared difference between their slopes and the given ones (Horn and Brooks,
1986), which leaves a constant open and lets errors of the slopes bow the whole. Both go where the
surface is known to be undeformed: there the height is drawn to zero.
"""

import numpy as np
from jaxtyping import Bool, Float
from scipy.fft import dctn, idctn

from tactorch.errors import ConfigError, ConvergenceError
from tactorch.linalg import conjugate_gradients
from tactorch.mesh.values import positive

_TOLERANCE = 1e-6
_MOST_STEPS = 500


def integrate(
    slope_x: Float[np.ndarray, "h w"],
    slope_y: Float[np.ndarray, "h w"],
    mm_per_px: tuple[float, float],
    *,
    flat: Bool[np.ndarray, "h w"] | None = None,
    flat_mm: float = 0.01,
    slope_noise: float = 0.05,
) -> Float[np.ndarray, "h w"]:
    """Return heights whose slopes are the given ones, as far as can be, mm.

    Args:
        slope_x: dz/dx along the columns, mm/mm.
        slope_y: dz/dy along the rows, downward.
        mm_per_px: Size of a pixel along x and y, mm.
        flat: Where the height is known to be about 0, outside contact; None where that is not
            known: then the mean height is 0.
        flat_mm: Standard deviation of the height there, mm.
        slope_noise: Standard deviation of the slopes.

    Raises:
        ConfigError: A slope is not finite, or a size is no size.
        ConvergenceError: The heights were not found.
    """
    if not (np.isfinite(slope_x).all() and np.isfinite(slope_y).all()):
        raise ConfigError("slopes are not finite everywhere; fill them in first (`filled`).")
    x, y = (positive("mm_per_px", size) for size in mm_per_px)
    right = -_divergence(slope_x, slope_y, x, y)
    stiffness = _eigenvalues(slope_x.shape, x, y)
    if flat is None or not flat.any():
        return _solved(right, stiffness, 0.0)
    weight = (positive("slope_noise", slope_noise) / positive("flat_mm", flat_mm)) ** 2
    shape = slope_x.shape

    def applied(z: np.ndarray) -> np.ndarray:
        z = z.reshape(shape)
        return (_laplacian(z, x, y) + weight * np.where(flat, z, 0.0)).ravel()

    def eased(z: np.ndarray) -> np.ndarray:
        return _solved(z.reshape(shape), stiffness, weight * float(flat.mean())).ravel()

    result = conjugate_gradients(
        applied, eased, right.ravel(), rtol=_TOLERANCE, max_iterations=_MOST_STEPS
    )
    if not result.converged:
        raise ConvergenceError(
            f"heights were not found in {_MOST_STEPS} steps; is flat_mm={flat_mm:g} too small?"
        )
    return result.solution.reshape(shape)


def _divergence(slope_x: np.ndarray, slope_y: np.ndarray, x: float, y: float) -> np.ndarray:
    """Of slopes halfway between pixels, none leaving the image: the transpose of differences."""
    across = 0.5 * (slope_x[:, 1:] + slope_x[:, :-1]) / x
    along = 0.5 * (slope_y[1:] + slope_y[:-1]) / y
    found = np.zeros(slope_x.shape)
    found[:, :-1] += across
    found[:, 1:] -= across
    found[:-1] += along
    found[1:] -= along
    return found


def _laplacian(z: np.ndarray, x: float, y: float) -> np.ndarray:
    """The negative Laplacian with free edges."""
    found = np.zeros(z.shape)
    across, along = np.diff(z, axis=1) / x**2, np.diff(z, axis=0) / y**2
    found[:, :-1] -= across
    found[:, 1:] += across
    found[:-1] -= along
    found[1:] += along
    return found


def _eigenvalues(shape: tuple[int, ...], x: float, y: float) -> np.ndarray:
    rows, columns = (2 - 2 * np.cos(np.pi * np.arange(n) / n) for n in shape)
    return rows[:, None] / y**2 + columns[None] / x**2


def _solved(right: np.ndarray, stiffness: np.ndarray, shift: float) -> np.ndarray:
    """Solve (negative Laplacian + shift) z = right; without a shift, the mean is 0."""
    waves = dctn(right, norm="ortho")
    below = stiffness + shift
    if shift == 0.0:
        waves[0, 0], below = 0.0, below.copy()
        below[0, 0] = 1.0
    return idctn(waves / below, norm="ortho")
