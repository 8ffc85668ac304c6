"""Presses of a ball of known radius: what the slopes of the gel's face are where it touches."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError, FileError
from tactorch.sensor.description import pixel_size
from tactorch.sensor.table import read_rows

_COLUMNS = ("image", "center_x_px", "center_y_px", "radius_px")


@dataclass(frozen=True)
class Circle:
    """A contact with a ball, as seen in the image.

    Attributes:
        center_px: Column and row.
        radius_px: Of the contact, in pixels along x.
    """

    center_px: tuple[float, float]
    radius_px: float

    def __post_init__(self) -> None:
        values = [*self.center_px, self.radius_px]
        if len(values) != 3 or not np.isfinite(values).all() or self.radius_px < 2:
            raise ConfigError(
                f"circle at {self.center_px} with radius {self.radius_px}: give two finite numbers"
                " and a radius of at least 2 px."
            )


@dataclass(frozen=True)
class Ball:
    """A ball, and the pixels that it is seen with.

    Attributes:
        radius_mm: Of the ball.
        mm_per_px: Size of a pixel along x and y, mm.
    """

    radius_mm: float
    mm_per_px: tuple[float, float]

    def __post_init__(self) -> None:
        if not 0.2 <= self.radius_mm <= 100.0:
            metres = f" Is it in metres? Then give {1e3 * self.radius_mm:g}."
            raise ConfigError(
                f"radius_mm={self.radius_mm:g}: give a ball's radius, 0.2 to 100 mm."
                + (metres if 2e-4 <= self.radius_mm <= 0.1 else "")
            )
        pixel_size("mm_per_px", self.mm_per_px)

    def check(self, circle: Circle, name: str) -> None:
        """Refuse a contact that is wider than the ball.

        Raises:
            ConfigError: It is.
        """
        radius = circle.radius_px * self.mm_per_px[0]
        if radius > self.radius_mm:
            raise ConfigError(
                f"{name}: a contact of radius {radius:.3g} mm is wider than the ball"
                f" ({self.radius_mm:g} mm); check radius_mm and mm_per_px."
            )

    def away(
        self, shape: tuple[int, int], circle: Circle
    ) -> tuple[Float[np.ndarray, "h w"], Float[np.ndarray, "h w"]]:
        """Return how far each pixel is from the middle of a contact, along x and y, mm."""
        rows, columns = np.mgrid[: shape[0], : shape[1]]
        x, y = circle.center_px
        return (columns - x) * self.mm_per_px[0], (rows - y) * self.mm_per_px[1]

    def slopes(self, shape: tuple[int, int], circle: Circle) -> Float[np.ndarray, "h w 2"]:
        """Return dz/dx and dz/dy of the ball's face, z out of the sensor; steep ones are cut off.

        z = z0 - sqrt(R^2 - r^2) rises from the middle of the contact outward.
        """
        x, y = self.away(shape, circle)
        below = np.sqrt(np.maximum(self.radius_mm**2 - x**2 - y**2, 0.0))
        return np.stack([x, y], axis=-1) / np.maximum(below, 0.2 * self.radius_mm)[..., None]

    def heights(self, shape: tuple[int, int], circle: Circle) -> Float[np.ndarray, "h w"]:
        """Return z of the ball's face over that of the contact's edge, mm: negative inside."""
        x, y = self.away(shape, circle)
        edge = min(circle.radius_px * self.mm_per_px[0], self.radius_mm)
        below = np.sqrt(np.maximum(self.radius_mm**2 - x**2 - y**2, 0.0))
        return np.sqrt(self.radius_mm**2 - edge**2) - below

    def distance(self, shape: tuple[int, int], circle: Circle) -> Float[np.ndarray, "h w"]:
        """Return how far each pixel is from the middle, over the contact's radius."""
        x, y = self.away(shape, circle)
        return np.hypot(x, y) / (circle.radius_px * self.mm_per_px[0])


def read_labels(path: str | Path) -> Mapping[str, Circle]:
    """Read contacts from a CSV file with columns image, center_x_px, center_y_px, radius_px.

    Raises:
        FileError: The file is missing, or a line cannot be read; the message names it.
    """
    found: dict[str, Circle] = {}
    # Other people's tables call a contact's radius that.
    also = {"contact_radius_px": "radius_px"}
    for row in read_rows(path, "table of contacts", _COLUMNS, also):
        name, (x, y, radius) = row.text("image"), [row.number(one) for one in _COLUMNS[1:]]
        if name in found:
            raise FileError(
                f"{row.location}: {name} has a contact already; give one for each image."
            )
        try:
            found[name] = Circle((x, y), radius)
        except ConfigError as error:
            raise FileError(f"{row.location}: {error}") from error
    if not found:
        raise FileError(f"table of contacts '{path}' has no line; give one for each image.")
    return found
