"""Objects of known size that tell the size of a pixel: their faces' corners, in mm and as seen."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError, FileError
from tactorch.mesh.values import Real, positive
from tactorch.sensor.table import read_rows

_SMALLEST_MM, _LARGEST_MM = 0.5, 200.0
_COLUMNS = ("image", "corner", "x_px", "y_px")
_SHARP = 0.1  # sine of the turn at a corner below which three corners lie on a line
_APART_PX = 3.0  # corners that are nearer are one
_HAND_PX = 0.5  # standard deviation of a corner that is set by hand, at best


@dataclass(frozen=True)
class KnownShape:
    """The flat face of an object, a convex polygon of known size, pressed into the gel.

    Attributes:
        name: For messages.
        corners_mm: About its middle, going round as seen in the image (from x toward y).
    """

    name: str
    corners_mm: tuple[tuple[float, float], ...]

    @property
    def corners(self) -> Float[np.ndarray, "n 2"]:
        """Corners as an array, mm."""
        return np.array(self.corners_mm)

    @property
    def turn_rad(self) -> float:
        """Least angle by which it turns into itself."""
        own = self.corners[:, 0] + 1j * self.corners[:, 1]
        for shift in range(1, len(own)):
            turned = np.roll(own, -shift) / own
            if np.ptp(turned.real) < 1e-9 and np.ptp(turned.imag) < 1e-9:
                return float(np.angle(turned[0]) % (2 * np.pi))
        return 2 * np.pi


def hexagon(across_flats_mm: Real) -> KnownShape:
    """Return the face of a regular hexagon: a nut, or a prism.

    Args:
        across_flats_mm: Distance of opposite sides.

    Raises:
        ConfigError: It is not positive, or no size that a gel can take.
    """
    size = _size("across_flats_mm", across_flats_mm)
    angles = np.deg2rad(60.0 * np.arange(6))
    return KnownShape("hexagon", _around(size / np.sqrt(3.0), angles))


def cuboid(width_mm: Real, height_mm: Real) -> KnownShape:
    """Return the face of a cuboid.

    Args:
        width_mm: One side of the face.
        height_mm: The other.

    Raises:
        ConfigError: A side is not positive, or no size that a gel can take.
    """
    x, y = _size("width_mm", width_mm) / 2, _size("height_mm", height_mm) / 2
    return KnownShape("cuboid", ((-x, -y), (x, -y), (x, y), (-x, y)))


def _around(radius: float, angles: Float[np.ndarray, " n"]) -> tuple[tuple[float, float], ...]:
    return tuple((float(radius * np.cos(a)), float(radius * np.sin(a))) for a in angles)


def _size(name: str, value: Real) -> float:
    size = positive(name, value)
    if size < _SMALLEST_MM:
        metres = f" {size:g} looks like metres; give {1e3 * size:g}." if size <= 0.2 else ""
        raise ConfigError(f"{name}={size:g}: give mm, from {_SMALLEST_MM:g}.{metres}")
    if size > _LARGEST_MM:
        raise ConfigError(f"{name}={size:g}: give mm, up to {_LARGEST_MM:g}.")
    return size


@dataclass(frozen=True, eq=False)
class Outline:
    """A face of known shape as an image shows it.

    Attributes:
        name: Of the image.
        corners_px: Its corners (column, row), going round from x toward y.
        deviation_px: Standard deviation of a corner's place; 0 where it is not known.
        edge_px: Standard deviation of how far out its edges lie, all alike; 0 likewise.

    Raises:
        ConfigError: Corners are no convex polygon.
    """

    name: str
    corners_px: Float[np.ndarray, "n 2"]
    deviation_px: float = 0.0
    edge_px: float = 0.0

    def __post_init__(self) -> None:
        corners = np.asarray(self.corners_px, dtype=float)
        if len(corners) < 3 or not np.isfinite(corners).all():
            raise ConfigError(f"{self.name}: give three corners or more, as finite numbers.")
        away = corners - corners.mean(axis=0)
        corners = corners[np.argsort(np.arctan2(away[:, 1], away[:, 0]))]
        object.__setattr__(self, "corners_px", corners)
        sides = np.roll(corners, -1, axis=0) - corners
        length = np.linalg.norm(sides, axis=1)
        if length.min() < _APART_PX:
            at = corners[int(length.argmin())]
            raise ConfigError(
                f"{self.name}: two corners are at ({at[0]:.1f}, {at[1]:.1f}) px or nearly so; each"
                " corner is given once."
            )
        after = np.roll(sides, -1, axis=0)
        turns = sides[:, 0] * after[:, 1] - sides[:, 1] * after[:, 0]
        turns /= length * np.roll(length, -1)
        if turns.min() < _SHARP:
            x, y = corners[(int(turns.argmin()) + 1) % len(corners)]
            raise ConfigError(
                f"{self.name}: the corner at ({x:.1f}, {y:.1f}) px lies on a line with those beside"
                " it, or inside; corners must be those of a convex polygon."
            )

    def require(self, shape: KnownShape) -> None:
        """Refuse an outline that has another number of corners than a shape.

        Raises:
            ConfigError: It has.
        """
        if len(self.corners_px) != len(shape.corners_mm):
            raise ConfigError(
                f"{self.name}: {len(self.corners_px)} corners, but a {shape.name} has"
                f" {len(shape.corners_mm)}; give each once."
            )


def read_corners(path: str | Path) -> Mapping[str, Outline]:
    """Read corners from a CSV file with columns image, corner, x_px, y_px: a line for each corner.

    `corner` is any name that an image has once; corners may come in any order. Set by hand, they
    are taken to be known to half a pixel.

    Raises:
        FileError: The file is missing, or a line cannot be read; the message names it.
        ConfigError: Corners of an image are no convex polygon; the message names the image.
    """
    found: dict[str, dict[str, tuple[float, float]]] = {}
    for row in read_rows(path, "table of corners", _COLUMNS):
        image, corner = row.text("image"), row.text("corner")
        own = found.setdefault(image, {})
        if corner in own:
            raise FileError(f"{row.location}: corner {corner} of {image} is there twice.")
        own[corner] = (row.number("x_px"), row.number("y_px"))
    if not found:
        raise FileError(f"table of corners '{path}' has no line; give one for each corner.")
    outlines = {}
    for image, corners in found.items():
        try:
            outlines[image] = Outline(image, np.array(list(corners.values())), _HAND_PX, _HAND_PX)
        except ConfigError as error:
            raise ConfigError(f"table of corners '{path}': {error}") from error
    return outlines
