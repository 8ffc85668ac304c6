"""Optimizers of an inversion."""

from tactorch.config import Registry

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
