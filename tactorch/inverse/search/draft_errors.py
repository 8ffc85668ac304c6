"""Errors of the data of a draft search, which are computed once for each press."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float

from tactorch.inverse.data.observations import DataModel, Observation
from tactorch.inverse.errors import ErrorModel, ErrorSource, MeasuredPresses
from tactorch.inverse.errors.pose import RigidMotion
from tactorch.inverse.forward.problem import InverseProblem
from tactorch.recording import Press

_SCALE_DEVIATION = 0.01  # of the displacements of a press: errors of force and material
# What the correction leaves at a uniform cube, by a separate mesh and without noise: rigid motions
# of the contact of 0.1 to 0.25 % of its displacements, and 0.05 to 0.2 % beside them.
_RIGID_DEVIATION = 0.003
_MODEL_DEVIATION = 0.002
_REMAINING = 0.2  # part of the discretisation's error that remains after its correction


class Prediction(NamedTuple):
    """Displacements of nodes in a press on a uniform body.

    Attributes:
        better: By a finer mesh, in the way in which the measured ones were obtained, (n, 3), mm.
        present: By the mesh of the recording, with quadratic elements, (n, 3), mm.
        per_mm: Change where the press and what it measures are at another place, for each direction
            in which the reported position may be wrong, (axes, n, 3), mm per mm.
    """

    better: Float[np.ndarray, "n 3"]
    present: Float[np.ndarray, "n 3"]
    per_mm: Float[np.ndarray, "axes n 3"]


#: Prediction of a press at a uniform modulus (MPa); None where it is not known.
FinePrediction: TypeAlias = Callable[[Press, float], Prediction | None]


@dataclass(frozen=True)
class DraftOptions:
    """Errors that a draft search takes into account beside the noise.

    Attributes:
        pose_deviation_mm: Standard deviation of the reported position of a press, mm. It adds to
            the uncertainty of centres, and, where `FinePrediction` tells its effect on the
            displacements, to that of the data.
        scale_deviation: Relative standard deviation of the displacements of a press as a whole.
        model_deviation: Least noise of the displacements, over their root mean square.
    """

    pose_deviation_mm: float = 0.0
    scale_deviation: float = _SCALE_DEVIATION
    model_deviation: float = _MODEL_DEVIATION


class PressErrors(NamedTuple):
    """Errors of the data of a press that are predicted at a uniform body."""

    mesh: Float[np.ndarray, " data"]  # of the discretisation, mm
    pose: Float[np.ndarray, "axes data"]  # by the reported position, mm per mm

    @classmethod
    def of(cls, observation: Observation, predicted: Prediction | None) -> "PressErrors":
        """Return the errors in proportion to the displacements of the press."""
        if predicted is None:
            return cls(np.zeros(len(observation.values)), np.zeros((0, len(observation.values))))
        better, present = (u.ravel()[observation.index] for u in predicted[:2])
        relative = max(float(better @ observation.values), 0.0) / float(better @ better)
        pose = predicted.per_mm.reshape(len(predicted.per_mm), -1)[:, observation.index]
        return cls(relative * (better - present), relative * pose)


@dataclass(frozen=True, eq=False)
class _Known(ErrorSource):
    """An error whose changes of the data of each press are known, mm for each unit."""

    name: str
    changes: Sequence[Float[np.ndarray, "k _"]]

    def patterns(self, presses: MeasuredPresses) -> Float[np.ndarray, "data k"]:
        """Return the changes, which are independent for each press."""
        pairs = zip(presses.problem.data.observations, self.changes, strict=True)
        columns = [(change * observation.scale).T for observation, change in pairs]
        return presses.joined({i: column} for i, column in enumerate(columns))


def with_errors(
    problem: InverseProblem, errors: Sequence[PressErrors], options: DraftOptions
) -> DataModel:
    """Return the data without the discretisation's error, and with errors in common."""
    observations = problem.data.observations
    kinds = {
        _Known("discretisation", [one.mesh[None] for one in errors]): _REMAINING,
        _Known("scale", [o.values[None] for o in observations]): options.scale_deviation,
        _Known("position", [one.pose for one in errors]): options.pose_deviation_mm,
        RigidMotion(): _RIGID_DEVIATION,
    }
    presses = MeasuredPresses(problem, [(k,) for k in range(len(observations))])
    data = ErrorModel(presses, kinds).data({kind.name: level for kind, level in kinds.items()})
    return data.shifted([-one.mesh for one in errors])
