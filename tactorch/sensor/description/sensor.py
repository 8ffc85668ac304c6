"""Description of a vision-based tactile sensor: camera, markers and gel.

The sensor frame follows the camera: the origin is the center of the gel's outer face at rest, x
points along the image's columns to the right, y along its rows downward, and z out of the sensor
toward the object. A press moves the gel along -z. Lengths are in mm, moduli in MPa.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from tactorch.errors import ConfigError, RecordingError
from tactorch.mesh.values import Real, positive
from tactorch.recording import MaterialSpec
from tactorch.sensor.description.checks import (
    finite_numbers,
    image_size,
    length_in_range,
    pixel_size,
    positive_lengths,
)

_MIN_YOUNGS_MPA, _MAX_YOUNGS_MPA = 1e-3, 20.0
_THICKNESS_RANGE_MM, _WIDTH_RANGE_MM = (0.05, 100.0), (0.5, 500.0)
_MAX_MARKERS_PER_ROW = 1000
_MAX_FIELD_OF_VIEW = 3.0  # times the size of the gel


@dataclass(frozen=True)
class GelLayer:
    """Soft layer bonded to a rigid window, with a rectangular or circular outline.

    Attributes:
        thickness_mm: Thickness at the center.
        youngs_mpa: Young's modulus.
        poisson: Poisson's ratio.
        size_mm: Width and height of a rectangular outline.
        radius_mm: Radius of a circular outline; give either this or `size_mm`.
        curvature_radius_mm: Radius of an outer face that is part of a sphere and bulges outward;
            None for a flat face.
        material: Name of the constitutive law.

    Raises:
        ConfigError: A value cannot be used; the message names it.
    """

    thickness_mm: Real
    youngs_mpa: Real
    poisson: Real = 0.48
    size_mm: Sequence[Real] | None = None
    radius_mm: Real | None = None
    curvature_radius_mm: Real | None = None
    material: str = "neo_hookean"

    def __post_init__(self) -> None:
        length_in_range("thickness_mm", float(self.thickness_mm), *_THICKNESS_RANGE_MM)
        youngs = positive("youngs_mpa", self.youngs_mpa)
        if not _MIN_YOUNGS_MPA <= youngs <= _MAX_YOUNGS_MPA:
            raise ConfigError(
                f"youngs_mpa={youngs:g}: gels have {_MIN_YOUNGS_MPA:g} to {_MAX_YOUNGS_MPA:g} MPa;"
                " give MPa, not Pa or kPa."
            )
        try:
            MaterialSpec(self.material, float(self.poisson))
        except RecordingError as error:
            raise ConfigError(f"{error}") from error
        if (self.size_mm is None) == (self.radius_mm is None):
            raise ConfigError("give size_mm (of a rectangle) or radius_mm (of a circle).")
        if self.size_mm is not None:
            object.__setattr__(self, "size_mm", positive_lengths("size_mm", self.size_mm, 2))
            for i, side in enumerate(self.size_mm):
                length_in_range(f"size_mm[{i}]", float(side), *_WIDTH_RANGE_MM)
        if self.radius_mm is not None:
            length_in_range("radius_mm", float(self.radius_mm), *_WIDTH_RANGE_MM)
        self._check_curvature()

    def _check_curvature(self) -> None:
        if self.curvature_radius_mm is None:
            return
        curvature = positive("curvature_radius_mm", self.curvature_radius_mm)
        if curvature <= self.outline_radius_mm:
            raise ConfigError(
                f"curvature_radius_mm={curvature:g} is no more than the outline's"
                f" radius {self.outline_radius_mm:.4g} mm: such a face would overhang."
            )
        drop = curvature - np.sqrt(curvature**2 - self.outline_radius_mm**2)
        if drop >= float(self.thickness_mm):
            raise ConfigError(
                f"curvature_radius_mm={curvature:g}: the face falls by {drop:.4g} mm to its rim,"
                f" but thickness_mm is {self.thickness_mm:g}."
            )

    @property
    def half_size_mm(self) -> tuple[float, float]:
        """Half width and half height of the outline's bounding box."""
        if self.size_mm is None:
            assert self.radius_mm is not None
            return float(self.radius_mm), float(self.radius_mm)
        return float(self.size_mm[0]) / 2, float(self.size_mm[1]) / 2

    @property
    def outline_radius_mm(self) -> float:
        """Largest distance of the outline from the center."""
        return self.half_size_mm[0] if self.size_mm is None else float(np.hypot(*self.half_size_mm))

    @property
    def material_spec(self) -> MaterialSpec:
        """Constitutive law, without Young's modulus."""
        return MaterialSpec(self.material, float(self.poisson))

    def covers(self, positions_mm: Float[np.ndarray, "*n 2"]) -> Bool[np.ndarray, "*n"]:
        """Return which positions x, y are within the outline."""
        if self.size_mm is None:
            return np.asarray(np.linalg.norm(positions_mm, axis=-1) <= self.outline_radius_mm)
        return np.asarray((np.abs(positions_mm) <= np.array(self.half_size_mm)).all(axis=-1))

    def height_mm(self, positions_mm: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n"]:
        """Return z of the outer face at rest: 0 at the center, negative where it curves away."""
        if self.curvature_radius_mm is None:
            return np.zeros(positions_mm.shape[:-1])
        curvature = float(self.curvature_radius_mm)
        distance = np.minimum(np.linalg.norm(positions_mm, axis=-1), curvature)
        return np.sqrt(curvature**2 - distance**2) - curvature


@dataclass(frozen=True)
class MarkerGrid:
    """Regular grid of markers, centered on the gel.

    Attributes:
        columns: Number of markers along x.
        rows: Number of markers along y.
        pitch_mm: Distance between columns, and between rows.
        diameter_mm: Diameter of a marker.
        within_mm: Radius about the center beyond which there are no markers; None for a full grid.
        shift_mm: Offset of the grid's center from the gel's.

    Raises:
        ConfigError: A value cannot be used; the message names it.
    """

    columns: int
    rows: int
    pitch_mm: Sequence[Real]
    diameter_mm: Real
    within_mm: Real | None = None
    shift_mm: Sequence[Real] = (0.0, 0.0)

    def __post_init__(self) -> None:
        for name in ("columns", "rows"):
            count = getattr(self, name)
            if not isinstance(count, int | np.integer) or not 1 <= count <= _MAX_MARKERS_PER_ROW:
                raise ConfigError(
                    f"{name}={count!r} must be a whole number from 1 to {_MAX_MARKERS_PER_ROW}."
                )
        object.__setattr__(self, "pitch_mm", positive_lengths("pitch_mm", self.pitch_mm, 2))
        object.__setattr__(self, "shift_mm", finite_numbers("shift_mm", self.shift_mm, 2))
        if positive("diameter_mm", self.diameter_mm) >= min(map(float, self.pitch_mm)):
            raise ConfigError(
                f"diameter_mm={self.diameter_mm:g} is no less than the pitch"
                f" {min(map(float, self.pitch_mm)):g} mm: markers would overlap."
            )
        if self.within_mm is not None:
            positive("within_mm", self.within_mm)
        if not len(self.positions_mm):
            raise ConfigError(f"within_mm={self.within_mm} excludes every marker; give a larger.")

    @property
    def positions_mm(self) -> Float[np.ndarray, "n 2"]:
        """Centers of the markers at rest, row by row."""
        x, y = (
            (np.arange(count) - (count - 1) / 2) * float(pitch)
            for count, pitch in zip((self.columns, self.rows), self.pitch_mm, strict=True)
        )
        positions = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        if self.within_mm is not None:
            positions = positions[np.linalg.norm(positions, axis=1) <= float(self.within_mm)]
        return positions + np.asarray(self.shift_mm, dtype=float)


@dataclass(frozen=True)
class SensorDescription:
    """Description of a sensor, as stored in `sensor.yaml`.

    A raw image is undistorted (with `intrinsics_px`), warped (with `warp_corners_px`) and cropped
    (with `crop_px`), in this order. The rectified image has the size `image_size_px`; all further
    processing uses rectified images.

    Attributes:
        name: Name of the sensor.
        image_size_px: Width and height of a rectified image.
        mm_per_px: Size of a rectified pixel on the gel's outer face, along x and y, mm.
        gel: Soft layer.
        markers: Markers on the gel; None for a gel without markers.
        frame_rate_hz: Frame rate of the camera; None if unknown.
        raw_size_px: Width and height of a raw image; None if equal to `image_size_px`.
        intrinsics_px: Focal lengths and principal point (fx, fy, cx, cy) of the raw image; None
            for no correction of lens distortion.
        distortion: Distortion coefficients in OpenCV's order (k1, k2, p1, p2, ...).
        warp_corners_px: Points of the undistorted raw image that become the corners of the
            warped image: top left, top right, bottom right, bottom left; None for no warp.
        warped_size_px: Width and height of the warped image before cropping.
        crop_px: Left, top, width and height of the cropped region; None for the full image.

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
            object.__setattr__(self, name, image_size(name, size))
        object.__setattr__(self, "mm_per_px", pixel_size("mm_per_px", self.mm_per_px))
        if self.frame_rate_hz is not None:
            positive("frame_rate_hz", self.frame_rate_hz)
        self._check_lens()
        self._check_warp()
        self._check_crop()
        self._check_gel()

    @property
    def shape(self) -> tuple[int, int]:
        """Number of rows and columns of a rectified image."""
        return self.image_size_px[1], self.image_size_px[0]

    @property
    def size_mm(self) -> tuple[float, float]:
        """Width and height of the field of view, mm."""
        (width, height), (x, y) = self.image_size_px, self.mm_per_px
        return width * float(x), height * float(y)

    def to_mm(self, positions_px: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 2"]:
        """Convert image positions (column, row; pixel centers are integers) to x, y in mm."""
        center = (np.array(self.image_size_px) - 1) / 2
        return (positions_px - center) * np.array(self.mm_per_px, dtype=float)

    def to_px(self, positions_mm: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 2"]:
        """Convert x, y in mm to image positions (column, row)."""
        center = (np.array(self.image_size_px) - 1) / 2
        return positions_mm / np.array(self.mm_per_px, dtype=float) + center

    def _check_lens(self) -> None:
        coefficients = finite_numbers("distortion", self.distortion, len(self.distortion))
        object.__setattr__(self, "distortion", coefficients)
        if self.intrinsics_px is None:
            if len(self.distortion):
                raise ConfigError("distortion is given without intrinsics_px; give both.")
            return
        values = finite_numbers("intrinsics_px", self.intrinsics_px, 4)
        object.__setattr__(self, "intrinsics_px", values)
        if min(values[:2]) <= 0:
            raise ConfigError(f"intrinsics_px={list(values)}: give positive focal lengths.")
        if len(self.distortion) not in (0, 4, 5, 8, 12, 14):
            raise ConfigError(
                f"distortion has {len(self.distortion)} numbers; give OpenCV's 4, 5 or 8."
            )

    def _check_warp(self) -> None:
        if self.warp_corners_px is None:
            return
        points = tuple(finite_numbers("warp_corners_px", c, 2) for c in self.warp_corners_px)
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
                self, "warped_size_px", image_size("warped_size_px", self.warped_size_px)
            )

    def _check_crop(self) -> None:
        full = self.warped_size
        if self.crop_px is None:
            if full != tuple(self.image_size_px):
                raise ConfigError(
                    f"image_size_px={list(self.image_size_px)} differs from the size {list(full)}"
                    " of the warped image; give crop_px or warped_size_px."
                )
            return
        crop = tuple(int(v) for v in finite_numbers("crop_px", self.crop_px, 4))
        object.__setattr__(self, "crop_px", crop)
        left, top, width, height = crop
        if (width, height) != tuple(self.image_size_px):
            raise ConfigError(
                f"crop_px={list(crop)} keeps {width} x {height} px, but image_size_px is"
                f" {list(self.image_size_px)}."
            )
        if min(left, top) < 0 or left + width > full[0] or top + height > full[1]:
            raise ConfigError(
                f"crop_px={list(crop)} exceeds the warped image of {full[0]} x {full[1]} px."
            )

    def _check_gel(self) -> None:
        (width, height), gel = self.size_mm, 2 * np.array(self.gel.half_size_mm)
        if width > _MAX_FIELD_OF_VIEW * gel[0] and height > _MAX_FIELD_OF_VIEW * gel[1]:
            raise ConfigError(
                f"the image shows {width:.4g} x {height:.4g} mm, but the gel is {gel[0]:g} x"
                f" {gel[1]:g} mm; check mm_per_px and the gel's size."
            )
        if self.markers is None:
            return
        positions = self.markers.positions_mm
        inside = self.gel.covers(positions)
        if not inside.all():
            extent = np.abs(positions).max(axis=0)
            raise ConfigError(
                f"markers: {int((~inside).sum())} of {len(positions)} are outside the gel: they"
                f" extend {extent[0]:.4g} and {extent[1]:.4g} mm from the center, the gel"
                f" {gel[0] / 2:g} and {gel[1] / 2:g} mm. Check columns, rows and pitch_mm, or give"
                " within_mm."
            )

    @property
    def warped_size(self) -> tuple[int, int]:
        """Width and height of an image before cropping."""
        if self.warp_corners_px is not None and self.warped_size_px is not None:
            return self.warped_size_px[0], self.warped_size_px[1]
        size = self.raw_size_px if self.warp_corners_px is None else self.image_size_px
        assert size is not None
        return size[0], size[1]
