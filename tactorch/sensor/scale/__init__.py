"""Size of a pixel, from an object of known size that is pressed into the gel."""

from tactorch.sensor.scale.find import find_outline
from tactorch.sensor.scale.fit import PixelScale, Warp, fit_warp, measure_pixel_scale
from tactorch.sensor.scale.shape import KnownShape, Outline, cuboid, hexagon, read_corners

__all__ = [
    "KnownShape",
    "Outline",
    "PixelScale",
    "Warp",
    "cuboid",
    "find_outline",
    "fit_warp",
    "hexagon",
    "measure_pixel_scale",
    "read_corners",
]
