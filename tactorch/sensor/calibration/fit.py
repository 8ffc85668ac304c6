"""Joint fit of the map from colors to slopes and of the contacts of a ball.

Labels and detected contacts are off by some pixels, which makes slopes inconsistent with any map.
The centers are therefore first fitted together with a simple map, see `align`, and then map and
contacts alternately: the map to the slopes of the ball well inside the contacts, each contact to
the slopes of the map. Radii follow from where the slopes are steepest, see `profile`. The size of a
pixel is not determined: slopes of a larger ball are an equally good function of the colors, so
`mm_per_px` has to be measured.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize

from tactorch.config import Options, option
from tactorch.errors import ConfigError
from tactorch.sensor.calibration.align import align_contacts, draw
from tactorch.sensor.calibration.ball import Ball, BallPress, Circle
from tactorch.sensor.calibration.maps import (
    SENSOR_MAPS,
    Mlp,
    SensorMap,
    SlopeMap,
    map_slopes,
    pixel_features,
)
from tactorch.sensor.calibration.profile import fit_profile, radial_means, steepest_contact

_TRAINING_RADIUS = 0.92  # of the pixels that the map is fitted to, over the contact's radius
_CENTER_RADIUS = 0.8  # of the pixels that a circle's center is fitted to
#: Radius of the pixels that a map is evaluated at, over the contact's radius.
EVALUATED_RADIUS = 0.9
#: Radius beyond which the slopes of the gel are about zero, over the contact's radius.
FLAT_RADIUS = 2.5
_PIXELS, _FLAT_PIXELS = 2500, 600  # drawn per press
_MAX_SQUARED_ERROR = 0.25  # of slopes, for pixels that count as outliers
_RESOLVED = 0.8  # of the ball's slopes, from which a map follows them
_MIN_RESOLVED = 0.6  # of the contact's radius, within which all slopes are
_PASSES = 3  # of the fit of a left-out contact
_OUTLYING, _MIN_OUTLYING = 3.0, 0.08  # error of an outlying press, over the median, and absolute


@dataclass(frozen=True)
class FitOptions(Options):
    """Calibration fit."""

    map: SensorMap = option(factory=Mlp, help="Map from colors to slopes", section="sensor_map")
    rounds: int = option(6, "Alternations of fitting map and contacts; 0 keeps the contacts", ge=0)
    seed: int = option(0, "Seed of the map and of the drawn pixels", ge=0)


def fit_map(
    presses: Sequence[BallPress],
    ball: Ball,
    options: FitOptions | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[SlopeMap, list[BallPress]]:
    """Fit the map from colors to slopes together with the contacts.

    Presses whose slopes disagree with those of the others are left out of the fit of the map.
    `progress` receives the number of finished rounds and of all.

    Returns:
        The map, and the presses with fitted contacts; `outlying` marks those that disagree.
    """
    options = options or FitOptions()
    if not presses:
        raise ConfigError(
            "no press of the ball to calibrate with; give images and where it touches."
        )
    if options.map.contacts_by is not None:
        other = replace(options, map=SENSOR_MAPS.build(options.map.contacts_by))
        found, fitted = fit_map(presses, ball, other, progress)
        return fit_to_contacts(options.map, fitted, found, ball, options.seed), fitted
    slope_map, fitted = options.map.create(options.seed), list(presses)
    if options.rounds > 0:
        fitted = _initial_contacts(fitted, ball, options.seed)
    for number in range(options.rounds + 1):
        found_by = slope_map if number > 0 else None
        _fit_map_to_contacts(slope_map, fitted, found_by, ball, options.seed + number)
        if number < options.rounds:
            fitted = [fit_contact(press, slope_map, ball) for press in fitted]
            fitted = _mark_outlying(fitted, slope_map, ball)
        progress(number + 1, options.rounds + 1)
    return slope_map, fitted


def fit_to_contacts(
    options: SensorMap, presses: Sequence[BallPress], found_by: SlopeMap, ball: Ball, seed: int = 0
) -> SlopeMap:
    """Return a map fitted to contacts that another map has found."""
    slope_map = options.create(seed)
    _fit_map_to_contacts(slope_map, presses, found_by, ball, seed)
    return slope_map


def _initial_contacts(presses: list[BallPress], ball: Ball, seed: int) -> list[BallPress]:
    """Fit the centers, and estimate the radii by where the colors change most."""
    for press in presses:
        ball.check(press.circle, press.name)
    rough = [_with_steepest_contact(press, ball) for press in presses]
    radii = [press.contact.radius_px * ball.mm_per_px[0] for press in rough]
    aligned = align_contacts(rough, ball, radii, seed)
    return [_with_steepest_contact(press, ball) for press in aligned]


def _with_steepest_contact(press: BallPress, ball: Ball) -> BallPress:
    """Return a press with the radius where its colors change most."""
    radius = steepest_contact(press, ball) / ball.mm_per_px[0]
    return _with_contact(press, press.contact.center_px, radius)


def fit_contact(press: BallPress, slope_map: SlopeMap, ball: Ball) -> BallPress:
    """Return a press with its contact fitted to the slopes of a map, from the present contact.

    The center is fitted to the slopes well inside, the radius to the decay of the slopes outside; a
    labeled radius is its upper limit.

    Raises:
        ConfigError: Markers cover the contact.
    """
    slopes, circle = map_slopes(slope_map, press.change), press.contact
    inside = press.known & (ball.distance(press.shape, circle) < _CENTER_RADIUS)
    rows, columns = np.nonzero(inside)
    if len(rows) < 20:
        raise ConfigError(
            f"{press.name}: fewer than 20 pixels of the contact are not markers; leave it out."
        )
    measured = slopes[inside]

    def misfit(center: np.ndarray) -> float:
        error = measured - ball.slopes_at(ball.offsets_at(columns, rows, center))
        return float(np.minimum((error**2).sum(axis=1), _MAX_SQUARED_ERROR).mean())

    start = np.array(circle.center_px)
    simplex = start + np.array([(0.0, 0.0), (2.0, 0.0), (0.0, 2.0)])
    x, y = minimize(
        misfit, start, method="Nelder-Mead",
        options={"xatol": 0.05, "fatol": 1e-6, "initial_simplex": simplex},
    ).x  # fmt: skip
    width = ball.mm_per_px[0]
    outward, seen = _outward_slopes(slopes, press, ball, Circle((x, y), circle.radius_px))
    profile = fit_profile(outward, seen, ball, circle.radius_px * width)
    return _with_contact(press, (x, y), profile.contact_mm / width)


def _with_contact(press: BallPress, center: tuple[float, float], radius_px: float) -> BallPress:
    """Return a press with this contact, which is at most as large as a labeled one."""
    largest = press.circle.radius_px if press.labeled else np.inf
    return replace(press, fitted=Circle(center, max(2.0, min(radius_px, largest))))


def fit_new_contact(press: BallPress, slope_map: SlopeMap, ball: Ball) -> BallPress:
    """Fit the contact of a left-out press in passes, each from the contact of the one before."""
    press = _with_steepest_contact(press, ball)
    for _ in range(_PASSES):
        press = fit_contact(press, slope_map, ball)
    return press


def _outward_slopes(
    slopes: np.ndarray, press: BallPress, ball: Ball, circle: Circle
) -> tuple[np.ndarray, np.ndarray]:
    """Slopes away from a center, and distances from it in mm: NaN below markers."""
    x, y = ball.offsets(press.shape, circle)
    distance = np.hypot(x, y)
    outward = (slopes[..., 0] * x + slopes[..., 1] * y) / np.maximum(distance, 1e-9)
    return outward, np.where(press.known, distance, np.nan)


def _resolved_radius(press: BallPress, slope_map: SlopeMap, ball: Ball) -> float:
    """Radius up to which the map follows the slopes of the ball, pixels.

    Colors of steep slopes may not differ any more, which would make others inconsistent.
    """
    slopes, circle = map_slopes(slope_map, press.change), press.contact
    outward, seen = _outward_slopes(slopes, press, ball, circle)
    width = ball.mm_per_px[0]
    contact = circle.radius_px * width
    radii, means, numbers = radial_means(outward, seen, width, contact)
    expected = ball.slopes_at(np.stack([radii, np.zeros_like(radii)]))[:, 0]
    below = (means < _RESOLVED * expected) & (numbers > 0) & (radii > _MIN_RESOLVED * contact)
    return float(radii[int(below.argmax())] / width) if below.any() else circle.radius_px


def _mark_outlying(
    presses: Sequence[BallPress], slope_map: SlopeMap, ball: Ball
) -> list[BallPress]:
    """Mark presses whose slopes are far from the ball's at their contacts."""
    errors = np.array([_slope_error(press, slope_map, ball) for press in presses])
    limit = max(_OUTLYING * float(np.median(errors)), _MIN_OUTLYING)
    return [
        replace(press, outlying=bool(error > limit))
        for press, error in zip(presses, errors, strict=True)
    ]


