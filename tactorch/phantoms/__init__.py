"""Phantoms: bodies with inclusions of other Young's moduli. Lengths in mm, moduli in MPa."""

from tactorch.phantoms.background import Background, Gradient, Layers, RandomField
from tactorch.phantoms.draws import RandomPhantom
from tactorch.phantoms.families import FAMILIES, draw_phantom
from tactorch.phantoms.library import PHANTOMS, make_phantom
from tactorch.phantoms.phantom import HOLE_MPA, Inclusion, MeshSize, Phantom

__all__ = [
    "FAMILIES",
    "HOLE_MPA",
    "PHANTOMS",
    "Background",
    "Gradient",
    "Inclusion",
    "Layers",
    "MeshSize",
    "Phantom",
    "RandomField",
    "RandomPhantom",
    "draw_phantom",
    "make_phantom",
]
