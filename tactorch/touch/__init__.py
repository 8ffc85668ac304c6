"""Simulated touch: a tactile sensor pressed on a soft body, with forces, markers and images."""

from tactorch.touch.options import TouchOptions
from tactorch.touch.scene import GelPress, TouchScene
from tactorch.touch.simulate import Touch, simulate_touch

__all__ = ["GelPress", "Touch", "TouchOptions", "TouchScene", "simulate_touch"]
