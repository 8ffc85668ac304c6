"""Simulated presses on a phantom, as a recording. Units: mm, N, MPa, tonne/mm^3."""

from tactorch.simulate.noise import add_noise, noise_level
from tactorch.simulate.pipeline import simulate
from tactorch.simulate.plan import HOLDS, PressPlan, Series
from tactorch.simulate.transfer import Transfer

__all__ = ["HOLDS", "PressPlan", "Series", "Transfer", "add_noise", "noise_level", "simulate"]
