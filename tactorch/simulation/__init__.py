"""Simulation of presses on a phantom. Units: mm, N, MPa, tonne/mm^3."""

from tactorch.simulation.pipeline import noise_level, perturb_recording, simulate
from tactorch.simulation.plan import PressPlan

__all__ = ["PressPlan", "noise_level", "perturb_recording", "simulate"]
