"""Synthetic elastography datasets: a recipe makes any number of samples, in parallel."""

from tactorch.generation.generate import generate
from tactorch.generation.recipe import MeshSizes, PressDraw, Recipe
from tactorch.generation.sample import Sample, make_sample
from tactorch.generation.sampleset import SampleMaps, SampleSet

__all__ = [
    "MeshSizes",
    "PressDraw",
    "Recipe",
    "Sample",
    "SampleMaps",
    "SampleSet",
    "generate",
    "make_sample",
]
