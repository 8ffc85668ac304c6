"""Presses of a ball of known radius: slopes of the gel's face, labels and detection."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float

from tactorch.config import Options, option
from tactorch.errors import ConfigError, FileError
from tactorch.sensor.description import check_pixel_size
from tactorch.sensor.table import read_rows

_COLUMNS = ("image", "center_x_px", "center_y_px", "radius_px")
_MIN_GRADIENT = 0.02  # change of color per pixel, about a gray value
_MAX_RADIUS = 2.0  # of a ball, over the longer side of the image
_CONTACT_LEVEL = 0.4  # of the largest smoothed gradient
_MAX_DETECTED = 0.65  # radius of a detected contact, over that of the ball
_MIN_BELOW = 0.2  # depth below the center of the ball, over its radius, that caps slopes
_CHANGED = 0.2  # change of color of a contact, 10 gray values


@dataclass(frozen=True)
class Circle(Options):
    """Contact with a ball in an image."""

    center_px: tuple[float, float] = option(help="Column and row of the center", unit="px")
    radius_px: float = option(help="Radius, in pixels along x", unit="px", ge=2)


@dataclass(frozen=True, eq=False)
class BallPress:
    """Press of the ball.

    Attributes:
        name: Name of the image.
        change: Change of the colors, see `image_change`.
        known: Pixels not covered by markers.
        circle: Contact, labeled or detected.
        fitted: Contact fitted to the slopes of a map; None before.
        labeled: Whether the circle is labeled, which makes its center more certain.
        outlying: Whether the fitted contact does not agree with the others, see `fit_map`.
    """

    name: str
    change: Float[np.ndarray, "h w 3"]
    known: Bool[np.ndarray, "h w"]
    circle: Circle
    fitted: Circle | None = None
    labeled: bool = False
    outlying: bool = False

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
    def contact(self) -> Circle:
        """Fitted contact if there is one, else the labeled or detected one."""
        return self.fitted or self.circle

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the image."""
        return self.change.shape[0], self.change.shape[1]


@dataclass(frozen=True)
class Ball(Options):
    """Ball, and the size of a pixel in its images."""

    radius_mm: float = option(help="Radius of the ball", unit="mm", ge=0.2, le=100)
    mm_per_px: tuple[float, float] = option(help="Size of a pixel along x and y", unit="mm", gt=0)

    def __post_init__(self) -> None:
        super().__post_init__()
        check_pixel_size(self.mm_per_px)

    def check(self, circle: Circle, name: str) -> None:
        """Check that a contact is no wider than the ball."""
        radius = circle.radius_px * self.mm_per_px[0]
        if radius > self.radius_mm:
            raise ConfigError(
                f"{name}: a contact of radius {radius:.3g} mm is wider than the ball"
                f" ({self.radius_mm:g} mm); check radius_mm and mm_per_px."
            )

    def offsets(self, shape: tuple[int, int], circle: Circle) -> Float[np.ndarray, "2 h w"]:
        """Return the offset of each pixel from the center of a contact along x and y, mm."""
        rows, columns = np.mgrid[: shape[0], : shape[1]]
        return self.offsets_at(columns, rows, circle.center_px)

    def offsets_at(
        self, columns: np.ndarray, rows: np.ndarray, center_px: Sequence[float] | np.ndarray
    ) -> Float[np.ndarray, "2 *n"]:
        """Return the offsets of pixels from a center along x and y, mm."""
        x, y = self.mm_per_px
        return np.stack([(columns - center_px[0]) * x, (rows - center_px[1]) * y])

    def slopes_at(self, offsets_mm: Float[np.ndarray, "2 *n"]) -> Float[np.ndarray, "*n 2"]:
        """Return dz/dx and dz/dy of the ball's surface, z out of the sensor; steep ones are capped.

        z = z0 - sqrt(R^2 - r^2) increases from the center of the contact outward.
        """
        below = np.maximum(self._below(offsets_mm), _MIN_BELOW * self.radius_mm)
        return np.moveaxis(offsets_mm / below, 0, -1)

    def slopes(self, shape: tuple[int, int], circle: Circle) -> Float[np.ndarray, "h w 2"]:
        """Return dz/dx and dz/dy of the ball's surface in an image."""
        return self.slopes_at(self.offsets(shape, circle))

    def heights(self, shape: tuple[int, int], circle: Circle) -> Float[np.ndarray, "h w"]:
        """Return z of the ball's surface relative to the contact's edge, mm: negative inside."""
        edge = min(circle.radius_px * self.mm_per_px[0], self.radius_mm)
        return np.sqrt(self.radius_mm**2 - edge**2) - self._below(self.offsets(shape, circle))

    def distance(self, shape: tuple[int, int], circle: Circle) -> Float[np.ndarray, "h w"]:
        """Return the distance of each pixel from the center, over the contact's radius."""
        return np.hypot(*self.offsets(shape, circle)) / (circle.radius_px * self.mm_per_px[0])

    def _below(self, offsets_mm: Float[np.ndarray, "2 *n"]) -> Float[np.ndarray, "*n"]:
        """Depth of the ball's surface below its center, mm."""
        x, y = offsets_mm
        return np.sqrt(np.maximum(self.radius_mm**2 - x**2 - y**2, 0.0))


