"""Synthetic elastography datasets: a recipe makes any number of samples, in parallel."""

from tactorch.generation.generate import generate
from tactorch.generation.layout import SampleMaps
from tactorch.generation.plans import PressDraw
from tactorch.generation.recipe import MeshSizes, Recipe
from tactorch.generation.sample import Sample, make_sample
from tactorch.generation.sampleset import SampleSet

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
