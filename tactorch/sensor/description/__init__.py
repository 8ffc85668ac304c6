"""Sensor descriptions and their YAML files."""

from tactorch.sensor.description.checks import pixel_size
from tactorch.sensor.description.files import SENSORS, load_sensor, save_sensor
from tactorch.sensor.description.sensor import GelLayer, MarkerGrid, SensorDescription

__all__ = [
    "SENSORS",
    "GelLayer",
    "MarkerGrid",
    "SensorDescription",
    "load_sensor",
    "pixel_size",
    "save_sensor",
]