def _slope_error(press: BallPress, slope_map: SlopeMap, ball: Ball) -> float:
    """Root mean square error of the slopes inside a contact."""
    inside = press.known & (ball.distance(press.shape, press.contact) < EVALUATED_RADIUS)
    error = map_slopes(slope_map, press.change) - ball.slopes(press.shape, press.contact)
    return float(np.sqrt((error[inside] ** 2).sum(axis=-1).mean())) if inside.any() else np.inf


def _fit_map_to_contacts(
    slope_map: SlopeMap,
    presses: Sequence[BallPress],
    found_by: SlopeMap | None,
    ball: Ball,
    seed: int,
) -> None:
    """Fit the map to the ball's slopes inside contacts that agree, and to zero where it is flat.

    Of a contact, only the pixels are used at which the map `found_by` follows the ball.
    """
    rng = np.random.default_rng(seed)
    features, slopes = [], []
    for press in presses:
        if press.outlying:
            continue
        circle = press.contact
        ball.check(circle, press.name)
        radius = _TRAINING_RADIUS * circle.radius_px
        if found_by is not None:
            radius = min(radius, _resolved_radius(press, found_by, ball))
        rows = pixel_features(press.change)
        distance = np.where(press.known, ball.distance(press.shape, circle), np.nan).ravel()
        inside = draw(rng, np.flatnonzero(distance * circle.radius_px < radius), _PIXELS)
        if not len(inside):
            raise ConfigError(f"{press.name}: markers cover the whole contact; leave it out.")
        flat = draw(rng, np.flatnonzero(distance > FLAT_RADIUS), _FLAT_PIXELS)
        features += [rows[inside], rows[flat]]
        slopes += [
            ball.slopes(press.shape, circle).reshape(-1, 2)[inside], np.zeros((len(flat), 2))
        ]  # fmt: skip
    slope_map.fit(np.concatenate(features), np.concatenate(slopes), seed)
