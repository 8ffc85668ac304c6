"""The size of a pixel, from an object of known size pressed into the gel (Section VI-B).

A flat face's corners, in any place and turn, tell the size of a pixel along x and along y each: a
turn and two places are free, and a triangle has six numbers. What they cannot tell is whether all
edges are seen too far out or in; that goes into the deviation from how well an edge is known.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError
from tactorch.sensor.description import SensorDescription
from tactorch.sensor.scale.plane import Fit, fit_plane
from tactorch.sensor.scale.shape import KnownShape, Outline

_MISFIT, _LEAST_MISFIT_PX = 0.03, 1.5  # of the size: residual from which it is another shape
_APART, _DEVIATIONS = 0.02, 4.0  # by which an image's scale may differ from the others'


@dataclass(frozen=True, eq=False)
class PixelScale:
    """The size of a pixel, measured.

    Attributes:
        mm_per_px: Along x and y, mm.
        deviation: Standard deviation of both, mm.
        residual_px: Root mean square distance of corners from those of the shape.
        corners_px: Corners in each image.
    """

    mm_per_px: tuple[float, float]
    deviation: tuple[float, float]
    residual_px: float
    corners_px: Mapping[str, Float[np.ndarray, "_ 2"]]

    def apart(self, sensor: SensorDescription) -> tuple[float, float]:
        """Return by what share the measured scale is larger than a description's, along x and y."""
        x, y = (
            measured / float(told) - 1.0
            for measured, told in zip(self.mm_per_px, sensor.mm_per_px, strict=True)
        )
        return x, y

    def disagreement(self, sensor: SensorDescription) -> str:
        """Return how the measured scale disagrees with a description's, in words, or "".

        It does where it differs by more than three standard deviations and half a percent.
        """
        said = []
        for axis, off in enumerate(self.apart(sensor)):
            share = self.deviation[axis] / self.mm_per_px[axis]
            if abs(off) > max(3.0 * share, 0.005):
                said.append(
                    f"along {'xy'[axis]} {self.mm_per_px[axis]:.5g} mm per px were measured"
                    f" (+- {self.deviation[axis]:.1g}), {off:+.1%} of mm_per_px="
                    f"{float(sensor.mm_per_px[axis]):.5g} in the description of '{sensor.name}'"
                )
        return "; ".join(said)

    def applied(self, sensor: SensorDescription) -> SensorDescription:
        """Return a description with this scale, for `save_sensor`."""
        return replace(sensor, mm_per_px=self.mm_per_px)


def pixel_scale(
    outlines: Sequence[Outline], shape: KnownShape, sensor: SensorDescription
) -> PixelScale:
    """Measure the size of a pixel from the corners of a known shape.

    Args:
        outlines: Corners in one image or several, in rectified pixels.
        shape: What was pressed.
        sensor: What the images were taken with; the ratio of its pixel's sides tells those of a
            cuboid apart, and is no more used than that.

    Raises:
        ConfigError: There is no image; an outline has another number of corners, corners of
            another shape or beside the image, or another scale than the other images.
    """
    if not outlines:
        raise ConfigError("no image of a known shape to measure the pixel's size with.")
    x, y = (float(size) for size in sensor.mm_per_px)
    middle = (np.array(sensor.image_size_px, dtype=float) - 1) / 2
    alone = []
    for outline in outlines:
        _within(outline, sensor)
        fit = fit_plane([outline], shape, y / x, middle)
        _fits(fit, outline, shape)
        alone.append(fit)
    _agree(outlines, alone)
    fit = fit_plane(outlines, shape, y / x, middle)
    scale = fit.plane.scale
    share = np.hypot(np.sqrt(np.diag(fit.covariance)), _edge_share(outlines, shape))
    return PixelScale(
        (float(scale[0]), float(scale[1])),
        (float(share[0] * scale[0]), float(share[1] * scale[1])),
        fit.residual_px,
        {outline.name: outline.corners_px for outline in outlines},
    )


def _within(outline: Outline, sensor: SensorDescription) -> None:
    """Corners may lie some pixels beside the image, where edges meet that are seen."""
    width, height = sensor.image_size_px
    x, y = outline.corners_px.T
    margin = 0.1 * min(width, height)
    out = (x < -margin) | (y < -margin) | (x > width - 1 + margin) | (y > height - 1 + margin)
    if out.any():
        at = outline.corners_px[int(np.argmax(out))]
        raise ConfigError(
            f"{outline.name}: the corner at ({at[0]:.1f}, {at[1]:.1f}) px lies beside the image of"
            f" {width} x {height} px; corners are of rectified images."
        )


def _size_px(outline: Outline) -> float:
    x, y = outline.corners_px.T
    return float(np.sqrt(0.5 * abs(x @ np.roll(y, -1) - y @ np.roll(x, -1))))


def _fits(fit: Fit, outline: Outline, shape: KnownShape) -> None:
    limit = max(_MISFIT * _size_px(outline), _LEAST_MISFIT_PX)
    x, y = fit.plane.scale
    if fit.residual_px > limit:
        raise ConfigError(
            f"{outline.name}: its corners are no {shape.name} of that size, but"
            f" {fit.residual_px:.1f} px off on average; check the shape, its sizes and the corners."
        )
    if not 2 / 3 < x / y < 1.5:
        raise ConfigError(
            f"{outline.name}: a pixel would be {x:.4g} x {y:.4g} mm; check the sizes of the"
            f" {shape.name}, and its corners."
        )


def _agree(outlines: Sequence[Outline], alone: Sequence[Fit]) -> None:
    """Refuse an image whose scale is not that of the others."""
    if len(alone) < 2:
        return
    logs = np.array([fit.plane.terms[:2] for fit in alone])
    usual = np.median(logs, axis=0)
    shares = np.array([np.sqrt(np.diag(fit.covariance)) for fit in alone])
    off = np.abs(logs - usual) / np.maximum(_APART, _DEVIATIONS * np.minimum(shares, _APART))
    worst = int(off.max(axis=1).argmax())
    if off[worst].max() > 1.0:
        own, all_ = np.exp(logs[worst]), np.exp(usual)
        raise ConfigError(
            f"images disagree: {outlines[worst].name} tells {own[0]:.4g} x {own[1]:.4g} mm per px,"
            f" the median of all {len(alone)} is {all_[0]:.4g} x {all_[1]:.4g}; check its corners"
            " and its object, or leave it out."
        )


def _edge_share(outlines: Sequence[Outline], shape: KnownShape) -> float:
    """By what share the scale is unsure because edges may all be seen too far out or in."""
    sides = np.roll(shape.corners, -1, axis=0) - shape.corners
    cross = shape.corners[:, 0] * sides[:, 1] - shape.corners[:, 1] * sides[:, 0]
    inner = float((np.abs(cross) / np.linalg.norm(sides, axis=1)).mean())
    area = float(np.sqrt(0.5 * np.abs(cross).sum()))
    return float(np.mean([o.edge_px / (_size_px(o) * inner / area) for o in outlines]))
