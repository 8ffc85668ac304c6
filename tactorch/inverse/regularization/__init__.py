"""Priors on the map of Young's modulus."""

from tactorch.config import Registry

_HERE = "tactorch.inverse.regularization"
#: Settings of the priors by name.
PRIORS = Registry(
    "regularization",
    {
        "none": f"{_HERE}.base:NoPrior",
        "smoothness": f"{_HERE}.gaussian:Smoothness",
        "total_variation": f"{_HERE}.sharp:TotalVariation",
        "log_jumps": f"{_HERE}.sharp:LogJumps",
        "tikhonov": f"{_HERE}.gaussian:Tikhonov",
        "sparsity": f"{_HERE}.sharp:Sparsity",
        "binary_well": f"{_HERE}.binary_well:BinaryWell",
        "matern": f"{_HERE}.gaussian:Matern",
        "composite": f"{_HERE}.combined:Composite",
    },
    "priors on the map",
)
