"""The soft layer: its mesh, and the contact forces behind its deformation."""

from tactorch.sensor.gel.mesh import GelMesh, gel_mesh
from tactorch.sensor.gel.model import Contact, GelModel

__all__ = ["Contact", "GelMesh", "GelModel", "gel_mesh"]
