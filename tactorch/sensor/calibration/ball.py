"""Presses of a ball of known radius: slopes of the gel's face, labels and detection."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from tactorch.errors import ConfigError, FileError
from tactorch.sensor.description import pixel_size
from tactorch.sensor.table import read_rows

_COLUMNS = ("image", "center_x_px", "center_y_px", "radius_px")
_MIN_GRADIENT = 0.02  # change of color per pixel, about a gray value
_MAX_RADIUS = 2.0  # of a ball, over the longer side of the image
_CONTACT_LEVEL = 0.4  # of the largest smoothed gradient
_MAX_CONTACT = 0.65  # radius of a detected contact, over that of the ball


@dataclass(frozen=True)
class Circle:
    """Contact with a ball in an image.

    Attributes:
        center_px: Column and row of the center.
        radius_px: Radius, in pixels along x.
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


@dataclass(frozen=True, eq=False)
class BallPress:
    """Press of the ball.

    Attributes:
        name: Name of the image.
        change: Change of the colors, see `image_change`.
        known: Pixels not covered by markers.
        circle: Contact, labeled or detected.
    """

    name: str
    change: Float[np.ndarray, "h w 3"]
    known: Bool[np.ndarray, "h w"]
    circle: Circle

    def __post_init__(self) -> None:
        rows, columns = self.shape
        (x, y), radius = self.circle.center_px, self.circle.radius_px
        if not (-0.5 <= x <= columns - 0.5 and -0.5 <= y <= rows - 0.5):
            raise ConfigError(
                f"{self.name}: the contact at ({x:g}, {y:g}) px is outside the image of {columns}"
                f" x {rows} px; are labels and image of one size, and x before y?"
            )
        if radius > max(rows, columns):
            raise ConfigError(
                f"{self.name}: the contact's radius_px={radius:g} is more than the image of"
                f" {columns} x {rows} px; give pixels."
            )
        if not np.isfinite(self.change).all():
            raise ConfigError(f"{self.name}: the change of its colors is not finite; leave it out.")

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the image."""
        return self.change.shape[0], self.change.shape[1]


@dataclass(frozen=True)
class Ball:
    """Ball, and the size of a pixel in its images.

    Attributes:
        radius_mm: Radius of the ball.
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
        """Check that a contact is no wider than the ball.

        Raises:
            ConfigError: The contact is wider.
        """
        radius = circle.radius_px * self.mm_per_px[0]
        if radius > self.radius_mm:
            raise ConfigError(
                f"{name}: a contact of radius {radius:.3g} mm is wider than the ball"
                f" ({self.radius_mm:g} mm); check radius_mm and mm_per_px."
            )

    def offsets(
        self, shape: tuple[int, int], circle: Circle
    ) -> tuple[Float[np.ndarray, "h w"], Float[np.ndarray, "h w"]]:
        """Return the offset of each pixel from the center of a contact along x and y, mm."""
        rows, columns = np.mgrid[: shape[0], : shape[1]]
        x, y = circle.center_px
        return (columns - x) * self.mm_per_px[0], (rows - y) * self.mm_per_px[1]

    def slopes(self, shape: tuple[int, int], circle: Circle) -> Float[np.ndarray, "h w 2"]:
        """Return dz/dx and dz/dy of the ball's surface, z out of the sensor; steep ones are capped.

        z = z0 - sqrt(R^2 - r^2) increases from the center of the contact outward.
        """
        x, y = self.offsets(shape, circle)
        below = np.sqrt(np.maximum(self.radius_mm**2 - x**2 - y**2, 0.0))
        return np.stack([x, y], axis=-1) / np.maximum(below, 0.2 * self.radius_mm)[..., None]

    def heights(self, shape: tuple[int, int], circle: Circle) -> Float[np.ndarray, "h w"]:
        """Return z of the ball's surface relative to the contact's edge, mm: negative inside."""
        x, y = self.offsets(shape, circle)
        edge = min(circle.radius_px * self.mm_per_px[0], self.radius_mm)
        below = np.sqrt(np.maximum(self.radius_mm**2 - x**2 - y**2, 0.0))
        return np.sqrt(self.radius_mm**2 - edge**2) - below

    def distance(self, shape: tuple[int, int], circle: Circle) -> Float[np.ndarray, "h w"]:
        """Return the distance of each pixel from the center, over the contact's radius."""
        x, y = self.offsets(shape, circle)
        return np.hypot(x, y) / (circle.radius_px * self.mm_per_px[0])


