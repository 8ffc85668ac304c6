"""Uncertainty of a map of Young's modulus: credibility, posteriors and their coverage.

- `sensitivity_matrix`, `credibility`, `layer_profile`: which elements the observed displacements
  depend on, and how this decreases with depth (eq. 14 and 15).
- `compute_posterior`: posterior of a reconstruction, one of the following.
- `LaplacePosterior`: Gaussian approximation at the reconstruction; `LowRankPosterior` for large
  meshes.
- `variational_posterior`: Gaussian scale mixture for total variation, with estimated scales.
- `coverage`, `calibration_curve`: coverage of intervals over objects of known truth.
- `GaussianState`: Kalman update by a press (eq. 16 and 17).
"""

from tactorch.uncertainty.coverage import Coverage, calibration_curve, calibration_error, coverage
from tactorch.uncertainty.gaussian_state import GaussianState
from tactorch.uncertainty.laplace import GaussianPosterior, LaplacePosterior
from tactorch.uncertainty.low_rank import LowRankPosterior
from tactorch.uncertainty.select import compute_posterior
from tactorch.uncertainty.sensitivity import (
    Credibility,
    credibility,
    layer_profile,
    sensitivity_matrix,
)
from tactorch.uncertainty.variational import VariationalPosterior, variational_posterior

__all__ = [
    "Coverage",
    "Credibility",
    "GaussianPosterior",
    "GaussianState",
    "LaplacePosterior",
    "LowRankPosterior",
    "VariationalPosterior",
    "calibration_curve",
    "calibration_error",
    "compute_posterior",
    "coverage",
    "credibility",
    "layer_profile",
    "sensitivity_matrix",
    "variational_posterior",
]
