"""Differentiable camera of a tactile sensor (torch and kornia): light, lens, warp and markers."""

from tactorch.sensor.camera.gel_camera import GelCamera, face_slopes
from tactorch.sensor.camera.height import HeightFitOptions, fit_height
from tactorch.sensor.camera.lens import Lens
from tactorch.sensor.camera.lens_fit import LensFit, fit_lens
from tactorch.sensor.camera.light_fit import LightFit, fit_light
from tactorch.sensor.camera.shading import Shading, normals

__all__ = [
    "GelCamera",
    "HeightFitOptions",
    "Lens",
    "LensFit",
    "LightFit",
    "Shading",
    "face_slopes",
    "fit_height",
    "fit_lens",
    "fit_light",
    "normals",
]
