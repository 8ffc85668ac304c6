"""Calibration of a sensor: colors by presses of a ball (Section VI-B), gel by known loads."""

from tactorch.sensor.calibration.ball import Ball, BallPress, Circle, find_circle, read_labels
from tactorch.sensor.calibration.fit import FitOptions, fit_map
from tactorch.sensor.calibration.maps import (
    SENSOR_MAPS,
    SensorMap,
    SlopeMap,
    image_change,
    marker_pixels,
)
from tactorch.sensor.calibration.modulus import GelModulus, KnownLoad, calibrate_modulus
from tactorch.sensor.calibration.quality import (
    MapQuality,
    cross_validate,
    evaluate_map,
    select_map,
)
from tactorch.sensor.calibration.storage import Calibration, load_calibration, save_calibration

__all__ = [
    "SENSOR_MAPS",
    "Ball",
    "BallPress",
    "Calibration",
    "Circle",
    "FitOptions",
    "GelModulus",
    "KnownLoad",
    "MapQuality",
    "SensorMap",
    "SlopeMap",
    "calibrate_modulus",
    "cross_validate",
    "evaluate_map",
    "find_circle",
    "fit_map",
    "image_change",
    "load_calibration",
    "marker_pixels",
    "read_labels",
    "save_calibration",
    "select_map",
]
