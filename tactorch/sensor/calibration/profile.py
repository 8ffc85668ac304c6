"""Slopes of a gel under a ball: those of the ball inside the contact, decaying outside.

Outside the contact the face follows the solution for an elastic half-space (Johnson, Contact
Mechanics, 1985, Section 4.2), which decays faster for a thin gel. Camera and smoothing blur the
slopes. The slopes are steepest near the contact's edge, which determines its radius.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import least_squares

from tactorch.sensor.calibration.ball import Ball, BallPress, ball_slope

#: Largest radius of a contact, over that of the ball.
MAX_CONTACT = 0.95
_CANDIDATES = 94
_FITTED = (0.2, 1.8)  # radii of a fitted profile, over the approximate contact radius
_SAMPLES = 1200
_REACH = 3.0  # of the sampled profile, over the radius of the ball
_CONTACT = (0.6, 1.5)  # bounds of the radius, over the approximate one
_START = (0.05, 2.0)  # blur and decay length, over the radii of ball and contact
_BLUR, _DECAY = (1e-3, 0.4), (0.05, 50.0)  # their bounds
_MAX_ERROR = 0.1  # of slopes that are no outliers

Profile = Float[np.ndarray, " rings"]
Image = Float[np.ndarray, "h w"]


@dataclass(frozen=True)
class ContactProfile:
    """Radial slopes of the gel under a ball.

    Attributes:
        radius_mm: Radius of the ball, mm.
        contact_mm: Radius of the contact, mm.
        blur_mm: Standard deviation of the blur, mm.
        decay_mm: Length by which slopes outside decay faster than on a half-space, mm.
    """

    radius_mm: float
    contact_mm: float
    blur_mm: float = 0.0
    decay_mm: float = np.inf

    def slopes(self, distance_mm: Profile) -> Profile:
        """Return the outward slopes at distances from the center, mm."""
        reach = _REACH * self.radius_mm
        samples = np.linspace(-reach, reach, 2 * _SAMPLES + 1)
        values = np.sign(samples) * self._sharp_slopes(np.abs(samples))
        if self.blur_mm > 0:
            values = gaussian_filter1d(values, self.blur_mm / (reach / _SAMPLES))
        return np.interp(distance_mm, samples, values)

    def _sharp_slopes(self, r: np.ndarray) -> np.ndarray:
        a, radius = self.contact_mm, self.radius_mm
        outer = np.maximum(r, a)
        ratio = a / outer
        # The derivative of Johnson's (3.42a); its unit is the slope of a paraboloid at the edge.
        decrease = 2 / np.pi * (np.arcsin(ratio) / ratio - np.sqrt(1 - ratio**2))
        outside = decrease * np.exp(-(outer - a) / self.decay_mm)
        return np.where(r < a, ball_slope(r, radius), ball_slope(a, radius) * outside)


def radial_means(
    values: Image, distance: Image, width: float, limit: float
) -> tuple[Profile, Profile, Profile]:
    """Return radii, means and numbers of pixels of rings up to a limit.

    Pixels whose distance is not finite are left out.
    """
    count = max(1, round(limit / width))
    with np.errstate(invalid="ignore"):
        ring = np.where(np.isfinite(distance), distance / width, count).astype(int)
    inside = ring < count
    numbers = np.bincount(ring[inside], minlength=count)
    sums = np.bincount(ring[inside], values[inside], minlength=count)
    return (np.arange(count) + 0.5) * width, sums / np.maximum(numbers, 1), numbers.astype(float)


def steepest_contact(press: BallPress, ball: Ball) -> float:
    """Return the approximate contact radius by the ring of largest change of the colors, mm."""
    width, strength = ball.mm_per_px[0], np.linalg.norm(press.change, axis=-1)
    distance = np.hypot(*ball.offsets(press.shape, press.contact))
    distance = np.where(press.known, distance, np.nan)
    radii, means, numbers = radial_means(strength, distance, width, ball.radius_mm)
    means = np.where(numbers > 0, gaussian_filter1d(means, 1.0), 0.0)
    steepest = float(radii[int(means.argmax())])
    contacts = np.linspace(0.02, MAX_CONTACT, _CANDIDATES) * ball.radius_mm
    expected = _steepest_radii() * ball.radius_mm
    contact = float(np.interp(steepest, expected, contacts))
    return float(np.clip(contact, 3 * width, MAX_CONTACT * ball.radius_mm))


@cache
def _steepest_radii() -> Float[np.ndarray, " candidates"]:
    """Radius of the largest slope for contacts of increasing radius, on a ball of radius 1."""
    distance = np.linspace(0.0, 1.2, _SAMPLES)
    profiles = (
        ContactProfile(1.0, contact, _START[0]).slopes(distance)
        for contact in np.linspace(0.02, MAX_CONTACT, _CANDIDATES)
    )
    steepest = [float(distance[int(profile.argmax())]) for profile in profiles]
    return np.maximum.accumulate(steepest)


def fit_profile(
    outward: Image, distance_mm: Image, ball: Ball, contact_mm: float
) -> ContactProfile:
    """Fit contact radius, blur and decay to measured slopes away from the center of a contact.

    Pixels whose distance from the center is not finite are left out; `contact_mm` is an approximate
    radius of the contact.
    """
    limit = _FITTED[1] * contact_mm
    rings = radial_means(outward, distance_mm, ball.mm_per_px[0], limit)
    used = (rings[0] > _FITTED[0] * contact_mm) & (rings[2] > 0)
    radii, means, numbers = (each[used] for each in rings)
    weights = np.sqrt(numbers / max(numbers.sum(), 1.0))
    radius = ball.radius_mm

    def profile(logs: np.ndarray) -> ContactProfile:
        contact, blur, decay = np.exp(logs)
        return ContactProfile(radius, contact, blur * radius, decay * contact)

    smallest, largest = (factor * contact_mm for factor in _CONTACT)
    largest = max(min(largest, MAX_CONTACT * radius), 1.01 * smallest)
    lower, upper = np.log([(smallest, _BLUR[0], _DECAY[0]), (largest, _BLUR[1], _DECAY[1])])
    start = np.clip(np.log([contact_mm, *_START]), lower + 1e-6, upper - 1e-6)
    solution = least_squares(
        lambda logs: weights * (profile(logs).slopes(radii) - means),
        start, bounds=(lower, upper), loss="soft_l1", f_scale=_MAX_ERROR * float(weights.mean()),
    )  # fmt: skip
    return profile(solution.x)
