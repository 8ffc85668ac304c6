"""The soft layer: its mesh, the contact forces behind its deformation, its modulus."""

from tactorch.sensor.gel.contact import Contact
from tactorch.sensor.gel.mesh import GelMesh, gel_mesh
from tactorch.sensor.gel.model import GelModel
from tactorch.sensor.gel.modulus import GelModulus, KnownLoad, calibrate_modulus

__all__ = [
    "Contact",
    "GelMesh",
    "GelModel",
    "GelModulus",
    "KnownLoad",
    "calibrate_modulus",
    "gel_mesh",
]
