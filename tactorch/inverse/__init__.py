"""From presses to a map of Young's modulus: data, prior and optimizer, combined freely."""

from tactorch.inverse.invert import START_MPA, Settings, invert, make_objective
from tactorch.inverse.monitor import Monitor, OutOfTime
from tactorch.inverse.noise import NoiseModel
from tactorch.inverse.objective import Objective, Point
from tactorch.inverse.optimizers import (
    LBFGS,
    OPTIMIZERS,
    TNC,
    GaussNewton,
    Optimizer,
    make_optimizer,
)
from tactorch.inverse.parameterization import (
    PARAMETERIZATIONS,
    Bounds,
    Parameterization,
    make_parameterization,
)
from tactorch.inverse.problem import Evaluation, InverseProblem
from tactorch.inverse.reconstruction import Reconstruction
from tactorch.inverse.regularization import REGULARIZERS, make_regularizer

__all__ = [
    "LBFGS",
    "OPTIMIZERS",
    "PARAMETERIZATIONS",
    "REGULARIZERS",
    "START_MPA",
    "TNC",
    "Bounds",
    "Evaluation",
    "GaussNewton",
    "InverseProblem",
    "Monitor",
    "NoiseModel",
    "Objective",
    "Optimizer",
    "OutOfTime",
    "Parameterization",
    "Point",
    "Reconstruction",
    "Settings",
    "invert",
    "make_objective",
    "make_optimizer",
    "make_parameterization",
    "make_regularizer",
]
