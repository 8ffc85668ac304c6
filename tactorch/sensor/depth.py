"""Depth of the gel's outer face: integration of slopes, and pixels covered by markers."""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float
from scipy.fft import dctn, idctn
from scipy.sparse.linalg import splu

from tactorch.errors import ConfigError, ConvergenceError
from tactorch.linalg import conjugate_gradients
from tactorch.mesh.values import Real, positive
from tactorch.sensor.light import LightChange

#: Default slope above which the face counts as deformed.
MIN_SLOPE = 0.12
_MARGIN_MM = 0.4  # least distance of undeformed pixels from deformed ones
_MIN_STEEP_MM2, _MIN_STEEP_PX = 0.02, 9.0  # smallest area of steep pixels that is not noise
_DEEP_FRACTION = 0.4  # of the depth of steep pixels, below which level ones are deformed
_CONTACT_FRACTION = 0.35  # of the largest depth, above which contact is likely
_RTOL, _LEVEL_RTOL = 1e-6, 1e-3
_MAX_ITERATIONS = 500

Field = Float[np.ndarray, "h w"]
Mask = Bool[np.ndarray, "h w"]
PixelSize = tuple[float, float]


@dataclass(frozen=True, eq=False)
class HeightMap:
    """Displacement of the face along z, toward the object, at each pixel.

    Attributes:
        height_mm: Displacement with the undeformed region at zero; negative where pressed in.
        zero_mean_mm: Displacement from the slopes alone, with a mean of zero.
        undeformed: Pixels taken as undeformed.
        contact: Pixels that are likely in contact.
        max_slope: Largest slope of the smoothed image.
        light: Change of the light, which is corrected; None if unknown.
    """

    height_mm: Field
    zero_mean_mm: Field
    undeformed: Mask
    contact: Mask
    max_slope: float = 0.0
    light: LightChange | None = None

    @property
    def depth_mm(self) -> float:
        """Depth of the deepest pixel, mm."""
        return -float(self.height_mm.min())

    @property
    def light_error_mm(self) -> float:
        """Error of this depth from a change of the light, mm."""
        return 0.0 if self.light is None else abs(self.depth_mm) * self.light.error


def reconstruct_height(
    slopes: Float[np.ndarray, "h w 2"], mm_per_px: PixelSize, min_slope: Real = MIN_SLOPE
) -> HeightMap:
    """Return the height from slopes, relative to the face far from any contact.

    The face also moves around a contact, by an amount that decreases over about the contact's own
    size. Its height is therefore only drawn to zero at larger distances from pixels that are steep,
    or as deep as those.

    Args:
        slopes: dz/dx and dz/dy.
        mm_per_px: Size of a pixel along x and y, mm.
        min_slope: Slope above which the face counts as deformed: larger than the slopes from noise
            and uneven light, smaller than those of a contact. Wide, flat objects make small slopes.

    Raises:
        ConvergenceError: The linear solver does not converge.
    """
    magnitude = np.asarray(cv2.GaussianBlur(np.linalg.norm(slopes, axis=-1), (0, 0), 2.0))
    steep = magnitude > positive("min_slope", min_slope)
    zero_mean = integrate_slopes(slopes[..., 0], slopes[..., 1], mm_per_px)
    deformed = _deformed(steep, zero_mean, mm_per_px)
    undeformed = _undeformed(deformed, mm_per_px)
    # Where the face is deformed, the first height is only compared with a level.
    rtol = _LEVEL_RTOL if deformed.any() else _RTOL
    height = integrate_slopes(slopes[..., 0], slopes[..., 1], mm_per_px, zero=undeformed, rtol=rtol)
    if deformed.any():  # with the level of the undeformed face, which the mean is not
        undeformed = _undeformed(_deformed(steep, height, mm_per_px), mm_per_px)
        height = integrate_slopes(slopes[..., 0], slopes[..., 1], mm_per_px, zero=undeformed)
    contact = find_contact(height, undeformed)
    return HeightMap(height, zero_mean, undeformed, contact, float(magnitude.max()))


def find_contact(height_mm: Field, undeformed: Mask) -> Mask:
    """Return pixels that are likely in contact: those of more than a third of the depth."""
    lowest = float(height_mm.min())
    return np.asarray((height_mm < _CONTACT_FRACTION * lowest) & ~undeformed & (lowest < 0))


def _deformed(steep: Mask, height: Field, mm_per_px: PixelSize) -> Mask:
    """Pixels that are steep, or as deep as steep ones: the face under a flat object is level."""
    from scipy.ndimage import binary_fill_holes

    # Isolated steep pixels are noise. Edges of flat objects are thin.
    kept = _without_specks(steep, _MIN_STEEP_MM2 / (mm_per_px[0] * mm_per_px[1]))
    if not kept.any() or kept.all():
        return kept
    level = float(np.median(height[~kept]))
    depth = level - float(height[kept].min())
    deep = height < level - _DEEP_FRACTION * depth
    # Only where a steep edge leads down to it.
    _, labels = cv2.connectedComponents((kept | deep).astype(np.uint8))
    return np.asarray(binary_fill_holes(np.isin(labels, np.unique(labels[kept]))))


def _without_specks(mask: Mask, area_px: float) -> Mask:
    """Remove connected parts that are smaller than an area."""
    _, labels, statistics, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
    large = statistics[:, cv2.CC_STAT_AREA] >= max(_MIN_STEEP_PX, area_px)
    large[0] = False
    return np.asarray(large[labels])


