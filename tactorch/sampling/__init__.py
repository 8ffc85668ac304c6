"""Active sampling: a loop of press, inversion and suggestion of the next press.

- `sample`: presses by a robot, real or simulated (`Presser`, `SimulatedPresser`), placed by a
  rule.
- `SamplingLoop`: the loop itself, over presses on request or over a recording that grows
  (`RecordingSource`).
- `candidate_patches`: patches of the surface that a sensor can press.
- `Rule`: criterion for the next press. `LargestUncertainty` is the paper's; `ExpectedError`,
  `ExpectedShapeError`, `LumpPosition`, `ExpectedInformation`, `UniformGrid` and `Random` are
  alternatives. The registry `RULES` lists them by name.
"""

from tactorch.sampling.candidates import candidate_patches
from tactorch.sampling.loop import LoopOptions, LoopResult, Observer, SamplingLoop, Update
from tactorch.sampling.rules import (
    RULES,
    ExpectedError,
    ExpectedInformation,
    LargestUncertainty,
    Random,
    Rule,
    SamplingState,
    UniformGrid,
)
from tactorch.sampling.sample import Presser, SimulatedPresser, Step, sample
from tactorch.sampling.shape_design import ExpectedShapeError, LumpPosition, ShapeDesign
from tactorch.sampling.sources import RecordingSource
from tactorch.sampling.suggest import Suggester, Suggestion, SuggestOptions
from tactorch.simulation.curved import Patch

__all__ = [
    "RULES",
    "ExpectedError",
    "ExpectedInformation",
    "ExpectedShapeError",
    "LargestUncertainty",
    "LoopOptions",
    "LoopResult",
    "LumpPosition",
    "Observer",
    "Patch",
    "Presser",
    "Random",
    "RecordingSource",
    "Rule",
    "SamplingLoop",
    "SamplingState",
    "ShapeDesign",
    "SimulatedPresser",
    "Step",
    "SuggestOptions",
    "Suggester",
    "Suggestion",
    "UniformGrid",
    "Update",
    "candidate_patches",
    "sample",
]
