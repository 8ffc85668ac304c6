"""Calibration of lens and warp by the grid of markers, of known pitch, in one raw image.

Distortion and warp are fitted by gradients through the lens model, so that the markers are at their
places in the rectified image. Its pixels then have the stated size: the grid determines the scale.
"""

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial import cKDTree
from torch import Tensor

from tactorch.errors import ConfigError
from tactorch.sensor.camera.lens import Lens
from tactorch.sensor.camera.optimize import fit_parameters
from tactorch.sensor.description import SensorDescription

_COEFFICIENTS = 4  # k1, k2, p1, p2
_ROUNDS = 3  # of matching and fitting
_REACH = 0.45  # of a match, over the pitch
_MIN_MARKERS = 16
_OUTLIER_PX = 0.5  # residual that counts linearly from here
_RIDGE = 1e-6
_SCALES = {"distortion": 0.1, "corners": 10.0}  # typical changes, the latter in px
_ITERATIONS = 200
_FOLDS = 4

Points = Float[np.ndarray, "n 2"]


@dataclass(frozen=True)
class LensFit:
    """Fitted lens.

    Attributes:
        sensor: Description with the fitted `distortion` and `warp_corners_px`.
        markers: Number of markers.
        start_px: Root mean square distance of the markers from their places at the start, px.
        rms_px: That of the fit, px.
        held_out_px: That of markers left out of the fit, each once in four groups, px.
    """

    sensor: SensorDescription
    markers: int
    start_px: float
    rms_px: float
    held_out_px: float


def fit_lens(sensor: SensorDescription, markers_px: Points) -> LensFit:
    """Fit lens distortion and warp to the markers of a raw image of the gel without contact.

    Args:
        sensor: Description with a grid of markers. Without `intrinsics_px`, a focal length of the
            image's longer side is assumed, which the coefficients are relative to; without
            `warp_corners_px`, the warp starts from the whole image.
        markers_px: Centers of the markers in the raw image (column, row), see `detect_markers`.

    Raises:
        ConfigError: The sensor has no markers, or fewer than 16 are near their places.
    """
    if sensor.markers is None:
        raise ConfigError(f"sensor '{sensor.name}' has no markers to fit its lens to.")
    start, markers_px = _with_lens(sensor), np.ascontiguousarray(markers_px)
    places_px = sensor.to_px(sensor.markers.positions_mm)
    pitch_px = min(np.array(sensor.markers.pitch_mm) / np.array(sensor.mm_per_px))
    fitted, start_px = start, float("nan")
    for number in range(_ROUNDS):
        grid, seen = _match(fitted, places_px, markers_px, _REACH * pitch_px)
        if number == 0:
            start_px = _rms(start, grid, seen)
        fitted = _fit(start, grid, seen)
    return LensFit(fitted, len(seen), start_px, _rms(fitted, grid, seen), _cross(start, grid, seen))


def _with_lens(sensor: SensorDescription) -> SensorDescription:
    """Return a sensor with intrinsics, distortion and warp, which change nothing if added."""
    width, height = sensor.raw_size_px or sensor.image_size_px
    focal = float(max(width, height))
    intrinsics = sensor.intrinsics_px or (focal, focal, (width - 1) / 2, (height - 1) / 2)
    padding = (0.0,) * max(0, _COEFFICIENTS - len(sensor.distortion))
    whole = ((0.0, 0.0), (width - 1.0, 0.0), (width - 1.0, height - 1.0), (0.0, height - 1.0))
    return replace(
        sensor,
        intrinsics_px=intrinsics,
        distortion=sensor.distortion + padding,
        warp_corners_px=sensor.warp_corners_px or whole,
        warped_size_px=sensor.warped_size,
    )


def _match(
    sensor: SensorDescription,
    places_px: Float[np.ndarray, "places 2"],
    markers_px: Float[np.ndarray, "markers 2"],
    reach_px: float,
) -> tuple[Points, Points]:
    """Places in the rectified image and markers in the raw one that belong together."""
    with torch.no_grad():
        rectified = Lens(sensor).rectified_positions(torch.from_numpy(markers_px)).numpy()
    distance, nearest = cKDTree(rectified).query(places_px)
    back = cKDTree(places_px).query(rectified)[1]
    matched = (distance < reach_px) & (back[nearest] == np.arange(len(places_px)))
    if matched.sum() < _MIN_MARKERS:
        raise ConfigError(
            f"{int(matched.sum())} of {len(places_px)} markers are near their places, and"
            f" {_MIN_MARKERS} are needed to fit the lens; correct mm_per_px, pitch_mm or"
            " warp_corners_px, by which they are found."
        )
    return places_px[matched], markers_px[nearest[matched]]


def _fit(sensor: SensorDescription, grid: Points, seen: Points) -> SensorDescription:
    lens, places, markers = Lens(sensor), torch.from_numpy(grid), torch.from_numpy(seen)

    def loss() -> Tensor:
        squares = (lens.raw_positions(places) - markers).square().sum(dim=1) / _OUTLIER_PX**2
        return (torch.sqrt(1.0 + squares) - 1.0).mean()

    fit_parameters(lens, loss, _SCALES, _ITERATIONS, _RIDGE)
    assert lens.corners is not None
    a, b, c, d = ((x, y) for x, y in lens.corners.tolist())
    distortion = tuple(lens.distortion.tolist())
    return replace(sensor, distortion=distortion, warp_corners_px=(a, b, c, d))


def _rms(sensor: SensorDescription, grid: Points, seen: Points) -> float:
    with torch.no_grad():
        predicted = Lens(sensor).raw_positions(torch.from_numpy(grid)).numpy()
    return float(np.sqrt(((predicted - seen) ** 2).sum(axis=1).mean()))


def _cross(start: SensorDescription, grid: Points, seen: Points) -> float:
    """Root mean square distance of markers that are left out of the fit."""
    order, squares = np.random.default_rng(0).permutation(len(grid)), 0.0
    for fold in range(_FOLDS):
        out = np.zeros(len(grid), dtype=bool)
        out[order[fold::_FOLDS]] = True
        fitted = _fit(start, grid[~out], seen[~out])
        squares += _rms(fitted, grid[out], seen[out]) ** 2 * out.sum()
    return float(np.sqrt(squares / len(grid)))
