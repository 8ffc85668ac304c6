"""Quasi-static finite elements of soft bodies, differentiable. Units: mm, N, MPa, tonne/mm^3."""

from tactorch.fem.body import SoftBody
from tactorch.fem.elements import ELEMENTS, Discretisation, Element, make_element
from tactorch.fem.linearization import Linearization
from tactorch.fem.materials import MATERIALS, make_material
from tactorch.fem.newton import EquilibriumResult, Newton, NewtonOptions
from tactorch.fem.parallel import limit_workers, map_cases, worker_count
from tactorch.fem.supports import Supports

__all__ = [
    "ELEMENTS",
    "MATERIALS",
    "Discretisation",
    "Element",
    "EquilibriumResult",
    "Linearization",
    "Newton",
    "NewtonOptions",
    "SoftBody",
    "Supports",
    "limit_workers",
    "make_element",
    "make_material",
    "map_cases",
    "worker_count",
]
