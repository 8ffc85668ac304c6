"""Test objects: a body of one modulus with inclusions of others. Lengths in mm, moduli in MPa."""

from tactorch.phantoms.background import Background, Gradient, Layers, RandomField
from tactorch.phantoms.families import FAMILIES, Drawn, draw_phantom
from tactorch.phantoms.library import PHANTOMS, make_phantom
from tactorch.phantoms.phantom import HOLE_MPA, Inclusion, Phantom

__all__ = [
    "FAMILIES",
    "HOLE_MPA",
    "PHANTOMS",
    "Background",
    "Drawn",
    "Gradient",
    "Inclusion",
    "Layers",
    "Phantom",
    "RandomField",
    "draw_phantom",
    "make_phantom",
]
