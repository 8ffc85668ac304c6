"""Fields of Young's modulus: per element, or inclusions of several families in a background."""

from tactorch.inverse.fields.background import Background
from tactorch.inverse.fields.ball import BALL
from tactorch.inverse.fields.base import ElementField, FieldPoint, ModulusField, Vector
from tactorch.inverse.fields.ellipsoid import ELLIPSOID
from tactorch.inverse.fields.family import FAMILIES, Family
from tactorch.inverse.fields.inclusion import CENTER, SIZE, Candidate, Cloud, InclusionShape
from tactorch.inverse.fields.prior import ShapePrior
from tactorch.inverse.fields.shapes import ShapeField
from tactorch.inverse.fields.sites import Sites

__all__ = [
    "BALL",
    "CENTER",
    "ELLIPSOID",
    "FAMILIES",
    "SIZE",
    "Background",
    "Candidate",
    "Cloud",
    "ElementField",
    "Family",
    "FieldPoint",
    "InclusionShape",
    "ModulusField",
    "ShapeField",
    "ShapePrior",
    "Sites",
    "Vector",
]
