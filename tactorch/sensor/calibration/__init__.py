"""Calibration of a sensor's colours with presses of a ball (Section VI-B)."""

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
from tactorch.sensor.calibration.storage import Calibration, load_calibration, save_calibration

__all__ = [
    "MAPS",
    "Ball",
    "Calibration",
    "Circle",
    "FitOptions",
    "Quality",
    "SlopeMap",
    "Touch",
    "change",
    "choose_map",
    "find_circle",
    "fit_circle",
    "fit_map",
    "held_out_quality",
    "hidden",
    "judge",
    "left_out",
    "load_calibration",
    "make_map",
    "new_circle",
    "read_labels",
    "save_calibration",
    "seen_slopes",
    "together",
]
