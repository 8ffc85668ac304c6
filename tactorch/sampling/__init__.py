"""Active sampling: where to press next.

- `candidate_patches`: patches of the surface that a sensor can press.
- `Presser`, `SimulatedPresser`: robots, real or simulated.
- `Rule`: criterion for the next patch. `LargestUncertainty` is the paper's;
  `ExpectedInformation`, `ExpectedError`, `UniformGrid` and `Random` are alternatives.
- `sample`: loop of press, inversion and choice.
- `tactorch.sampling.live`: the same for a recording that grows while a robot presses.
"""

from tactorch.sampling.candidates import Patch, candidate_patches
from tactorch.sampling.loop import Step, sample
from tactorch.sampling.presser import Presser, SimulatedPresser
from tactorch.sampling.rules import (
    ExpectedError,
    ExpectedInformation,
    LargestUncertainty,
    Random,
    Rule,
    SamplingState,
    UniformGrid,
)

__all__ = [
    "ExpectedError",
    "ExpectedInformation",
    "LargestUncertainty",
    "Patch",
    "Presser",
    "Random",
    "Rule",
    "SamplingState",
    "SimulatedPresser",
    "Step",
    "UniformGrid",
    "candidate_patches",
    "sample",
]
