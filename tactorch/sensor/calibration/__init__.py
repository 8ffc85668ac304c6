"""Calibration of a sensor's colors with presses of a ball (Section VI-B)."""

from tactorch.sensor.calibration.ball import Ball, BallPress, Circle, find_circle, read_labels
from tactorch.sensor.calibration.features import image_change, marker_pixels
from tactorch.sensor.calibration.fit import FitOptions, fit_circle, fit_map
from tactorch.sensor.calibration.maps import SENSOR_MAPS, SensorMap, SlopeMap, map_slopes
from tactorch.sensor.calibration.storage import Calibration, load_calibration, save_calibration
from tactorch.sensor.calibration.validation import (
    MapQuality,
    cross_validate,
    evaluate_map,
    fit_new_circle,
    pool_quality,
    select_map,
    validation_groups,
)

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
    "fit_circle",
    "fit_map",
    "fit_new_circle",
    "image_change",
    "load_calibration",
    "map_slopes",
    "marker_pixels",
    "pool_quality",
    "read_labels",
    "save_calibration",
    "select_map",
    "validation_groups",
]
