"""A simulated sensor, to test the chain from images to forces end to end."""

from tactorch.sensor.render.light import Lamps
from tactorch.sensor.render.renderer import Face, Look, face_of, render

__all__ = ["Face", "Lamps", "Look", "face_of", "render"]
