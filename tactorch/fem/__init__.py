"""Quasi-static finite elements of soft bodies, differentiable. Units: mm, N, MPa, tonne/mm^3."""

from tactorch.fem.body import SoftBody
from tactorch.fem.boundary import STANDARD_GRAVITY, Supports
from tactorch.fem.elements import ELEMENTS, Discretisation, Element
from tactorch.fem.indentation import BallForces, BallPlace, Indentation, IndentedBody
from tactorch.fem.linearization import Linearization, Sensitivity
from tactorch.fem.materials import MATERIALS, Material, make_material
from tactorch.fem.newton import EquilibriumResult, Newton, NewtonOptions

__all__ = [
    "ELEMENTS",
    "MATERIALS",
    "STANDARD_GRAVITY",
    "BallForces",
    "BallPlace",
    "Discretisation",
    "Element",
    "EquilibriumResult",
    "Indentation",
    "IndentedBody",
    "Linearization",
    "Material",
    "Newton",
    "NewtonOptions",
    "Sensitivity",
    "SoftBody",
    "Supports",
    "make_material",
]
