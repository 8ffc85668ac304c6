"""Descriptions of vision-based tactile sensors (camera, markers and gel) and their YAML files.

The sensor frame follows the camera: the origin is the center of the gel's outer face at rest, x
points along the image's columns to the right, y along its rows downward, and z out of the sensor
toward the object. A press moves the gel along -z. Lengths are in mm, moduli in MPa.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import yaml
from jaxtyping import Bool, Float

from tactorch.config import Options, option, to_mapping
from tactorch.errors import ConfigError, FileError, RecordingError
from tactorch.files import atomic_path, read_yaml, require_file
from tactorch.recording import MaterialSpec

_MAX_FIELD_OF_VIEW = 3.0  # times the size of the gel
_MIN_PIXEL_MM, _MAX_PIXEL_MM = 1e-4, 1.0
_EXPONENT = re.compile(r"[-+]?[\d.]+[eE][-+]?\d+")
_FOLDER = Path(__file__).parent / "sensors"
#: Names of the descriptions shipped with tactorch.
SENSORS = tuple(sorted(path.stem for path in _FOLDER.glob("*.yaml")))


@dataclass(frozen=True)
class GelLayer(Options):
    """Soft layer bonded to a rigid window, with a rectangular or circular outline."""

    section: ClassVar[str] = "gel"
    thickness_mm: float = option(help="Thickness at the center", unit="mm", ge=0.05, le=100)
    youngs_mpa: float = option(help="Young's modulus", unit="MPa", ge=1e-3, le=20)
    poisson: float = option(0.48, "Poisson's ratio")
    size_mm: tuple[float, float] | None = option(
        None, "Width and height of a rectangular outline", unit="mm", ge=0.5, le=500
    )
    radius_mm: float | None = option(
        None, "Radius of a circular outline; give either this or size_mm", unit="mm", ge=0.5, le=500
    )
    curvature_radius_mm: float | None = option(
        None, "Radius of an outward spherical face; null for a flat face", unit="mm", gt=0
    )
    material: str = option("neo_hookean", "Name of the constitutive law")

    def __post_init__(self) -> None:
        super().__post_init__()
        try:
            MaterialSpec(self.material, self.poisson)
        except RecordingError as error:
            raise ConfigError(f"gel: {error}") from error
        if (self.size_mm is None) == (self.radius_mm is None):
            raise ConfigError("gel: give size_mm (of a rectangle) or radius_mm (of a circle).")
        if (curvature := self.curvature_radius_mm) is None:
            return
        outline = self.radius_mm or float(np.hypot(*self.half_size_mm))
        if curvature <= outline:
            raise ConfigError(
                f"gel.curvature_radius_mm={curvature:g} is no more than the outline's radius"
                f" {outline:.4g} mm: such a face would overhang."
            )
        drop = curvature - np.sqrt(curvature**2 - outline**2)
        if drop >= self.thickness_mm:
            raise ConfigError(
                f"gel.curvature_radius_mm={curvature:g}: the face falls by {drop:.4g} mm to its"
                f" rim, but thickness_mm is {self.thickness_mm:g}."
            )

    @property
    def numbers(self) -> Float[np.ndarray, "7"]:
        """Thickness, modulus, Poisson's ratio, width, height, radius, curvature; NaN for none."""
        values = self.thickness_mm, self.youngs_mpa, self.poisson, *(self.size_mm or (None, None))
        return np.array([*values, self.radius_mm, self.curvature_radius_mm], dtype=np.float64)

    @staticmethod
    def of_numbers(numbers: Float[np.ndarray, "7"], material: str) -> "GelLayer":
        """Return the layer of `numbers` and a constitutive law.

        Raises:
            ConfigError: A value is not valid.
        """
        values = [None if np.isnan(value) else float(value) for value in numbers]
        size = None if values[3] is None or values[4] is None else (values[3], values[4])
        thickness, youngs, poisson = (float(value) for value in numbers[:3])
        return GelLayer(thickness, youngs, poisson, size, values[5], values[6], material)

    @property
    def half_size_mm(self) -> tuple[float, float]:
        """Half width and half height of the outline's bounding box."""
        if self.size_mm is not None:
            return self.size_mm[0] / 2, self.size_mm[1] / 2
        assert self.radius_mm is not None
        return self.radius_mm, self.radius_mm

    def covers(self, positions_mm: Float[np.ndarray, "*n 2"]) -> Bool[np.ndarray, "*n"]:
        """Return which positions x, y are within the outline."""
        if self.radius_mm is not None:
            return np.asarray(np.linalg.norm(positions_mm, axis=-1) <= self.radius_mm)
        return np.asarray((np.abs(positions_mm) <= np.array(self.half_size_mm)).all(axis=-1))

    def height_mm(self, positions_mm: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n"]:
        """Return z of the outer face at rest: 0 at the center, negative where it curves away."""
        curvature = self.curvature_radius_mm
        if curvature is None:
            return np.zeros(positions_mm.shape[:-1])
        distance = np.minimum(np.linalg.norm(positions_mm, axis=-1), curvature)
        return np.sqrt(curvature**2 - distance**2) - curvature


@dataclass(frozen=True)
class MarkerGrid(Options):
    """Regular grid of markers, centered on the gel."""

    section: ClassVar[str] = "markers"
    columns: int = option(help="Number of markers along x", ge=1, le=1000)
    rows: int = option(help="Number of markers along y", ge=1, le=1000)
    pitch_mm: tuple[float, float] = option(
        help="Distance between columns, and between rows", unit="mm", gt=0
    )
    diameter_mm: float = option(help="Diameter of a marker", unit="mm", gt=0)
    within_mm: float | None = option(
        None, "Radius about the center that has markers; null for a full grid", unit="mm", gt=0
    )
    shift_mm: tuple[float, float] = option(
        (0.0, 0.0), "Offset of the grid's center from the gel's", unit="mm"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.diameter_mm >= min(self.pitch_mm):
            raise ConfigError(
                f"markers.diameter_mm={self.diameter_mm:g} is no less than the pitch"
                f" {min(self.pitch_mm):g} mm: markers would overlap."
            )
        if not len(self.positions_mm):
            raise ConfigError(
                f"markers.within_mm={self.within_mm} excludes every marker; give a larger."
            )

    @property
    def positions_mm(self) -> Float[np.ndarray, "n 2"]:
        """Centers of the markers at rest, row by row."""
        x = (np.arange(self.columns) - (self.columns - 1) / 2) * self.pitch_mm[0]
        y = (np.arange(self.rows) - (self.rows - 1) / 2) * self.pitch_mm[1]
        positions = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        if self.within_mm is not None:
            positions = positions[np.linalg.norm(positions, axis=1) <= self.within_mm]
        return positions + np.array(self.shift_mm)


_Point = tuple[float, float]


@dataclass(frozen=True)
class SensorDescription(Options):
    """Description of a sensor, as stored in `sensor.yaml`.

    A raw image is undistorted (with `intrinsics_px`), warped (with `warp_corners_px`) and cropped
    (with `crop_px`), in this order. The rectified image has the size `image_size_px`; all further
    processing uses rectified images.
    """

    name: str = option(help="Name of the sensor")
    image_size_px: tuple[int, int] = option(
        help="Width and height of a rectified image", unit="px", ge=8, le=20000
    )
    mm_per_px: tuple[float, float] = option(
        help="Size of a rectified pixel on the gel's outer face, along x and y", unit="mm", gt=0
    )
    gel: GelLayer = option(help="Soft layer")
    markers: MarkerGrid | None = option(None, "Markers on the gel; null for a gel without markers")
    frame_rate_hz: float | None = option(
        None, "Frame rate of the camera; null if unknown", unit="Hz", gt=0
    )
    raw_size_px: tuple[int, int] | None = option(
        None, "Width and height of a raw image; null if equal to image_size_px",
        unit="px", ge=8, le=20000,
    )  # fmt: skip
    intrinsics_px: tuple[float, float, float, float] | None = option(
        None, "Focal lengths and principal point [fx, fy, cx, cy] of the raw image; null for no"
        " correction of lens distortion", unit="px",
    )  # fmt: skip
    distortion: tuple[float, ...] = option(
        (), "Distortion coefficients in OpenCV's order [k1, k2, p1, p2, ...]"
    )
    warp_corners_px: tuple[_Point, _Point, _Point, _Point] | None = option(
        None, "Points of the undistorted raw image that become the corners of the warped image: top"
        " left, top right, bottom right, bottom left; null for no warp", unit="px",
    )  # fmt: skip
    warped_size_px: tuple[int, int] | None = option(
        None, "Width and height of the warped image before cropping", unit="px", ge=8, le=20000
    )
    crop_px: tuple[int, int, int, int] | None = option(
        None, "Left, top, width and height of the crop; null for the full image", unit="px", ge=0
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "raw_size_px", self.raw_size_px or self.image_size_px)
        check_pixel_size(self.mm_per_px)
        self._check_rectification()
        self._check_gel()

    @property
    def shape(self) -> tuple[int, int]:
        """Number of rows and columns of a rectified image."""
        return self.image_size_px[1], self.image_size_px[0]

    @property
    def size_mm(self) -> tuple[float, float]:
        """Width and height of the field of view, mm."""
        (width, height), (x, y) = self.image_size_px, self.mm_per_px
        return width * x, height * y

    @property
    def warped_size(self) -> tuple[int, int]:
        """Width and height of an image before cropping."""
        if self.warp_corners_px is not None:
            return self.warped_size_px or self.image_size_px
        return self.raw_size_px or self.image_size_px

    def to_mm(self, positions_px: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 2"]:
        """Convert image positions (column, row; pixel centers are integers) to x, y in mm."""
        center = (np.array(self.image_size_px) - 1) / 2
        return (positions_px - center) * np.array(self.mm_per_px)

    def to_px(self, positions_mm: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 2"]:
        """Convert x, y in mm to image positions (column, row)."""
        center = (np.array(self.image_size_px) - 1) / 2
        return positions_mm / np.array(self.mm_per_px) + center

    def _check_rectification(self) -> None:
        if self.intrinsics_px is None and self.distortion:
            raise ConfigError("distortion is given without intrinsics_px; give both.")
        if self.intrinsics_px is not None and min(self.intrinsics_px[:2]) <= 0:
            raise ConfigError(
                f"intrinsics_px={list(self.intrinsics_px)}: give positive focal lengths."
            )
        if len(self.distortion) not in (0, 4, 5, 8, 12, 14):
            raise ConfigError(
                f"distortion has {len(self.distortion)} numbers; give OpenCV's 4, 5 or 8."
            )
        if self.warp_corners_px is not None:
            corners = np.array(self.warp_corners_px)
            edges = np.roll(corners, -1, axis=0) - corners
            turns = edges[:, 0] * np.roll(edges[:, 1], -1) - edges[:, 1] * np.roll(edges[:, 0], -1)
            if not (turns > 0).all():
                raise ConfigError(
                    "warp_corners_px must go round a convex figure: top left, top right, bottom"
                    " right, bottom left, as the image should show them."
                )
        self._check_crop()

    def _check_crop(self) -> None:
        full, size = self.warped_size, self.image_size_px
        if self.crop_px is None:
            if full != size:
                raise ConfigError(
                    f"image_size_px={list(size)} differs from the size {list(full)} of the warped"
                    " image; give crop_px or warped_size_px."
                )
            return
        left, top, width, height = self.crop_px
        if (width, height) != size:
            raise ConfigError(
                f"crop_px={list(self.crop_px)} keeps {width} x {height} px, but image_size_px is"
                f" {list(size)}."
            )
        if left + width > full[0] or top + height > full[1]:
            raise ConfigError(
                f"crop_px={list(self.crop_px)} exceeds the warped image of {full[0]} x {full[1]}"
                " px."
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
        outside = ~self.gel.covers(positions)
        if outside.any():
            extent = np.abs(positions).max(axis=0)
            raise ConfigError(
                f"markers: {int(outside.sum())} of {len(positions)} are outside the gel: they"
                f" extend {extent[0]:.4g} and {extent[1]:.4g} mm from the center, the gel"
                f" {gel[0] / 2:g} and {gel[1] / 2:g} mm. Check columns, rows and pitch_mm, or give"
                " within_mm."
            )


def check_pixel_size(mm_per_px: tuple[float, float]) -> None:
    """Check the size of a pixel along x and y, mm."""
    for size in mm_per_px:
        if size > _MAX_PIXEL_MM:
            raise ConfigError(
                f"mm_per_px={list(mm_per_px)}: a pixel of {size:g} mm looks like pixels per mm;"
                f" give mm per pixel ({1 / size:.4g})."
            )
        if not size >= _MIN_PIXEL_MM:
            raise ConfigError(
                f"mm_per_px={list(mm_per_px)}: a pixel of {size:g} mm looks like metres; give mm"
                f" per pixel ({1e3 * size:.4g})."
            )


def load_sensor(name: str | Path) -> SensorDescription:
    """Return a sensor description from its file.

    Args:
        name: Path of a `sensor.yaml`, or one of `SENSORS`.

    Raises:
        FileError: The file is missing or not valid YAML.
        ConfigError: A field is missing, unknown or out of range.
    """
    if str(name) in SENSORS:
        path = _FOLDER / f"{name}.yaml"
    else:
        path = require_file(name, f"sensor description (or one of {', '.join(SENSORS)})")
    what = f"sensor description '{path}'"
    content = read_yaml(path, what)
    if not isinstance(content, dict):
        raise FileError(f"{what} has no fields; see the shipped ones.")
    try:
        if not isinstance(content.get("gel"), dict):
            raise ConfigError("'gel' is missing or not a table of fields; see the shipped ones.")
        if not isinstance(content.get("markers"), dict | None):
            raise ConfigError("'markers' is not a table of fields; give null if there are none.")
        if content.get("name", "") is None:  # "name:" without text
            content["name"] = ""
        return SensorDescription.from_mapping(_plain_numbers(content))
    except ConfigError as error:
        raise ConfigError(f"{what}: {error}") from error


def save_sensor(sensor: SensorDescription, path: str | Path) -> None:
    """Write a sensor description."""
    with atomic_path(path) as temporary:
        text = yaml.safe_dump(to_mapping(sensor), sort_keys=False, default_flow_style=None)
        temporary.write_text(text, encoding="utf-8")


def _plain_numbers(value: Any, name: str = "") -> Any:
    """Return a value with whole floats as integers; refuse 1e-3, which YAML reads as text."""
    if isinstance(value, dict):
        return {k: _plain_numbers(v, f"{name}.{k}".strip(".")) for k, v in value.items()}
    if isinstance(value, list):
        return [_plain_numbers(item, name) for item in value]
    if isinstance(value, str) and name != "name" and _EXPONENT.fullmatch(value):
        raise ConfigError(
            f"{name}={value!r} must be a number (YAML takes 1.0e-3 for one, not 1e-3)."
        )
    return int(value) if isinstance(value, float) and value.is_integer() else value
