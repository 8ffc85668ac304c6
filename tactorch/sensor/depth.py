"""Depth of the gel's outer face: integration of slopes, and pixels covered by markers."""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float
from scipy.fft import dctn, idctn
from scipy.sparse.linalg import spsolve

from tactorch.errors import ConfigError, ConvergenceError
from tactorch.linalg import conjugate_gradients
from tactorch.mesh.values import Real, positive

#: Default slope above which the face counts as deformed.
MIN_SLOPE = 0.12
_MARGIN_MM = 0.4  # around steep pixels, in which the face deforms slightly
_CONTACT_FRACTION = 0.35  # of the largest depth, above which contact is likely
_RTOL = 1e-6
_MAX_ITERATIONS = 500


@dataclass(frozen=True, eq=False)
class HeightMap:
    """Displacement of the face along z, toward the object, at each pixel.

    Attributes:
        height_mm: Displacement with the undeformed region at zero; negative where pressed in.
        zero_mean_mm: Displacement from the slopes alone, with a mean of zero.
        undeformed: Pixels taken as undeformed.
        contact: Pixels that are likely in contact.
        max_slope: Largest slope of the smoothed image.
    """

    height_mm: Float[np.ndarray, "h w"]
    zero_mean_mm: Float[np.ndarray, "h w"]
    undeformed: Bool[np.ndarray, "h w"]
    contact: Bool[np.ndarray, "h w"]
    max_slope: float = 0.0

    @property
    def depth_mm(self) -> float:
        """Depth of the deepest pixel, mm."""
        return -float(self.height_mm.min())


def reconstruct_height(
    slopes: Float[np.ndarray, "h w 2"], mm_per_px: tuple[float, float], min_slope: Real = MIN_SLOPE
) -> HeightMap:
    """Integrate slopes, with the height drawn to zero wherever the face is not steep.

    Args:
        slopes: dz/dx and dz/dy.
        mm_per_px: Size of a pixel along x and y, mm.
        min_slope: Slope above which the face counts as deformed: larger than the slopes from noise
            and uneven light, smaller than those of a contact. Wide, flat objects make small slopes.

    Returns:
        The height map.

    Raises:
        ConfigError: A slope is not finite, or `min_slope` is not positive.
        ConvergenceError: The linear solver does not converge.
    """
    import cv2

    magnitude = np.asarray(cv2.GaussianBlur(np.linalg.norm(slopes, axis=-1), (0, 0), 2.0))
    undeformed = _undeformed(magnitude > positive("min_slope", min_slope), mm_per_px)
    zero_mean = integrate_slopes(slopes[..., 0], slopes[..., 1], mm_per_px)
    height = integrate_slopes(slopes[..., 0], slopes[..., 1], mm_per_px, zero=undeformed)
    lowest = float(height.min())
    contact = (height < _CONTACT_FRACTION * lowest) & ~undeformed & (lowest < 0)
    return HeightMap(height, zero_mean, undeformed, np.asarray(contact), float(magnitude.max()))


