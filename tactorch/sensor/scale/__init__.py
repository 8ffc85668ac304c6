"""The size of a pixel, from an object of known size that is pressed into the gel."""

from tactorch.sensor.scale.find import find_outline
from tactorch.sensor.scale.pixel_scale import PixelScale, pixel_scale
from tactorch.sensor.scale.shape import KnownShape, Outline, cuboid, hexagon, read_corners
from tactorch.sensor.scale.warp import Warp, warp_of

__all__ = [
    "KnownShape",
    "Outline",
    "PixelScale",
    "Warp",
    "cuboid",
    "find_outline",
    "hexagon",
    "pixel_scale",
    "read_corners",
    "warp_of",
]