def _undeformed(deformed: Mask, mm_per_px: PixelSize) -> Mask:
    """Pixels farther from the deformed region than the radius of a disc of its area."""
    from scipy.ndimage import distance_transform_edt

    if not deformed.any():
        return np.ones(deformed.shape, dtype=bool)
    x, y = mm_per_px
    radius = float(np.sqrt(deformed.sum() * x * y / np.pi))
    distance = distance_transform_edt(~deformed, sampling=(y, x))
    # A contact that fills the image leaves at least its farthest pixels.
    return np.asarray(distance > min(max(radius, _MARGIN_MM), 0.8 * float(distance.max())))


def integrate_slopes(
    slope_x: Field,
    slope_y: Field,
    mm_per_px: PixelSize,
    *,
    zero: Mask | None = None,
    zero_deviation_mm: float = 0.01,
    slope_deviation: float = 0.05,
    rtol: float = _RTOL,
) -> Field:
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
        rtol: Relative residual of the solution with known heights.

    Raises:
        ConvergenceError: The linear solver does not converge.
    """
    if not (np.isfinite(slope_x).all() and np.isfinite(slope_y).all()):
        raise ConfigError("slopes are not finite everywhere; fill them in first (`fill_masked`).")
    x, y = (positive("mm_per_px", size) for size in mm_per_px)
    edge_x, edge_y = slope_x[:, 1:] + slope_x[:, :-1], slope_y[1:] + slope_y[:-1]
    rhs = -_divergence(0.5 * edge_x / x, 0.5 * edge_y / y)
    shape = slope_x.shape
    eigenvalues = laplacian_eigenvalues(shape, (x, y))
    if zero is None or not zero.any():
        eigenvalues[0, 0] = np.inf  # makes the mean zero
        return divide_spectrum(rhs, eigenvalues)
    deviation = positive("zero_deviation_mm", zero_deviation_mm)
    weight = (positive("slope_deviation", slope_deviation) / deviation) ** 2

    def apply(z: np.ndarray) -> np.ndarray:
        z = z.reshape(shape)
        laplacian = _divergence(np.diff(z, axis=1) / x**2, np.diff(z, axis=0) / y**2)
        return (weight * np.where(zero, z, 0.0) - laplacian).ravel()

    spectrum = eigenvalues + weight * float(zero.mean())

    def precondition(z: np.ndarray) -> np.ndarray:
        return divide_spectrum(z.reshape(shape), spectrum).ravel()

    result = conjugate_gradients(
        apply, precondition, rhs.ravel(), rtol=rtol, max_iterations=_MAX_ITERATIONS
    )
    if not result.converged:
        raise ConvergenceError(
            f"integration of slopes failed: no convergence in {_MAX_ITERATIONS} iterations; is"
            f" zero_deviation_mm={zero_deviation_mm:g} too small?"
        )
    return result.solution.reshape(shape)


def _divergence(flux_x: np.ndarray, flux_y: np.ndarray) -> np.ndarray:
    """Divergence of fluxes between neighboring pixels, without flux through the image's edges."""
    divergence = np.zeros((len(flux_x), flux_y.shape[1]))
    divergence[:, :-1] += flux_x
    divergence[:, 1:] -= flux_x
    divergence[:-1] += flux_y
    divergence[1:] -= flux_y
    return divergence


def laplacian_eigenvalues(shape: tuple[int, int], mm_per_px: PixelSize) -> Field:
    """Return the eigenvalues of `grid_laplacian`, whose eigenvectors are cosines, 1/mm^2."""
    rows, columns = (
        (2 - 2 * np.cos(np.pi * np.arange(n) / n)) / size**2
        for n, size in zip(shape, mm_per_px[::-1], strict=True)
    )
    return rows[:, None] + columns


def divide_spectrum(values: Field, spectrum: Field) -> Field:
    """Return the image whose cosine transform is that of another one over a spectrum."""
    return idctn(dctn(values, norm="ortho") / spectrum, norm="ortho")


def fill_masked(values: Float[np.ndarray, "h w *c"], known: Mask) -> Float[np.ndarray, "h w *c"]:
    """Fill unknown pixels of fields by the solution of Laplace's equation, with free image edges.

    Values at unknown pixels are ignored.
    """
    if values.shape[:2] != known.shape:
        raise ConfigError(f"values are {values.shape}, known is {known.shape}.")
    if not known.any():
        raise ConfigError("no pixel is known; is everything masked as a marker?")
    if known.all():
        return values.copy()
    filled, inner = values.copy(), known.ravel()
    rows = grid_laplacian(known.shape)[~inner]
    rhs = rows[:, inner] @ -values[known].reshape(inner.sum(), -1)
    solution = splu(rows[:, ~inner].tocsc()).solve(rhs)
    filled[~known] = solution.reshape(filled[~known].shape)
    return filled


@lru_cache(maxsize=4)
def grid_laplacian(shape: tuple[int, int], mm_per_px: PixelSize = (1.0, 1.0)) -> sp.csr_matrix:
    """Return the negative Laplacian of an image with free edges, 1/mm^2."""
    differences = (sp.diags([-1.0, 1.0], [0, 1], shape=(n - 1, n)) for n in shape)
    along_rows, along_columns = (
        difference.T @ difference / size**2
        for difference, size in zip(differences, mm_per_px[::-1], strict=True)
    )
    return sp.kronsum(along_columns, along_rows).tocsr()
