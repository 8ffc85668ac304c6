"""From presses to a map of Young's modulus: data, prior and optimizer, combined freely."""

from tactorch.inverse.coarse import CoarseStart
from tactorch.inverse.correlated_noise import CorrelatedNoise
from tactorch.inverse.evaluation import Evaluation
from tactorch.inverse.incremental import IncrementalInversion, IncrementalResult
from tactorch.inverse.invert import (
    INTERRUPTED,
    START_MPA,
    Settings,
    invert,
    make_objective,
    solution,
)
from tactorch.inverse.misfit import MISFITS
from tactorch.inverse.model_error import (
    MODEL_ERRORS,
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
    make_optimizer,
)
from tactorch.inverse.parameterization import (
    PARAMETERIZATIONS,
    Bounds,
    Parameterization,
    make_parameterization,
)
from tactorch.inverse.problem import InverseProblem
from tactorch.inverse.reconstruction import Reconstruction
from tactorch.inverse.regularization import (
    REGULARIZERS,
    PriorOptions,
    Regularizer,
    make_regularizer,
)
from tactorch.inverse.starts import Start, best_uniform, homogeneous, monte_carlo, start_map
from tactorch.inverse.uniform import UniformFit, uniform_fit

__all__ = [
    "INTERRUPTED",
    "LBFGS",
    "MISFITS",
    "MODEL_ERRORS",
    "OPTIMIZERS",
    "PARAMETERIZATIONS",
    "REGULARIZERS",
    "START_MPA",
    "TNC",
    "Bounds",
    "CoarseStart",
    "CorrelatedNoise",
    "Evaluation",
    "GaussNewton",
    "IncrementalInversion",
    "IncrementalResult",
    "InverseProblem",
    "ModelError",
    "Monitor",
    "NewtonCG",
    "NoiseModel",
    "Nuisance",
    "NuisanceEstimate",
    "NuisancePrior",
    "Objective",
    "Optimizer",
    "Parameterization",
    "Point",
    "PriorOptions",
    "Reconstruction",
    "Regularizer",
    "Settings",
    "Start",
    "StopOptimization",
    "UniformFit",
    "apply_model_error",
    "best_uniform",
    "discretisation_error",
    "homogeneous",
    "invert",
    "make_objective",
    "make_optimizer",
    "make_parameterization",
    "make_regularizer",
    "monte_carlo",
    "smooth_pattern",
    "solution",
    "start_map",
    "uniform_fit",
]