def _undeformed(
    steep: Bool[np.ndarray, "h w"], mm_per_px: tuple[float, float]
) -> Bool[np.ndarray, "h w"]:
    import cv2
    from scipy.ndimage import binary_fill_holes

    sizes = [2 * max(1, round(_MARGIN_MM / size)) + 1 for size in mm_per_px]
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (sizes[0], sizes[1]))
    # Isolated steep pixels are noise. The center of a ball is level within a ring of steep slopes.
    opened = cv2.morphologyEx(steep.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    return np.asarray(~binary_fill_holes(cv2.dilate(opened, disc) > 0))


def integrate_slopes(
    slope_x: Float[np.ndarray, "h w"],
    slope_y: Float[np.ndarray, "h w"],
    mm_per_px: tuple[float, float],
    *,
    zero: Bool[np.ndarray, "h w"] | None = None,
    zero_deviation_mm: float = 0.01,
    slope_deviation: float = 0.05,
) -> Float[np.ndarray, "h w"]:
    """Return the heights whose slopes fit the given ones in the least-squares sense, mm.

    The normal equations are Poisson's equation with free edges (Horn and Brooks, 1986), solved by
    cosine transforms. The slopes determine the heights up to a constant, and small errors of the
    slopes bend the surface; a penalty on the height where it is known to be zero removes both.

    Args:
        slope_x: dz/dx along the columns, mm/mm.
        slope_y: dz/dy along the rows, downward.
        mm_per_px: Size of a pixel along x and y, mm.
        zero: Pixels whose height is about zero, outside contact; None makes the mean height zero.
        zero_deviation_mm: Standard deviation of the height at these pixels, mm.
        slope_deviation: Standard deviation of the slopes.

    Returns:
        The heights.

    Raises:
        ConfigError: A slope is not finite, or a size or deviation is not positive.
        ConvergenceError: The linear solver does not converge.
    """
    if not (np.isfinite(slope_x).all() and np.isfinite(slope_y).all()):
        raise ConfigError("slopes are not finite everywhere; fill them in first (`fill_masked`).")
    x, y = (positive("mm_per_px", size) for size in mm_per_px)
    rhs = -_divergence(slope_x, slope_y, x, y)
    eigenvalues = _laplacian_eigenvalues(slope_x.shape, x, y)
    if zero is None or not zero.any():
        return _solve_shifted(rhs, eigenvalues, 0.0)
    deviation = positive("zero_deviation_mm", zero_deviation_mm)
    weight = (positive("slope_deviation", slope_deviation) / deviation) ** 2
    shape = slope_x.shape

    def apply(z: np.ndarray) -> np.ndarray:
        z = z.reshape(shape)
        return (_negative_laplacian(z, x, y) + weight * np.where(zero, z, 0.0)).ravel()

    def precondition(z: np.ndarray) -> np.ndarray:
        return _solve_shifted(z.reshape(shape), eigenvalues, weight * float(zero.mean())).ravel()

    result = conjugate_gradients(
        apply, precondition, rhs.ravel(), rtol=_RTOL, max_iterations=_MAX_ITERATIONS
    )
    if not result.converged:
        raise ConvergenceError(
            f"integration of slopes failed: no convergence in {_MAX_ITERATIONS} iterations; is"
            f" zero_deviation_mm={zero_deviation_mm:g} too small?"
        )
    return result.solution.reshape(shape)


def _divergence(slope_x: np.ndarray, slope_y: np.ndarray, x: float, y: float) -> np.ndarray:
    """Divergence of slopes averaged to pixel edges: the transpose of finite differences."""
    flux_x = 0.5 * (slope_x[:, 1:] + slope_x[:, :-1]) / x
    flux_y = 0.5 * (slope_y[1:] + slope_y[:-1]) / y
    result = np.zeros(slope_x.shape)
    result[:, :-1] += flux_x
    result[:, 1:] -= flux_x
    result[:-1] += flux_y
    result[1:] -= flux_y
    return result


def _negative_laplacian(z: np.ndarray, x: float, y: float) -> np.ndarray:
    """Negative Laplacian with free edges."""
    result = np.zeros(z.shape)
    flux_x, flux_y = np.diff(z, axis=1) / x**2, np.diff(z, axis=0) / y**2
    result[:, :-1] -= flux_x
    result[:, 1:] += flux_x
    result[:-1] -= flux_y
    result[1:] += flux_y
    return result


def _laplacian_eigenvalues(shape: tuple[int, ...], x: float, y: float) -> np.ndarray:
    rows, columns = (2 - 2 * np.cos(np.pi * np.arange(n) / n) for n in shape)
    return rows[:, None] / y**2 + columns[None] / x**2


def _solve_shifted(rhs: np.ndarray, eigenvalues: np.ndarray, shift: float) -> np.ndarray:
    """Solve (negative Laplacian + shift) z = rhs; with a zero shift, the mean of z is zero."""
    coefficients = dctn(rhs, norm="ortho")
    denominator = eigenvalues + shift
    if shift == 0.0:
        coefficients[0, 0], denominator = 0.0, denominator.copy()
        denominator[0, 0] = 1.0
    return idctn(coefficients / denominator, norm="ortho")


def fill_masked(
    values: Float[np.ndarray, "h w"], known: Bool[np.ndarray, "h w"]
) -> Float[np.ndarray, "h w"]:
    """Fill unknown pixels by the solution of Laplace's equation, with free image edges.

    Args:
        values: Field; its values at unknown pixels are ignored.
        known: Pixels whose values are known.

    Returns:
        The field with unknown pixels filled.

    Raises:
        ConfigError: The shapes differ, or no pixel is known.
    """
    if values.shape != known.shape:
        raise ConfigError(f"values are {values.shape}, known is {known.shape}.")
    if not known.any():
        raise ConfigError("no pixel is known; is everything masked as a marker?")
    if known.all():
        return values.copy()
    unknown_index = np.full(values.shape, -1)
    unknown_index[~known] = np.arange(int((~known).sum()))
    matrix, rhs = _laplace_equations(values, unknown_index)
    result = values.copy()
    result[~known] = spsolve(matrix.tocsc(), rhs)
    return result


def _laplace_equations(
    values: np.ndarray, unknown_index: np.ndarray
) -> tuple[sp.coo_matrix, np.ndarray]:
    count = int(unknown_index.max()) + 1
    rhs, degree = np.zeros(count), np.zeros(count)
    rows, columns = [], []
    flat, index = values.ravel(), unknown_index.ravel()
    pixels = np.arange(values.size).reshape(values.shape)
    pairs = [(pixels[:, 1:], pixels[:, :-1]), (pixels[1:], pixels[:-1])]
    for first, second in [*pairs, *[(b, a) for a, b in pairs]]:
        center, neighbor = first.ravel(), second.ravel()
        selected = index[center] >= 0
        center, neighbor = center[selected], neighbor[selected]
        np.add.at(degree, index[center], 1.0)
        unknown = index[neighbor] >= 0
        np.add.at(rhs, index[center[~unknown]], flat[neighbor[~unknown]])
        rows.append(index[center[unknown]])
        columns.append(index[neighbor[unknown]])
    row, column = np.concatenate(rows), np.concatenate(columns)
    off_diagonal = sp.coo_matrix((-np.ones(len(row)), (row, column)), shape=(count, count))
    return (off_diagonal + sp.diags(degree)).tocoo(), rhs
