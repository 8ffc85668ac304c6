"""From slopes of the gel's face to its depth."""

from tactorch.sensor.depth.fill import filled
from tactorch.sensor.depth.height import STEEP, Height, height_of
from tactorch.sensor.depth.integrate import integrate
from tactorch.sensor.depth.photometric import Photometric

__all__ = ["STEEP", "Height", "Photometric", "filled", "height_of", "integrate"]
