"""Optimizers of an inversion."""

from tactorch.config import Registry
from tactorch.inverse.optimizers.base import Optimizer
from tactorch.inverse.optimizers.gauss_newton import GaussNewton
from tactorch.inverse.optimizers.newton_cg import NewtonCG
from tactorch.inverse.optimizers.scipy_methods import LBFGS, TNC

_HERE = "tactorch.inverse.optimizers"
#: Settings of the optimizers by name.
OPTIMIZERS = Registry(
    "optimizer",
    {
        "gauss_newton": f"{_HERE}.gauss_newton:GaussNewton",
        "newton_cg": f"{_HERE}.newton_cg:NewtonCG",
        "tnc": f"{_HERE}.scipy_methods:TNC",
        "lbfgs": f"{_HERE}.scipy_methods:LBFGS",
    },
    "optimizers",
)

__all__ = ["LBFGS", "OPTIMIZERS", "TNC", "GaussNewton", "NewtonCG", "Optimizer"]
