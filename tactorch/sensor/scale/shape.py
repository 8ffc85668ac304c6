"""Objects of known size for the measurement of the pixel size: corners in mm and in images."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError, FileError
from tactorch.mesh.values import Real, positive
from tactorch.sensor.table import read_rows

_MIN_SIZE_MM, _MAX_SIZE_MM = 0.5, 200.0
_COLUMNS = ("image", "corner", "x_px", "y_px")
_MIN_SINE = 0.1  # of the exterior angle at a corner
_MIN_SIDE_PX = 3.0
_LABEL_DEVIATION_PX = 0.5  # standard deviation of labeled corners

Corners = Float[np.ndarray, "n 2"]


@dataclass(frozen=True, eq=False)
class KnownShape:
    """Flat face of an object: a convex polygon of known size.

    Attributes:
        name: Name of the shape, for messages.
        corners: Corners about the center, mm, ordered from x toward y as in the image.
    """

    name: str
    corners: Corners

    @property
    def symmetry_rad(self) -> float:
        """Smallest rotation that maps the shape to itself."""
        corners = self.corners @ (1, 1j)
        for shift in range(1, len(corners)):
            ratio = np.roll(corners, -shift) / corners
            if np.ptp(ratio.real) < 1e-9 and np.ptp(ratio.imag) < 1e-9:
                return float(np.angle(ratio[0]) % (2 * np.pi))
        return 2 * np.pi


def hexagon(across_flats_mm: Real) -> KnownShape:
    """Return the face of a regular hexagon (a nut, or a prism) from the distance of its sides."""
    radius, angles = _size("across_flats_mm", across_flats_mm) / np.sqrt(3.0), np.arange(6)
    unit = np.exp(1j * np.deg2rad(60.0 * angles))
    return KnownShape("hexagon", radius * np.column_stack([unit.real, unit.imag]))


def cuboid(width_mm: Real, height_mm: Real) -> KnownShape:
    """Return the face of a cuboid with these sides."""
    half = np.array([_size("width_mm", width_mm), _size("height_mm", height_mm)]) / 2
    return KnownShape("cuboid", half * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]))


def _size(name: str, value: Real) -> float:
    size = positive(name, value)
    if _MIN_SIZE_MM <= size <= _MAX_SIZE_MM:
        return size
    limit = f"from {_MIN_SIZE_MM:g}" if size < _MIN_SIZE_MM else f"up to {_MAX_SIZE_MM:g}"
    metres = f" {size:g} looks like metres; give {1e3 * size:g}." if size <= 0.2 else ""
    raise ConfigError(f"{name}={size:g}: give mm, {limit}.{metres}")


def sides(corners: Corners) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Start and end of each side of a polygon."""
    return zip(corners, np.roll(corners, -1, axis=0), strict=True)


def square_side(corners: Corners) -> float:
    """Side of the square with the area of a polygon."""
    x, y = corners.T
    return float(np.sqrt(0.5 * abs(x @ np.roll(y, -1) - y @ np.roll(x, -1))))


def rotate(corners: Corners, angle: float) -> Corners:
    """Rotate points about the origin from x toward y."""
    c, s = np.cos(angle), np.sin(angle)
    return corners @ np.array([(c, s), (-s, c)])


@dataclass(frozen=True, eq=False)
class Outline:
    """Outline of a face of known shape in an image.

    Attributes:
        name: Name of the image.
        corners_px: Corners (column, row), ordered from x toward y.
        deviation_px: Standard deviation of a corner; 0 if unknown.
        edge_px: Standard deviation of a common offset of all edges; 0 if unknown.
    """

    name: str
    corners_px: Corners
    deviation_px: float = 0.0
    edge_px: float = 0.0

    def __post_init__(self) -> None:
        corners = np.asarray(self.corners_px, dtype=float)
        if len(corners) < 3 or not np.isfinite(corners).all():
            raise ConfigError(f"{self.name}: give three corners or more, as finite numbers.")
        offsets = corners - corners.mean(axis=0)
        corners = corners[np.argsort(np.arctan2(offsets[:, 1], offsets[:, 0]))]
        object.__setattr__(self, "corners_px", corners)
        along = np.roll(corners, -1, axis=0) - corners
        length = np.linalg.norm(along, axis=1)
        if length.min() < _MIN_SIDE_PX:
            x, y = corners[int(length.argmin())]
            raise ConfigError(
                f"{self.name}: two corners are at ({x:.1f}, {y:.1f}) px or nearly so; give each"
                " corner once."
            )
        along /= length[:, None]
        following = np.roll(along, -1, axis=0)
        sines = along[:, 0] * following[:, 1] - along[:, 1] * following[:, 0]
        if sines.min() < _MIN_SINE:
            x, y = corners[(int(sines.argmin()) + 1) % len(corners)]
            raise ConfigError(
                f"{self.name}: the corner at ({x:.1f}, {y:.1f}) px is on a line with its neighbors,"
                " or inside; give the corners of a convex polygon."
            )


def read_corners(path: str | Path) -> Mapping[str, Outline]:
    """Read corners from a CSV file with columns image, corner, x_px, y_px: a line for each corner.

    `corner` is a name that is unique within an image; the order of corners is arbitrary. Their
    standard deviation is taken as half a pixel.

    Returns:
        Outline by name of the image.

    Raises:
        FileError: The file is missing, or a line cannot be read; the message names it.
        ConfigError: Corners of an image are not a convex polygon; the message names the image.
    """
    table: dict[str, dict[str, tuple[float, float]]] = {}
    for row in read_rows(path, "table of corners", _COLUMNS):
        image, corner = row.text("image"), row.text("corner")
        corners = table.setdefault(image, {})
        if corner in corners:
            raise FileError(f"{row.location}: corner {corner} of {image} is given twice.")
        corners[corner] = (row.number("x_px"), row.number("y_px"))
    if not table:
        raise FileError(f"table of corners '{path}' has no line; give one for each corner.")
    corners_px = {image: np.array(list(corners.values())) for image, corners in table.items()}
    deviations = _LABEL_DEVIATION_PX, _LABEL_DEVIATION_PX
    try:
        return {image: Outline(image, each, *deviations) for image, each in corners_px.items()}
    except ConfigError as error:
        raise ConfigError(f"table of corners '{path}': {error}") from error
