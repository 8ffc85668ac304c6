"""Calibration of a sensor's colors with presses of a ball (Section VI-B)."""

from tactorch.sensor.calibration.ball import Ball, BallPress, Circle, find_circle, read_labels
from tactorch.sensor.calibration.fit import (
    FitOptions,
    MapQuality,
    cross_validate,
    evaluate_map,
    fit_map,
    select_map,
)
from tactorch.sensor.calibration.maps import (
    SENSOR_MAPS,
    SensorMap,
    SlopeMap,
    image_change,
    marker_pixels,
)
from tactorch.sensor.calibration.storage import Calibration, load_calibration, save_calibration

__all__ = [
    "SENSOR_MAPS",
    "Ball",
    "BallPress",
    "Calibration",
    "Circle",
    "FitOptions",
    "MapQuality",
    "SensorMap",
    "SlopeMap",
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
