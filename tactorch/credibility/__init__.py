"""How far a map of Young's modulus can be believed.

- `sensitivity_matrix`, `credibility`: which elements do the observed displacements feel at all?
- `layer_profile`: how does that fall with depth?
- `LaplacePosterior`: given data, noise and prior, how uncertain is each modulus?
- `coverage`, `calibration_curve`: over objects of known truth, do the stated deviations hold?
"""

from tactorch.credibility.coverage import (
    Coverage,
    calibration_curve,
    calibration_error,
    coverage,
)
from tactorch.credibility.posterior import LaplacePosterior
from tactorch.credibility.sensitivity import (
    Credibility,
    credibility,
    layer_profile,
    sensitivity_matrix,
)

__all__ = [
    "Coverage",
    "Credibility",
    "LaplacePosterior",
    "calibration_curve",
    "calibration_error",
    "coverage",
    "credibility",
    "layer_profile",
    "sensitivity_matrix",
]
