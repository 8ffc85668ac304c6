"""Uncertainty of a map of Young's modulus: credibility, posteriors and their coverage.

`compute_posterior` chooses among `LaplacePosterior`, `LowRankPosterior` (large meshes) and
`variational_posterior` (total variation, with estimated scales). `sample_shapes` checks the
intervals of `find_shapes` by samples.
"""

from tactorch.inverse.posterior.gaussian import GaussianPosterior
from tactorch.uncertainty.coverage import Coverage, calibration_curve, calibration_error, coverage
from tactorch.uncertainty.gaussian_state import GaussianState
from tactorch.uncertainty.laplace import LaplacePosterior
from tactorch.uncertainty.low_rank import LowRankPosterior
from tactorch.uncertainty.select import compute_posterior
from tactorch.uncertainty.sensitivity import credibility, layer_profile, sensitivity_matrix
from tactorch.uncertainty.shapes import ShapeIntervals, ShapeSamples, sample_shapes
from tactorch.uncertainty.variational import VariationalPosterior, variational_posterior

__all__ = [
    "Coverage",
    "GaussianPosterior",
    "GaussianState",
    "LaplacePosterior",
    "LowRankPosterior",
    "ShapeIntervals",
    "ShapeSamples",
    "VariationalPosterior",
    "calibration_curve",
    "calibration_error",
    "compute_posterior",
    "coverage",
    "credibility",
    "layer_profile",
    "sample_shapes",
    "sensitivity_matrix",
    "variational_posterior",
]
