"""Size of a pixel from an object of known size pressed into the gel (Section VI-B).

The corners of a flat face in any position and rotation determine the size of a pixel along x and y:
each image adds three unknowns, and a triangle has six coordinates. They do not determine a common
offset of all edges; its uncertainty adds to the standard deviation. For an inclined camera, the
corners also determine the perspective warp that makes all pixels square and of equal size.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.optimize import approx_fprime, least_squares

from tactorch.errors import ConfigError
from tactorch.sensor.description import SensorDescription
from tactorch.sensor.scale.shape import Corners, KnownShape, Outline, rotate, square_side

_POSE_UNKNOWNS = 3  # rotation and position in each image
_MAX_RESIDUAL, _MIN_RESIDUAL_PX = 0.03, 1.5  # relative to the size, and absolute
_MAX_DISAGREEMENT, _MAX_DEVIATIONS = 0.02, 4.0  # of an image's scale from the others'
_DIFFERENCE_STEP = 1e-6
_PERSPECTIVE_TERMS = 5


@dataclass(frozen=True, eq=False)
class PixelScale:
    """Measured size of a pixel.

    Attributes:
        mm_per_px: Size along x and y, mm.
        deviation: Standard deviation of both, mm.
        residual_px: Root mean square residual of the corners.
        corners_px: Corners in each image by name.
    """

    mm_per_px: tuple[float, float]
    deviation: tuple[float, float]
    residual_px: float
    corners_px: Mapping[str, Float[np.ndarray, "_ 2"]]

    def disagreement(self, sensor: SensorDescription) -> str:
        """Return a message if the scale of a description is inconsistent, or "".

        It is inconsistent if it differs by more than three standard deviations and 0.5 %.
        """
        messages = []
        for axis, measured, deviation, described in zip(
            "xy", self.mm_per_px, self.deviation, sensor.mm_per_px, strict=True
        ):
            difference = measured / described - 1.0
            if abs(difference) > max(3.0 * deviation / measured, 0.005):
                messages.append(
                    f"along {axis} {measured:.5g} mm per px were measured (+- {deviation:.1g}),"
                    f" {difference:+.1%} of mm_per_px={described:.5g} in the description of"
                    f" '{sensor.name}'"
                )
        return "; ".join(messages)

    def apply_to(self, sensor: SensorDescription) -> SensorDescription:
        """Return a description with this scale."""
        return replace(sensor, mm_per_px=self.mm_per_px)


def measure_pixel_scale(
    outlines: Sequence[Outline], shape: KnownShape, sensor: SensorDescription
) -> PixelScale:
    """Measure the size of a pixel from the corners of a known shape.

    Args:
        outlines: Corners in one or more images, in rectified pixels.
        shape: Pressed shape.
        sensor: Sensor that took the images; its pixel aspect ratio is only used to distinguish the
            sides of a cuboid.

    Raises:
        ConfigError: There is no image; an outline has another number of corners, corners of
            another shape or outside the image, or another scale than the other images.
    """
    if not outlines:
        raise ConfigError("no image of a known shape to measure the pixel's size with.")
    _require_agreement(outlines, [_fit_outline(outline, shape, sensor) for outline in outlines])
    fit = _fit_plane(outlines, shape, sensor)
    scale, random = fit.scale, np.sqrt(np.diag(fit.covariance))
    deviation = scale * np.hypot(random, _edge_deviation(outlines, shape))
    corners = {outline.name: outline.corners_px for outline in outlines}
    (x, y), (dx, dy) = scale.tolist(), deviation.tolist()
    return PixelScale((x, y), (dx, dy), fit.residual_px, corners)


def _fit_outline(outline: Outline, shape: KnownShape, sensor: SensorDescription) -> "_PlaneFit":
    """Fit a single outline, which must be inside the image and have the known shape."""
    width, height = sensor.image_size_px
    x, y = outline.corners_px.T
    margin = 0.1 * min(width, height)  # visible edges may intersect slightly outside
    outside = (x < -margin) | (y < -margin) | (x > width - 1 + margin) | (y > height - 1 + margin)
    if outside.any():
        corner = outline.corners_px[int(np.argmax(outside))]
        raise ConfigError(
            f"{outline.name}: the corner at ({corner[0]:.1f}, {corner[1]:.1f}) px is outside the"
            f" image of {width} x {height} px; give corners in rectified images."
        )
    fit = _fit_plane([outline], shape, sensor)
    if fit.residual_px > max(_MAX_RESIDUAL * square_side(outline.corners_px), _MIN_RESIDUAL_PX):
        raise ConfigError(
            f"{outline.name}: its corners are no {shape.name} of that size, but"
            f" {fit.residual_px:.1f} px off on average; check the shape, its sizes and the corners."
        )
    x_mm, y_mm = fit.scale
    if not 2 / 3 < x_mm / y_mm < 1.5:
        raise ConfigError(
            f"{outline.name}: a pixel would be {x_mm:.4g} x {y_mm:.4g} mm; check the sizes of the"
            f" {shape.name}, and its corners."
        )
    return fit


def _require_agreement(outlines: Sequence[Outline], fits: Sequence["_PlaneFit"]) -> None:
    logs = np.array([fit.terms[:2] for fit in fits])
    median = np.median(logs, axis=0)
    deviations = np.array([np.sqrt(np.diag(fit.covariance)) for fit in fits])
    uncertainty = _MAX_DEVIATIONS * np.minimum(deviations, _MAX_DISAGREEMENT)
    limits = np.maximum(_MAX_DISAGREEMENT, uncertainty)
    excess = np.abs(logs - median) / limits
    worst = int(excess.max(axis=1).argmax())
    if excess[worst].max() > 1.0:
        single, common = np.exp(logs[worst]), np.exp(median)
        raise ConfigError(
            f"images disagree: {outlines[worst].name} gives {single[0]:.4g} x {single[1]:.4g} mm"
            f" per px, the median of all {len(fits)} is {common[0]:.4g} x {common[1]:.4g}; check"
            " its corners and its object, or leave it out."
        )


def _edge_deviation(outlines: Sequence[Outline], shape: KnownShape) -> float:
    """Relative standard deviation of the scale from a common offset of all edges."""
    along = np.roll(shape.corners, -1, axis=0) - shape.corners
    cross = shape.corners[:, 0] * along[:, 1] - shape.corners[:, 1] * along[:, 0]
    inner_radius = float((np.abs(cross) / np.linalg.norm(along, axis=1)).mean())
    sides_px = np.array([square_side(outline.corners_px) for outline in outlines])
    radii_px = inner_radius / square_side(shape.corners) * sides_px
    return float(np.mean([outline.edge_px for outline in outlines] / radii_px))


@dataclass(frozen=True, eq=False)
class Warp:
    """Perspective warp that makes all pixels square and of equal size.

    Attributes:
        corners_px: `warp_corners_px` of a description.
        deviation_px: Standard deviation of the corners.
        mm_per_px: Size of a warped pixel along x and y, mm.
        residual_px: Root mean square residual of the shape's corners.
    """

    corners_px: Float[np.ndarray, "4 2"]
    deviation_px: float
    mm_per_px: float
    residual_px: float

    def apply_to(self, sensor: SensorDescription) -> SensorDescription:
        """Return a description with this warp and its scale."""
        corners: Any = self.corners_px.tolist()
        return replace(sensor, warp_corners_px=corners, mm_per_px=(self.mm_per_px, self.mm_per_px))


def fit_warp(outlines: Sequence[Outline], shape: KnownShape, sensor: SensorDescription) -> Warp:
    """Fit the warp of an inclined camera to the corners of a known shape.

    The warp keeps the center of the image and its rotation.

    Args:
        outlines: Corners in raw (undistorted) images: of a hexagon in one image or more, or of a
            cuboid in two or more, rotated and moved between them.
        shape: Pressed shape.
        sensor: Sensor that took the images, without a warp or a crop.

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
    fit = _fit_plane(outlines, shape, sensor, _PERSPECTIVE_TERMS)
    size = min(float(np.ptp(outline.corners_px, axis=0).max()) for outline in outlines)
    if fit.residual_px > max(_MAX_RESIDUAL * size, _MIN_RESIDUAL_PX):
        worst = int(np.argmax([np.linalg.norm(part) for part in fit.residuals_px]))
        raise ConfigError(
            f"{outlines[worst].name}: its corners are no {shape.name} of that size from any"
            f" direction, but {fit.residual_px:.1f} px off; check the shape and the corners."
        )

    def corners_of(terms: Float[np.ndarray, " terms"]) -> Float[np.ndarray, "8"]:
        """Corners of an image of square pixels at the mean scale."""
        signs = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)], dtype=float)
        scale = float(np.exp(terms[:2].mean()))
        return _to_px(signs * fit.center_px * scale, terms, fit.center_px).ravel()

    jacobian = approx_fprime(fit.terms, corners_of, _DIFFERENCE_STEP)
    variance = float(np.trace(jacobian @ fit.covariance @ jacobian.T)) / 8
    corners, scale = corners_of(fit.terms).reshape(4, 2), float(np.exp(fit.terms[:2].mean()))
    return Warp(corners, float(np.sqrt(variance)), scale, fit.residual_px)


