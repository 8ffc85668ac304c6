"""How far a map of Young's modulus can be believed.

- `sensitivity_matrix`, `credibility`: which elements do the observed displacements feel at all?
- `layer_profile`: how does that fall with depth?
- `posterior_of`: how far each modulus of a reconstruction can be trusted, by one of these:
- `LaplacePosterior`: given data, noise and prior, how uncertain is each modulus? With
  `LowRankPosterior` for large meshes.
- `variational_posterior`: the same under total variation, whose own scales are uncertain too: the
  one whose intervals hold.
- `coverage`, `calibration_curve`: over objects of known truth, do the stated deviations hold?
- `Belief`: the update by a press (eq. 16 and 17), and what a press is expected to tell.
- `candidate_patches`: where a sensor can press. `Presser`, `SimulatedPresser`: who presses.
- `sample`: active sampling, the next place chosen by a `Rule`: `LargestUncertainty` (the paper's),
  `ExpectedInformation` and `ExpectedError` (ours), `UniformGrid`, `Random`.
"""

from tactorch.credibility.active import Step, sample
from tactorch.credibility.belief import Belief
from tactorch.credibility.candidates import Patch, candidate_patches
from tactorch.credibility.coverage import (
    Coverage,
    calibration_curve,
    calibration_error,
    coverage,
)
from tactorch.credibility.gaussian import GaussianPosterior
from tactorch.credibility.low_rank import LowRankPosterior
from tactorch.credibility.posterior import LaplacePosterior
from tactorch.credibility.presser import Presser, SimulatedPresser
from tactorch.credibility.rules import (
    ExpectedError,
    ExpectedInformation,
    LargestUncertainty,
    Random,
    Rule,
    Situation,
    UniformGrid,
)
from tactorch.credibility.sensitivity import (
    Credibility,
    credibility,
    layer_profile,
    sensitivity_matrix,
)
from tactorch.credibility.trust import posterior_of
from tactorch.credibility.variational import VariationalPosterior, variational_posterior

__all__ = [
    "Belief",
    "Coverage",
    "Credibility",
    "ExpectedError",
    "ExpectedInformation",
    "GaussianPosterior",
    "LaplacePosterior",
    "LargestUncertainty",
    "LowRankPosterior",
    "Patch",
    "Presser",
    "Random",
    "Rule",
    "SimulatedPresser",
    "Situation",
    "Step",
    "UniformGrid",
    "VariationalPosterior",
    "calibration_curve",
    "calibration_error",
    "candidate_patches",
    "coverage",
    "credibility",
    "layer_profile",
    "posterior_of",
    "sample",
    "sensitivity_matrix",
    "variational_posterior",
]