def ball_slope(r: np.ndarray | float, radius: float) -> np.ndarray:
    """Return the outward slope of a ball's surface at distances from the center; see `Ball`."""
    below = np.sqrt(np.maximum(radius**2 - np.square(r), 0.0))
    return np.asarray(r / np.maximum(below, _MIN_BELOW * radius))


def read_labels(path: str | Path) -> Mapping[str, Circle]:
    """Return contacts by name of the image, from a CSV file.

    The columns are image, center_x_px, center_y_px, radius_px.
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

    The size is rough, and at most 0.65 of the ball's; `fit_map` measures it.

    `change` is that of the colors against the reference, see `image_change`; messages contain the
    `name` of the image.

    Raises:
        ConfigError: There is no round change.
    """
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
        raise ConfigError(f"{name}: no ball found; {_without_gradient(change)}")
    mask = (gradient > _CONTACT_LEVEL * largest).astype(np.uint8)
    _, labels, statistics, centers = cv2.connectedComponentsWithStats(mask)
    weights = np.bincount(labels.ravel(), gradient.ravel())
    label = int(np.argmax(weights[1:])) + 1
    _, _, width, height, area = (int(v) for v in statistics[label])
    if max(width, height) > 2.2 * min(width, height) or area < 0.4 * width * height:
        raise ConfigError(
            f"{name}: no ball found; what changed is {width} x {height} px and not round. Label it"
            " by hand, or leave it out."
        )
    if width * height > 0.8 * rows * columns:
        raise ConfigError(
            f"{name}: no ball found; the whole image changed. Is the reference of this sensor?"
        )
    x, y = centers[label]
    return Circle((x, y), min(np.sqrt(area / np.pi), _MAX_DETECTED * radius_px))


def _without_gradient(change: Float[np.ndarray, "h w 3"]) -> str:
    smooth = cv2.GaussianBlur(change, (0, 0), 2.0)
    largest = float(np.linalg.norm(smooth, axis=-1).max())
    if largest < _CHANGED:
        return (
            "nothing changed against the reference. Leave the image out, or check that the"
            " reference is without contact."
        )
    return (
        f"its colors change by up to {50 * largest:.0f} gray values, but nowhere as steeply as in a"
        " contact. Either the ball is too large for the image (check radius_mm and mm_per_px), or"
        " the colors of this sensor do not depend on slopes (its light is not directed)."
    )


def _smooth_gradient(change: Float[np.ndarray, "h w 3"], radius_px: float) -> np.ndarray:
    """Gradient of the colors averaged over part of a contact.

    Slopes vary steadily across a contact, unlike light scattered within the gel.
    """
    smooth = cv2.GaussianBlur(change, (0, 0), max(1.0, 0.06 * radius_px))
    steep = np.sqrt(sum((np.gradient(smooth, axis=k) ** 2).sum(axis=-1) for k in (0, 1)))
    return cv2.GaussianBlur(steep, (0, 0), 0.3 * radius_px)
