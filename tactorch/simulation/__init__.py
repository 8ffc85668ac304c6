"""Simulated presses on a phantom, as a recording. Units: mm, N, MPa, tonne/mm^3."""

from tactorch.simulation.misjudge import misjudged
from tactorch.simulation.noise import add_noise, noise_level
from tactorch.simulation.pipeline import simulate
from tactorch.simulation.plan import HOLDS, PressPlan, Series
from tactorch.simulation.transfer import Transfer

__all__ = [
    "HOLDS",
    "PressPlan",
    "Series",
    "Transfer",
    "add_noise",
    "misjudged",
    "noise_level",
    "simulate",
]