class _PlaneFit(NamedTuple):
    """Map from pixels to mm: X = S u / (1 + p u), with u relative to the center; X = 0 there.

    Its terms are the logarithms of the scales along x and y; with perspective also the shear over
    the mean scale and the two components of p, times the center's distance from the edges.
    """

    terms: Float[np.ndarray, " terms"]
    covariance: Float[np.ndarray, "terms terms"]
    center_px: Float[np.ndarray, "2"]
    residuals_px: tuple[Float[np.ndarray, "_ 2"], ...]  # of each image's corners

    @property
    def scale(self) -> Float[np.ndarray, "2"]:
        """Size of a pixel at the center along x and y, mm."""
        return np.exp(self.terms[:2])

    @property
    def residual_px(self) -> float:
        """Root mean square residual of the corners."""
        return float(np.sqrt((np.concatenate(self.residuals_px) ** 2).sum(axis=1).mean()))


def _to_px(positions_mm: Corners, terms: np.ndarray, center_px: np.ndarray) -> Corners:
    """Apply the inverse of the map with these terms."""
    x, y = np.exp(terms[:2])
    shear, px, py = terms[2:] if len(terms) > 2 else (0.0, 0.0, 0.0)
    linear = np.array([(x, shear * np.sqrt(x * y)), (0.0, y)])
    perspective = np.array([px, py]) / float(center_px.max())
    matrices = linear - positions_mm[:, :, None] * perspective
    return np.linalg.solve(matrices, positions_mm[:, :, None])[..., 0] + center_px


