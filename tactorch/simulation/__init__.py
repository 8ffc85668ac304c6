"""Simulation of presses on a phantom. Units: mm, N, MPa, tonne/mm^3."""

from tactorch.simulation.noise import add_noise, noise_level
from tactorch.simulation.perturbation import perturb_recording
from tactorch.simulation.pipeline import simulate
from tactorch.simulation.plan import PressPlan, PressSite
from tactorch.simulation.transfer import Transfer

__all__ = [
    "PressPlan",
    "PressSite",
    "Transfer",
    "add_noise",
    "noise_level",
    "perturb_recording",
    "simulate",
]
