"""Test objects: a body of one modulus with inclusions of others. Lengths in mm, moduli in MPa."""

from tactorch.phantoms.library import PHANTOMS, make_phantom
from tactorch.phantoms.phantom import Inclusion, Phantom

__all__ = ["PHANTOMS", "Inclusion", "Phantom", "make_phantom"]
