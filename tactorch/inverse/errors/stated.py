"""Correlated errors of the forces and displacements of presses, as errors of the residuals.

An error df of the forces changes the predicted data by S df, where S is the response of the object,
and an error du of the displacements changes the data. Where both have the pattern of an error in
common, so has the residual: du - S df. For forces that follow from displacements by the stiffness
of a gel, the covariance of the residuals is then that of the coupled problem of gel and object,
linearised in the displacements.
"""

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float

from tactorch.inverse.errors.base import ErrorSource, MeasuredPresses, principal
from tactorch.inverse.forward.problem import Evaluation
from tactorch.linalg import map_cases
from tactorch.recording import Press


class Stated(ErrorSource):
    """Correlated errors of forces and displacements that presses state, with their deviations."""

    name, elements, smallest = "stated", "quadratic", 0.1
    # An inclusion of a fiftieth of the body changes the response at a contact by some per cent.
    outlasts = 0.05

    def least(self, presses: MeasuredPresses) -> float | None:
        """Return one, the deviations that are stated, if any."""
        stated = [press.errors is not None for press in presses.problem.recording.presses]
        return 1.0 if any(stated) else None

    def patterns(self, presses: MeasuredPresses) -> Float[np.ndarray, "data k"]:
        """Return orthogonal changes of each press, whose covariance is that of its errors."""
        each, evaluation = presses.problem.recording.presses, presses.evaluation

        def work(i: int) -> np.ndarray:
            return principal(_residuals(evaluation, each[i], i), self.smallest)

        return sp.block_diag(map_cases(work, len(each))).toarray()


def _residuals(evaluation: Evaluation, press: Press, number: int) -> Float[np.ndarray, "data q"]:
    """Errors of the residuals of a press by each of its patterns."""
    observation = evaluation.data.observations[number]
    if press.errors is None:
        return np.zeros((len(observation.values), 0))
    forces = np.zeros((len(press.errors.forces), *press.forces.shape))
    forces[:, press.errors.nodes] = press.errors.forces
    moved = np.zeros_like(forces)
    moved[:, press.errors.nodes] = press.errors.displacement
    evaluation.sensitivities[number].linearization.factor()  # there are many patterns
    columns = -evaluation.load_response(number, list(forces))
    nodal = moved.reshape(len(moved), -1)[:, observation.index].T
    columns[observation.nodal] += nodal * observation.scale[observation.nodal, None]
    return columns
