"""Inclusions as shapes with sharp boundaries: a map of few parameters and its posterior."""

from tactorch.inverse.shapes.field import Ellipsoid
from tactorch.inverse.shapes.fit import ShapeFit
from tactorch.inverse.shapes.search import ShapeSearch, find_shapes

__all__ = ["Ellipsoid", "ShapeFit", "ShapeSearch", "find_shapes"]
