"""Inclusions as shapes with sharp boundaries: a map of few parameters and its posterior."""

from tactorch.inverse.errors.kept import KeptRims
from tactorch.inverse.fields import InclusionShape
from tactorch.inverse.shapes.result import Interval, ShapeInclusion, ShapeReconstruction, ShapeState
from tactorch.inverse.shapes.search import find_shapes

__all__ = [
    "InclusionShape",
    "Interval",
    "KeptRims",
    "ShapeInclusion",
    "ShapeReconstruction",
    "ShapeState",
    "find_shapes",
]
