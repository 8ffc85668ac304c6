"""From presses to a map of Young's modulus: data, prior and optimizer, combined freely."""

from tactorch.inverse.coarse import CoarseStart
from tactorch.inverse.correlated_noise import CorrelatedNoise
from tactorch.inverse.evaluation import Evaluation
from tactorch.inverse.incremental import IncrementalInversion, IncrementalResult
from tactorch.inverse.invert import (
    INTERRUPTED,
    invert,
    make_objective,
    solution,
)
from tactorch.inverse.misfit import MISFITS
from tactorch.inverse.model_error import (
    ModelError,
    apply_model_error,
    discretisation_error,
    smooth_pattern,
)
from tactorch.inverse.monitor import Monitor, StopOptimization
from tactorch.inverse.noise import NoiseModel
from tactorch.inverse.nuisance import Nuisance, NuisancePrior
from tactorch.inverse.nuisance_estimate import NuisanceEstimate
from tactorch.inverse.objective import Objective, Point
from tactorch.inverse.optimizers import (
    LBFGS,
    OPTIMIZERS,
    TNC,
    GaussNewton,
    NewtonCG,
    Optimizer,
)
from tactorch.inverse.parameterization import (
    PARAMETERIZATIONS,
    Bounds,
    Identity,
    Log,
    Parameterization,
    Scaled,
)
from tactorch.inverse.problem import InverseProblem
from tactorch.inverse.reconstruction import Reconstruction
from tactorch.inverse.regularization import (
    PRIORS,
    BinaryWell,
    Composite,
    LogJumps,
    Matern,
    NoPrior,
    Prior,
    Quadratic,
    Regularizer,
    ShiftedPrior,
    Smoothness,
    Sparsity,
    Tikhonov,
    TotalVariation,
)
from tactorch.inverse.settings import Settings, has_all_settings, settings_from
from tactorch.inverse.starts import (
    INITIALIZATIONS,
    START_MPA,
    Start,
    Uniform,
    best_uniform,
    homogeneous,
    monte_carlo,
    start_map,
)
from tactorch.inverse.uniform import UniformFit, uniform_fit

__all__ = [
    "INITIALIZATIONS",
    "INTERRUPTED",
    "LBFGS",
    "MISFITS",
    "OPTIMIZERS",
    "PARAMETERIZATIONS",
    "PRIORS",
    "START_MPA",
    "TNC",
    "BinaryWell",
    "Bounds",
    "CoarseStart",
    "Composite",
    "CorrelatedNoise",
    "Evaluation",
    "GaussNewton",
    "Identity",
    "IncrementalInversion",
    "IncrementalResult",
    "InverseProblem",
    "Log",
    "LogJumps",
    "Matern",
    "ModelError",
    "Monitor",
    "NewtonCG",
    "NoPrior",
    "NoiseModel",
    "Nuisance",
    "NuisanceEstimate",
    "NuisancePrior",
    "Objective",
    "Optimizer",
    "Parameterization",
    "Point",
    "Prior",
    "Quadratic",
    "Reconstruction",
    "Regularizer",
    "Scaled",
    "Settings",
    "ShiftedPrior",
    "Smoothness",
    "Sparsity",
    "Start",
    "StopOptimization",
    "Tikhonov",
    "TotalVariation",
    "Uniform",
    "UniformFit",
    "apply_model_error",
    "best_uniform",
    "discretisation_error",
    "has_all_settings",
    "homogeneous",
    "invert",
    "make_objective",
    "monte_carlo",
    "settings_from",
    "smooth_pattern",
    "solution",
    "start_map",
    "uniform_fit",
]
