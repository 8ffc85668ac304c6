"""From presses to a map of Young's modulus: data, prior and optimizer, combined freely."""

from tactorch.inverse.data.misfit import MISFITS, Misfit
from tactorch.inverse.data.nuisance import Nuisance, NuisanceEstimate, NuisancePrior
from tactorch.inverse.data.observations import NoiseModel
from tactorch.inverse.fields.parameterization import (
    PARAMETERIZATIONS,
    Bounds,
    Identity,
    Log,
    Parameterization,
    Scaled,
)
from tactorch.inverse.fields.regularization.base import (
    PRIORS,
    NoPrior,
    Prior,
    Quadratic,
    Regularizer,
)
from tactorch.inverse.fields.regularization.combined import (
    Composite,
    CompositePenalty,
    ShiftedPrior,
)
from tactorch.inverse.fields.regularization.gaussian import Matern, Smoothness, Tikhonov
from tactorch.inverse.fields.regularization.sharp import (
    BinaryWell,
    LogJumps,
    Sparsity,
    TotalVariation,
)
from tactorch.inverse.fit.monitor import Monitor, StopReason
from tactorch.inverse.fit.objective import Objective, Point
from tactorch.inverse.fit.optimizers.base import OPTIMIZERS, Optimizer
from tactorch.inverse.fit.optimizers.gauss_newton import GaussNewton
from tactorch.inverse.fit.optimizers.newton_cg import NewtonCG
from tactorch.inverse.fit.optimizers.scipy_methods import LBFGS, TNC
from tactorch.inverse.fit.settings import Settings, settings_from
from tactorch.inverse.fit.starts import (
    INITIALIZATIONS,
    Start,
    best_uniform,
    homogeneous,
    monte_carlo,
)
from tactorch.inverse.forward.palpation import PalpationProblem, is_palpation
from tactorch.inverse.forward.problem import Evaluation, InverseProblem
from tactorch.inverse.incremental import IncrementalInversion, IncrementalResult
from tactorch.inverse.invert import compute_posterior, invert, invert_map, make_objective
from tactorch.inverse.result import Lump, Reconstruction, Status, find_lump, find_lumps
from tactorch.inverse.result.shapes import ShapeInclusion, ShapeReconstruction
from tactorch.inverse.search import PhysicsImage, find_shapes, physics_image
from tactorch.inverse.shape_samples import ShapeIntervals, ShapeSamples, sample_shapes

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
    "PhysicsImage",
    "Point",
    "Prior",
    "Quadratic",
    "Reconstruction",
    "Regularizer",
    "Scaled",
    "Settings",
    "ShapeInclusion",
    "ShapeIntervals",
    "ShapeReconstruction",
    "ShapeSamples",
    "ShiftedPrior",
    "Smoothness",
    "Sparsity",
    "Start",
    "Status",
    "StopReason",
    "Tikhonov",
    "TotalVariation",
    "best_uniform",
    "compute_posterior",
    "find_lump",
    "find_lumps",
    "find_shapes",
    "homogeneous",
    "invert",
    "invert_map",
    "is_palpation",
    "make_objective",
    "monte_carlo",
    "physics_image",
    "sample_shapes",
    "settings_from",
]