def read_labels(path: str | Path) -> Mapping[str, Circle]:
    """Read contacts from a CSV file with columns image, center_x_px, center_y_px, radius_px.

    Returns:
        Contact by name of the image.

    Raises:
        FileError: The file is missing, or a line cannot be read; the message names it.
    """
    labels: dict[str, Circle] = {}
    aliases = {"contact_radius_px": "radius_px"}  # used by published data sets
    for row in read_rows(path, "table of contacts", _COLUMNS, aliases):
        name = row.text("image")
        x, y, radius = (row.number(column) for column in _COLUMNS[1:])
        if name in labels:
            raise FileError(
                f"{row.location}: {name} has a contact already; give one for each image."
            )
        try:
            labels[name] = Circle((x, y), radius)
        except ConfigError as error:
            raise FileError(f"{row.location}: {error}") from error
    if not labels:
        raise FileError(f"table of contacts '{path}' has no line; give one for each image.")
    return labels


def find_circle(change: Float[np.ndarray, "h w 3"], ball: Ball, name: str = "image") -> Circle:
    """Return an approximate contact: center and size of the region of largest color gradient.

    Args:
        change: Change of the colors against the reference, see `image_change`.
        ball: Ball.
        name: Name of the image, for messages.

    Returns:
        The contact.

    Raises:
        ConfigError: There is no round change.
    """
    import cv2

    radius_px = ball.radius_mm / ball.mm_per_px[0]
    rows, columns = change.shape[:2]
    if radius_px > _MAX_RADIUS * max(rows, columns):
        raise ConfigError(
            f"{name}: a ball of radius_mm={ball.radius_mm:g} would be {radius_px:.0f} px in an"
            f" image of {columns} x {rows}; check radius_mm and mm_per_px={ball.mm_per_px[0]:g}."
        )
    if not np.isfinite(change).all():
        raise ConfigError(f"{name}: the change of its colors is not finite; give a whole image.")
    gradient = _smooth_gradient(change, radius_px)
    largest = float(gradient.max())
    if largest < _MIN_GRADIENT:
        raise ConfigError(
            f"{name}: no ball found; nothing changed against the reference. Leave the"
            " image out, or check that the reference is without contact."
        )
    mask = (gradient > _CONTACT_LEVEL * largest).astype(np.uint8)
    _, labels, statistics, centers = cv2.connectedComponentsWithStats(mask)
    weights = np.bincount(labels.ravel(), gradient.ravel())
    weights[0] = 0.0
    label = int(np.argmax(weights))
    _check_round(statistics[label], gradient.shape, name)
    radius = np.sqrt(float(statistics[label, cv2.CC_STAT_AREA]) / np.pi)
    center = float(centers[label, 0]), float(centers[label, 1])
    return Circle(center, float(min(radius, _MAX_CONTACT * radius_px)))


def _smooth_gradient(change: Float[np.ndarray, "h w 3"], radius_px: float) -> np.ndarray:
    """Gradient of the colors averaged over part of a contact.

    Slopes vary steadily across a contact, unlike light scattered within the gel.
    """
    import cv2

    smooth = cv2.GaussianBlur(change, (0, 0), max(1.0, 0.06 * radius_px))
    steep = np.sqrt(sum((np.gradient(smooth, axis=k) ** 2).sum(axis=-1) for k in (0, 1)))
    return cv2.GaussianBlur(steep, (0, 0), 0.3 * radius_px)


def _check_round(statistics: np.ndarray, shape: tuple[int, ...], name: str) -> None:
    import cv2

    width, height = int(statistics[cv2.CC_STAT_WIDTH]), int(statistics[cv2.CC_STAT_HEIGHT])
    fill = statistics[cv2.CC_STAT_AREA] / (width * height)
    if max(width, height) > 2.2 * min(width, height) or fill < 0.4:
        raise ConfigError(
            f"{name}: no ball found; what changed is {width} x {height} px and not round. Label it"
            " by hand, or leave it out."
        )
    if width * height > 0.8 * shape[0] * shape[1]:
        raise ConfigError(
            f"{name}: no ball found; the whole image changed. Is the reference of this sensor?"
        )
