"""Priors on the map of Young's modulus."""

from tactorch.config import Registry
from tactorch.inverse.regularization.base import NoPrior, Prior, Quadratic, Regularizer
from tactorch.inverse.regularization.combined import Composite, CompositePenalty, ShiftedPrior
from tactorch.inverse.regularization.jumps import LogJumps, Smoothness, TotalVariation
from tactorch.inverse.regularization.levels import BinaryWell, Sparsity, Tikhonov
from tactorch.inverse.regularization.matern import Matern

_HERE = "tactorch.inverse.regularization"
#: Settings of the priors by name.
PRIORS = Registry(
    "regularization",
    {
        "none": f"{_HERE}.base:NoPrior",
        "smoothness": f"{_HERE}.jumps:Smoothness",
        "total_variation": f"{_HERE}.jumps:TotalVariation",
        "log_jumps": f"{_HERE}.jumps:LogJumps",
        "tikhonov": f"{_HERE}.levels:Tikhonov",
        "sparsity": f"{_HERE}.levels:Sparsity",
        "binary_well": f"{_HERE}.levels:BinaryWell",
        "matern": f"{_HERE}.matern:Matern",
        "composite": f"{_HERE}.combined:Composite",
    },
    "priors on the map",
)

__all__ = [
    "PRIORS",
    "BinaryWell",
    "Composite",
    "CompositePenalty",
    "LogJumps",
    "Matern",
    "NoPrior",
    "Prior",
    "Quadratic",
    "Regularizer",
    "ShiftedPrior",
    "Smoothness",
    "Sparsity",
    "Tikhonov",
    "TotalVariation",
]
