"""What a vision-based tactile sensor is: its camera, its markers and its gel.

The sensor's frame follows the camera: the origin in the middle of the gel's outer face at rest, x
along the image's columns to the right, y along its rows downward, z out of the sensor, toward what
it touches. A press moves the gel along -z.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError
from tactorch.mesh.values import Real, positive
from tactorch.sensor.description.gel_layer import GelLayer
from tactorch.sensor.description.marker_grid import MarkerGrid
from tactorch.sensor.description.numbers import numbers, pixel_size, pixels

_WIDER = 3.0  # times the gel: what an image cannot show


@dataclass(frozen=True)
class SensorDescription:
    """A sensor, as `sensor.yaml` describes it.

    A raw image is undistorted (where there are intrinsics), warped (where there are corners) and
    cropped, in this order; what comes out has `image_size_px`, and all that follows works on it.

    Attributes:
        name: What to call it.
        image_size_px: Width and height of an image that has been warped and cropped.
        mm_per_px: Size of its pixels on the gel's outer face, along x and y, mm.
        gel: The soft layer.
        markers: Painted on it; None where there are none.
        frame_rate_hz: Of the camera; None where unknown.
        raw_size_px: Width and height of what the camera gives; None for the same as the image's.
        intrinsics_px: Focal lengths and principal point (fx, fy, cx, cy) of the raw image; None
            leaves the lens alone.
        distortion: OpenCV's k1, k2, p1, p2 and so on; empty for none.
        warp_corners_px: Points of the (undistorted) raw image that become the corners of the
            warped one: top left, top right, bottom right, bottom left; None for no warp.
        warped_size_px: Width and height of the warped image, before it is cropped.
        crop_px: Left, top, width and height of what is kept; None for all.

    Raises:
        ConfigError: A value cannot be used; the message names it.
    """

    name: str
    image_size_px: Sequence[int]
    mm_per_px: Sequence[Real]
    gel: GelLayer
    markers: MarkerGrid | None = None
    frame_rate_hz: Real | None = None
    raw_size_px: Sequence[int] | None = None
    intrinsics_px: Sequence[Real] | None = None
    distortion: Sequence[Real] = ()
    warp_corners_px: Sequence[Sequence[Real]] | None = None
    warped_size_px: Sequence[int] | None = None
    crop_px: Sequence[int] | None = None

    def __post_init__(self) -> None:
        sizes = {"image_size_px": self.image_size_px}
        sizes |= {"raw_size_px": self.raw_size_px or self.image_size_px}
        for name, size in sizes.items():
            object.__setattr__(self, name, pixels(name, size))
        object.__setattr__(self, "mm_per_px", pixel_size("mm_per_px", self.mm_per_px))
        if self.frame_rate_hz is not None:
            positive("frame_rate_hz", self.frame_rate_hz)
        self._check_lens()
        self._check_warp()
        self._check_crop()
        self._check_gel()

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the image."""
        return self.image_size_px[1], self.image_size_px[0]

    @property
    def size_mm(self) -> tuple[float, float]:
        """Width and height of what the image shows, mm."""
        (width, height), (x, y) = self.image_size_px, self.mm_per_px
        return width * float(x), height * float(y)

    def to_mm(self, places_px: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 2"]:
        """Turn places in the image (column, row; a pixel's centre is whole) into x, y in mm."""
        middle = (np.array(self.image_size_px) - 1) / 2
        return (places_px - middle) * np.array(self.mm_per_px, dtype=float)

    def to_px(self, places_mm: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 2"]:
        """Turn x, y in mm into places in the image."""
        middle = (np.array(self.image_size_px) - 1) / 2
        return places_mm / np.array(self.mm_per_px, dtype=float) + middle

    def _check_lens(self) -> None:
        lens = numbers("distortion", self.distortion, len(self.distortion))
        object.__setattr__(self, "distortion", lens)
        if self.intrinsics_px is None:
            if len(self.distortion):
                raise ConfigError("distortion is given without intrinsics_px; give both.")
            return
        values = numbers("intrinsics_px", self.intrinsics_px, 4)
        object.__setattr__(self, "intrinsics_px", values)
        if min(values[:2]) <= 0:
            raise ConfigError(f"intrinsics_px={list(values)}: focal lengths must be positive.")
        if len(self.distortion) not in (0, 4, 5, 8, 12, 14):
            raise ConfigError(f"distortion has {len(self.distortion)} numbers; OpenCV's 4, 5 or 8.")

    def _check_warp(self) -> None:
        if self.warp_corners_px is None:
            return
        points = tuple(numbers("warp_corners_px", c, 2) for c in self.warp_corners_px)
        object.__setattr__(self, "warp_corners_px", points)
        corners = np.array(points)
        if corners.shape != (4, 2):
            raise ConfigError(f"warp_corners_px has {len(corners)} points; give four.")
        edges = np.roll(corners, -1, axis=0) - corners
        turns = edges[:, 0] * np.roll(edges[:, 1], -1) - edges[:, 1] * np.roll(edges[:, 0], -1)
        if not (turns > 0).all():
            raise ConfigError(
                "warp_corners_px must go round a convex figure: top left, top right, bottom right,"
                " bottom left, as the image should show them."
            )
        if self.warped_size_px is not None:
            object.__setattr__(
                self, "warped_size_px", pixels("warped_size_px", self.warped_size_px)
            )

    def _check_crop(self) -> None:
        whole = self.warped_size
        if self.crop_px is None:
            if whole != tuple(self.image_size_px):
                raise ConfigError(
                    f"image_size_px={list(self.image_size_px)} is not the size {list(whole)} of"
                    " what is kept of the raw image; give crop_px or warped_size_px."
                )
            return
        crop = tuple(int(v) for v in numbers("crop_px", self.crop_px, 4))
        object.__setattr__(self, "crop_px", crop)
        left, top, width, height = crop
        if (width, height) != tuple(self.image_size_px):
            raise ConfigError(
                f"crop_px={list(crop)} keeps {width} x {height} px, but image_size_px is"
                f" {list(self.image_size_px)}."
            )
        if min(left, top) < 0 or left + width > whole[0] or top + height > whole[1]:
            raise ConfigError(
                f"crop_px={list(crop)} reaches beyond the {whole[0]} x {whole[1]} px before it."
            )

    def _check_gel(self) -> None:
        (width, height), gel = self.size_mm, 2 * np.array(self.gel.half_mm)
        if width > _WIDER * gel[0] and height > _WIDER * gel[1]:
            raise ConfigError(
                f"the image shows {width:.4g} x {height:.4g} mm, but the gel is {gel[0]:g} x"
                f" {gel[1]:g} mm; check mm_per_px and the gel's size."
            )
        if self.markers is None:
            return
        places = self.markers.places_mm
        inside = self.gel.covers(places)
        if not inside.all():
            far = np.abs(places).max(axis=0)
            raise ConfigError(
                f"markers: {int((~inside).sum())} of {len(places)} lie beyond the gel: they reach"
                f" {far[0]:.4g} and {far[1]:.4g} mm from the middle, the gel {gel[0] / 2:g} and"
                f" {gel[1] / 2:g} mm. Check columns, rows and pitch_mm, or give within_mm."
            )

    @property
    def warped_size(self) -> tuple[int, int]:
        """Width and height of an image before it is cropped."""
        if self.warp_corners_px is not None and self.warped_size_px is not None:
            return self.warped_size_px[0], self.warped_size_px[1]
        size = self.raw_size_px if self.warp_corners_px is None else self.image_size_px
        assert size is not None
        return size[0], size[1]
