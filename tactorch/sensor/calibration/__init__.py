"""Calibration of a sensor: slopes of colours, the size of a pixel (Section VI-B)."""

from tactorch.sensor.calibration.ball import Ball, Circle, read_labels
from tactorch.sensor.calibration.change import change, hidden
from tactorch.sensor.calibration.choose import (
    choose_map,
    held_out_quality,
    left_out,
    new_circle,
    together,
)
from tactorch.sensor.calibration.find import find_circle
from tactorch.sensor.calibration.fit import FitOptions, Touch, fit_circle, fit_map, seen_slopes
from tactorch.sensor.calibration.maps import MAPS, SlopeMap, make_map
from tactorch.sensor.calibration.quality import Quality, judge
from tactorch.sensor.calibration.scale import PixelScale, pixel_scale
from tactorch.sensor.calibration.scale_find import find_outline
from tactorch.sensor.calibration.scale_shape import (
    KnownShape,
    Outline,
    cuboid,
    hexagon,
    read_corners,
)
from tactorch.sensor.calibration.scale_warp import Warp, warp_of
from tactorch.sensor.calibration.storage import Calibration, load_calibration, save_calibration

__all__ = [
    "MAPS",
    "Ball",
    "Calibration",
    "Circle",
    "FitOptions",
    "KnownShape",
    "Outline",
    "PixelScale",
    "Quality",
    "SlopeMap",
    "Touch",
    "Warp",
    "change",
    "choose_map",
    "cuboid",
    "find_circle",
    "find_outline",
    "fit_circle",
    "fit_map",
    "held_out_quality",
    "hexagon",
    "hidden",
    "judge",
    "left_out",
    "load_calibration",
    "make_map",
    "new_circle",
    "pixel_scale",
    "read_corners",
    "read_labels",
    "save_calibration",
    "seen_slopes",
    "together",
    "warp_of",
]
