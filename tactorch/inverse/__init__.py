"""From presses to a map of Young's modulus: data, prior and optimizer, combined freely."""

from tactorch.inverse.data import NoiseModel
from tactorch.inverse.incremental import IncrementalInversion, IncrementalResult
from tactorch.inverse.invert import invert, invert_map, make_objective
from tactorch.inverse.misfit import MISFITS, Misfit
from tactorch.inverse.monitor import Monitor, StopReason
from tactorch.inverse.nuisance import Nuisance, NuisanceEstimate, NuisancePrior
from tactorch.inverse.objective import Objective, Point
from tactorch.inverse.optimizers.base import OPTIMIZERS, Optimizer
from tactorch.inverse.optimizers.gauss_newton import GaussNewton
from tactorch.inverse.optimizers.newton_cg import NewtonCG
from tactorch.inverse.optimizers.scipy_methods import LBFGS, TNC
from tactorch.inverse.palpation import PalpationProblem, is_palpation
from tactorch.inverse.parameterization import (
    PARAMETERIZATIONS,
    Bounds,
    Identity,
    Log,
    Parameterization,
    Scaled,
)
from tactorch.inverse.problem import Evaluation, InverseProblem
from tactorch.inverse.regularization.base import PRIORS, NoPrior, Prior, Quadratic, Regularizer
from tactorch.inverse.regularization.combined import Composite, CompositePenalty, ShiftedPrior
from tactorch.inverse.regularization.gaussian import Matern, Smoothness, Tikhonov
from tactorch.inverse.regularization.sharp import BinaryWell, LogJumps, Sparsity, TotalVariation
from tactorch.inverse.result import Lump, Reconstruction, Status, find_lump, find_lumps
from tactorch.inverse.settings import Settings, settings_from
from tactorch.inverse.shapes import ShapeInclusion, ShapeReconstruction, find_shapes
from tactorch.inverse.starts import INITIALIZATIONS, Start, best_uniform, homogeneous, monte_carlo

__all__ = [
    "INITIALIZATIONS",
    "LBFGS",
    "MISFITS",
    "OPTIMIZERS",
    "PARAMETERIZATIONS",
    "PRIORS",
    "TNC",
    "BinaryWell",
    "Bounds",
    "Composite",
    "CompositePenalty",
    "Evaluation",
    "GaussNewton",
    "Identity",
    "IncrementalInversion",
    "IncrementalResult",
    "InverseProblem",
    "Log",
    "LogJumps",
    "Lump",
    "Matern",
    "Misfit",
    "Monitor",
    "NewtonCG",
    "NoPrior",
    "NoiseModel",
    "Nuisance",
    "NuisanceEstimate",
    "NuisancePrior",
    "Objective",
    "Optimizer",
    "PalpationProblem",
    "Parameterization",
    "Point",
    "Prior",
    "Quadratic",
    "Reconstruction",
    "Regularizer",
    "Scaled",
    "Settings",
    "ShapeInclusion",
    "ShapeReconstruction",
    "ShiftedPrior",
    "Smoothness",
    "Sparsity",
    "Start",
    "Status",
    "StopReason",
    "Tikhonov",
    "TotalVariation",
    "best_uniform",
    "find_lump",
    "find_lumps",
    "find_shapes",
    "homogeneous",
    "invert",
    "invert_map",
    "is_palpation",
    "make_objective",
    "monte_carlo",
    "settings_from",
]
