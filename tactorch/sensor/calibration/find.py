"""Finding where a ball touches, before anything is known of colours and slopes."""

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError
from tactorch.sensor.calibration.ball import Ball, Circle

_LEAST_CHANGE = 0.02  # in units of `change` per pixel: a grey value or so
_LARGEST = 2.0  # radius of a ball over the image's longer side
_SHARE = 0.4  # of the strongest change from pixel to pixel, smoothed: the contact's is more


def find_circle(changed: Float[np.ndarray, "h w 3"], ball: Ball, name: str = "image") -> Circle:
    """Return about where a ball touches: the middle of what changed most, and its size.

    Args:
        changed: Change of the colours against the reference, see `change`.
        ball: The ball.
        name: Of the image, for messages.

    Raises:
        ConfigError: No round change is seen.
    """
    import cv2

    radius_px = ball.radius_mm / ball.mm_per_px[0]
    rows, columns = changed.shape[:2]
    if radius_px > _LARGEST * max(rows, columns):
        raise ConfigError(
            f"{name}: a ball of radius_mm={ball.radius_mm:g} would be {radius_px:.0f} px in an"
            f" image of {columns} x {rows}; check radius_mm and mm_per_px={ball.mm_per_px[0]:g}."
        )
    if not np.isfinite(changed).all():
        raise ConfigError(f"{name}: the change of its colours is not finite; is the image whole?")
    size = _steepness(changed, radius_px)
    top = float(size.max())
    if top < _LEAST_CHANGE:
        raise ConfigError(
            f"{name}: no ball found; nothing changed against the reference. Leave the"
            " image out, or check that the reference is without contact."
        )
    mask = (size > _SHARE * top).astype(np.uint8)
    _, labels, facts, centers = cv2.connectedComponentsWithStats(mask)
    weights = np.bincount(labels.ravel(), size.ravel())
    weights[0] = 0.0
    label = int(np.argmax(weights))
    _check_round(facts[label], size.shape, name)
    radius = np.sqrt(float(facts[label, cv2.CC_STAT_AREA]) / np.pi)
    most = 0.65 * radius_px
    return Circle((float(centers[label, 0]), float(centers[label, 1])), float(min(radius, most)))


def _steepness(changed: Float[np.ndarray, "h w 3"], radius_px: float) -> np.ndarray:
    """How much the colours change from pixel to pixel, averaged over part of a contact.

    Slopes grow steadily across a contact, and light that spreads over the gel does not.
    """
    import cv2

    smooth = cv2.GaussianBlur(changed, (0, 0), max(1.0, 0.06 * radius_px))
    steep = np.sqrt(sum((np.gradient(smooth, axis=k) ** 2).sum(axis=-1) for k in (0, 1)))
    return cv2.GaussianBlur(steep, (0, 0), 0.3 * radius_px)


def _check_round(fact: np.ndarray, shape: tuple[int, ...], name: str) -> None:
    import cv2

    width, height = int(fact[cv2.CC_STAT_WIDTH]), int(fact[cv2.CC_STAT_HEIGHT])
    share = fact[cv2.CC_STAT_AREA] / (width * height)
    if max(width, height) > 2.2 * min(width, height) or share < 0.4:
        raise ConfigError(
            f"{name}: no ball found; what changed is {width} x {height} px and not round. Label it"
            " by hand, or leave it out."
        )
    if width * height > 0.8 * shape[0] * shape[1]:
        raise ConfigError(
            f"{name}: no ball found; the whole image changed. Is the reference of this sensor?"
        )
