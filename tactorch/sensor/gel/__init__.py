"""Contact forces on the gel of a sensor, from the displacement of its outer face."""

from tactorch.sensor.gel.face import EdgeDistance, GelFace
from tactorch.sensor.gel.face_data import FaceData
from tactorch.sensor.gel.force import ForceOptions, ForceSolver
from tactorch.sensor.gel.model import GelContact, GelErrors, GelMesh, GelModel, GelOptions
from tactorch.sensor.gel.refined import RefinedGel

__all__ = [
    "EdgeDistance",
    "FaceData",
    "ForceOptions",
    "ForceSolver",
    "GelContact",
    "GelErrors",
    "GelFace",
    "GelMesh",
    "GelModel",
    "GelOptions",
    "RefinedGel",
]
