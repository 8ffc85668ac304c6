"""How far the gel's face moved along z, from the slopes that its colours show."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from tactorch.mesh.values import Real, positive
from tactorch.sensor.depth.integrate import integrate

STEEP = 0.12  # slope from which the face is taken to be deformed
_AROUND_MM = 0.4  # about that it is deformed a little
_TOUCHED = 0.35  # share of the deepest point: contact is below it


@dataclass(frozen=True, eq=False)
class Height:
    """How the face moved.

    Attributes:
        height_mm: Along z, toward the object: negative where it is pressed in.
        free_mm: The same from the slopes alone: its mean is 0, whatever the face did.
        flat: Where it was taken not to be deformed.
        contact: Where it is likely to be touched.
        steepest: The largest slope, of a smoothed image.
    """

    height_mm: Float[np.ndarray, "h w"]
    free_mm: Float[np.ndarray, "h w"]
    flat: Bool[np.ndarray, "h w"]
    contact: Bool[np.ndarray, "h w"]
    steepest: float = 0.0


def height_of(
    slopes: Float[np.ndarray, "h w 2"], mm_per_px: tuple[float, float], steep: Real = STEEP
) -> Height:
    """Integrate slopes, the face being where it was wherever it is not steep.

    Args:
        slopes: dz/dx and dz/dy.
        mm_per_px: Size of a pixel along x and y, mm.
        steep: Slope from which the face counts as deformed: above those that noise and uneven light
            make, below those that a contact does. A wide, flat object makes small ones.

    Raises:
        ConfigError: A slope is not finite, or `steep` not positive.
        ConvergenceError: The heights were not found.
    """
    size = _smooth_size(slopes)
    flat = _flat(size > positive("steep", steep), mm_per_px)
    free = integrate(slopes[..., 0], slopes[..., 1], mm_per_px)
    height = integrate(slopes[..., 0], slopes[..., 1], mm_per_px, flat=flat)
    deepest = float(height.min())
    contact = (height < _TOUCHED * deepest) & ~flat if deepest < 0 else np.zeros_like(flat)
    return Height(height, free, flat, np.asarray(contact), float(size.max()))


def _smooth_size(slopes: Float[np.ndarray, "h w 2"]) -> Float[np.ndarray, "h w"]:
    import cv2

    return np.asarray(cv2.GaussianBlur(np.linalg.norm(slopes, axis=-1), (0, 0), 2.0))


def _flat(
    steep: Bool[np.ndarray, "h w"], mm_per_px: tuple[float, float]
) -> Bool[np.ndarray, "h w"]:
    import cv2

    sizes = [2 * max(1, round(_AROUND_MM / size)) + 1 for size in mm_per_px]
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (sizes[0], sizes[1]))
    # A specky slope is noise; and within a ring of steep slopes the middle of a ball is level.
    clean = cv2.morphologyEx(steep.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    wide = cv2.dilate(clean, disc)
    return np.asarray(~_with_holes(wide > 0))


def _with_holes(mask: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    from scipy.ndimage import binary_fill_holes

    return np.asarray(binary_fill_holes(mask))
