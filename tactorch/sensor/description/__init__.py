"""What a sensor is, and the files that say so."""

from tactorch.sensor.description.files import SENSORS, load_sensor, save_sensor
from tactorch.sensor.description.gel_layer import GelLayer
from tactorch.sensor.description.marker_grid import MarkerGrid
from tactorch.sensor.description.sensor import SensorDescription

__all__ = [
    "SENSORS",
    "GelLayer",
    "MarkerGrid",
    "SensorDescription",
    "load_sensor",
    "save_sensor",
]
