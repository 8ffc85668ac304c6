"""From slopes of the gel's face to its depth."""

from tactorch.sensor.depth.fill import filled
from tactorch.sensor.depth.height import Height, height_of
from tactorch.sensor.depth.integrate import integrate

__all__ = ["Height", "filled", "height_of", "integrate"]
