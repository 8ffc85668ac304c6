"""Mechanics of the gel: mesh, contact forces from its deformation, and its Young's modulus."""

from tactorch.sensor.gel.mesh import GelMesh, build_gel_mesh
from tactorch.sensor.gel.model import GelContact, GelModel, GelOptions
from tactorch.sensor.gel.modulus import GelModulus, KnownLoad, calibrate_modulus

__all__ = [
    "GelContact",
    "GelMesh",
    "GelModel",
    "GelModulus",
    "GelOptions",
    "KnownLoad",
    "build_gel_mesh",
    "calibrate_modulus",
]
