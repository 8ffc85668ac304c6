"""Mechanics of the gel: contact forces from its deformation, and its Young's modulus."""

from tactorch.sensor.gel.model import GelContact, GelModel, GelOptions
from tactorch.sensor.gel.modulus import GelModulus, KnownLoad, calibrate_modulus

__all__ = ["GelContact", "GelModel", "GelModulus", "GelOptions", "KnownLoad", "calibrate_modulus"]
