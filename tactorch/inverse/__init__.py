"""From presses to a map of Young's modulus: data, prior and optimizer, combined freely."""

from tactorch.inverse.coarse import CoarseStart
from tactorch.inverse.data import (
    CorrelatedNoise,
    DataModel,
    NoiseModel,
    Observation,
    smooth_pattern,
)
from tactorch.inverse.evaluation import Evaluation
from tactorch.inverse.incremental import IncrementalInversion, IncrementalResult
from tactorch.inverse.invert import (
    invert,
    make_objective,
    solution,
)
from tactorch.inverse.misfit import MISFITS, Misfit
from tactorch.inverse.model_error import (
    ModelError,
    discretisation_error,
)
from tactorch.inverse.monitor import Monitor, StopOptimization, StopReason
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
    "DataModel",
    "Evaluation",
    "GaussNewton",
    "Identity",
    "IncrementalInversion",
    "IncrementalResult",
    "InverseProblem",
    "Log",
    "LogJumps",
    "Matern",
    "Misfit",
    "ModelError",
    "Monitor",
    "NewtonCG",
    "NoPrior",
    "NoiseModel",
    "Nuisance",
    "NuisanceEstimate",
    "NuisancePrior",
    "Objective",
    "Observation",
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
    "StopReason",
    "Tikhonov",
    "TotalVariation",
    "Uniform",
    "UniformFit",
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
