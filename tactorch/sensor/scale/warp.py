"""A camera that looks askew: the warp that makes pixels square and alike, from a known shape."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError
from tactorch.sensor.description import SensorDescription
from tactorch.sensor.scale.plane import Fit, Plane, fit_plane
from tactorch.sensor.scale.shape import KnownShape, Outline

_MISFIT, _LEAST_MISFIT_PX = 0.03, 1.5  # of the size: residual from which it is another shape


@dataclass(frozen=True, eq=False)
class Warp:
    """How to warp images so that a pixel is as large everywhere.

    Attributes:
        corners_px: `warp_corners_px` of a description.
        deviation_px: Standard deviation of their places.
        mm_per_px: Size of a pixel once warped, mm, along x and y alike.
        residual_px: Root mean square distance of corners from those of the shape.
    """

    corners_px: Float[np.ndarray, "4 2"]
    deviation_px: float
    mm_per_px: float
    residual_px: float

    def applied(self, sensor: SensorDescription) -> SensorDescription:
        """Return a description with this warp and its scale, for `save_sensor`."""
        corners = tuple((float(x), float(y)) for x, y in self.corners_px)
        return replace(sensor, warp_corners_px=corners, mm_per_px=(self.mm_per_px, self.mm_per_px))


def warp_of(outlines: Sequence[Outline], shape: KnownShape, sensor: SensorDescription) -> Warp:
    """Find the warp of a camera that looks askew, from the corners of a known shape.

    What is in the image's middle stays there, as it is turned.

    Args:
        outlines: Corners in raw (undistorted) images. A hexagon's in one, or a cuboid's in two at
            least, turned and moved between them.
        shape: What was pressed.
        sensor: What the images were taken with; without a warp or a crop.

    Raises:
        ConfigError: The description has a warp already, there are too few corners, or they are
            those of another shape.
    """
    if sensor.warp_corners_px is not None or sensor.crop_px is not None:
        raise ConfigError(
            f"sensor '{sensor.name}' has warp_corners_px or crop_px already; give a description"
            " without, and corners in images that are neither warped nor cropped."
        )
    if not outlines:
        raise ConfigError("no image of a known shape to find the warp with.")
    x, y = (float(size) for size in sensor.mm_per_px)
    middle = (np.array(sensor.image_size_px, dtype=float) - 1) / 2
    fit = fit_plane(outlines, shape, y / x, middle, tilted=True)
    size = min(float(np.ptp(outline.corners_px, axis=0).max()) for outline in outlines)
    if fit.residual_px > max(_MISFIT * size, _LEAST_MISFIT_PX):
        worst = int(np.argmax([np.linalg.norm(part) for part in fit.residuals_px]))
        raise ConfigError(
            f"{outlines[worst].name}: its corners are no {shape.name} of that size, however it is"
            f" looked at, but {fit.residual_px:.1f} px off; check the shape and the corners."
        )
    corners, scale = _corners(fit.plane)
    return Warp(corners, _deviation(fit), scale, fit.residual_px)


def _corners(plane: Plane) -> tuple[Float[np.ndarray, "4 2"], float]:
    """What becomes the corners of an image of square pixels, and their size."""
    scale = float(np.sqrt(plane.scale.prod()))
    signs = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)], dtype=float)
    return plane.to_px(signs * plane.middle_px * scale), scale


def _deviation(fit: Fit) -> float:
    """Of the corners, by differences."""
    terms, step = fit.plane.terms, 1e-6
    base, _ = _corners(fit.plane)
    columns = []
    for i in range(len(terms)):
        changed = terms.copy()
        changed[i] += step
        columns.append((_corners(Plane(changed, fit.plane.middle_px))[0] - base).ravel() / step)
    slope = np.stack(columns, axis=1)
    return float(np.sqrt(np.trace(slope @ fit.covariance @ slope.T) / 8))