def _fit_plane(
    outlines: Sequence[Outline], shape: KnownShape, sensor: SensorDescription, n_terms: int = 2
) -> _PlaneFit:
    """Fit one plane map, and a rotation and position of the shape in each image."""
    aspect = sensor.mm_per_px[1] / sensor.mm_per_px[0]
    center = (np.array(sensor.image_size_px, dtype=float) - 1) / 2
    matched = [_match_corners(outline, shape, aspect) for outline in outlines]
    freedom = sum(2 * len(c) for c, _ in matched) - n_terms - _POSE_UNKNOWNS * len(matched)
    if freedom < 1:
        raise ConfigError(
            f"a {shape.name} in {len(matched)} image is not enough: {freedom + n_terms} numbers for"
            f" {n_terms} unknowns; give more images, with the {shape.name} turned and moved."
        )
    measured = np.concatenate([corners for corners, _ in matched])
    start = np.zeros(n_terms)
    size = float(np.mean([abs(factor) for _, factor in matched]))
    start[:2] = -np.log(size) + np.array([0.0, np.log(aspect)])
    values = [start]
    for corners, factor in matched:
        position = (corners.mean(axis=0) - center) * np.exp(start[:2])
        values.append(np.array([np.angle(factor), *position]))

    def residuals(x: Float[np.ndarray, " x"]) -> Float[np.ndarray, " y"]:
        poses = x[n_terms:].reshape(-1, _POSE_UNKNOWNS)
        placed = [rotate(shape.corners, float(pose[0])) + pose[1:] for pose in poses]
        return (_to_px(np.concatenate(placed), x[:n_terms], center) - measured).ravel()

    begin = np.concatenate(values)
    solution = least_squares(residuals, begin, x_scale="jac", xtol=1e-12, ftol=1e-12)
    stated = float(np.mean([outline.deviation_px**2 for outline in outlines]))
    variance = max(float(solution.fun @ solution.fun) / freedom, stated)
    covariance = variance * np.linalg.pinv(solution.jac.T @ solution.jac)[:n_terms, :n_terms]
    cuts = np.cumsum([len(corners) for corners, _ in matched])[:-1]
    parts = tuple(np.split(solution.fun.reshape(-1, 2), cuts))
    return _PlaneFit(solution.x[:n_terms], covariance, center, parts)


def _match_corners(outline: Outline, shape: KnownShape, aspect: float) -> tuple[Corners, complex]:
    """Corners in the shape's order, and rotation and scale of the best similarity transform."""
    given, expected = len(outline.corners_px), len(shape.corners)
    if given != expected:
        raise ConfigError(
            f"{outline.name}: {given} corners, but a {shape.name} has {expected}; give each once."
        )
    reference = shape.corners @ (1, 1j)
    best, match = np.inf, None
    for shift in range(len(reference)):
        corners = np.roll(outline.corners_px, -shift, axis=0)
        z = corners @ (1, 1j * aspect)
        factor = complex(np.vdot(reference, z - z.mean()) / np.vdot(reference, reference))
        misfit = float(np.linalg.norm(z - z.mean() - factor * reference))
        if misfit < best * (1 - 1e-9):
            best, match = misfit, (corners, factor)
    assert match is not None
    return match
