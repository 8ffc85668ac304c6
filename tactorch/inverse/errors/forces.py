"""Relative errors of the forces of presses."""

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float

from tactorch.inverse.errors.base import LEAST_CHANGE, ErrorSource, MeasuredPresses, principal
from tactorch.inverse.forward.palpation import is_palpation
from tactorch.linalg import map_cases

_MIN_MOMENT = 0.01  # of the loaded points along an axis, over the largest


class Forces(ErrorSource):
    """Errors of the forces of each press, over the forces.

    They are those of the forces as a whole, of gradients of unit root mean square along the
    principal axes of the loaded nodes, and of each nodal force, all of unit deviation. Where no
    force is applied they are those of the measured forces as a whole. Force sensors are calibrated
    to a few percent, and badly to ten.
    """

    name, elements, proposal = "forces", "linear", "forces wrong by {:.0%}"
    levels = (0.02, 0.05, 0.1)
    smallest = LEAST_CHANGE / levels[-1]
    note = (
        "The forces of the presses are wrong by about {:.0%}; the intervals of the lumps account "
        "for it. Check the calibration of the force sensor."
    )

    def least(self, presses: MeasuredPresses) -> float | None:
        """Return zero; a palpation has smooth errors instead."""
        return None if is_palpation(presses.problem.recording) else 0.0

    def patterns(self, presses: MeasuredPresses) -> sp.csr_matrix:
        """Return orthogonal changes of each press by independent errors, (data, k)."""
        recording, evaluation = presses.problem.recording, presses.evaluation
        points, data = recording.mesh.points, evaluation.data.observations

        def work(i: int) -> np.ndarray:
            forces = recording.presses[i].forces
            nodes = np.flatnonzero((forces != 0.0).any(axis=1))
            if not len(nodes):  # moved by a probe, prescribed displacements or its weight
                measured = data[i].scale * data[i].values
                measured[data[i].units[0]] = 0.0
                count = int(np.linalg.norm(measured) > self.smallest)
                return measured[:, None][:, :count]
            shapes = [*_gradients(points, forces), *np.eye(len(points))[nodes]]
            columns = evaluation.load_response(i, [forces * shape[:, None] for shape in shapes])
            return principal(columns, self.smallest)

        return sp.block_diag(map_cases(work, len(recording.presses)), format="csr")


def _gradients(
    points: Float[np.ndarray, "n 3"], forces: Float[np.ndarray, "n 3"]
) -> list[Float[np.ndarray, " n"]]:
    """Return unity, and linear functions of unit mean square over the loaded points."""
    sizes = np.linalg.norm(forces, axis=1)
    weights = sizes / sizes.sum()
    offsets = points - weights @ points
    moments, axes = np.linalg.eigh((offsets * weights[:, None]).T @ offsets)
    # A flat contact has two axes; a single loaded point has none.
    wide = (moments > _MIN_MOMENT * moments[-1]) & (moments > 0.0)
    return [np.ones(len(points)), *(offsets @ axes[:, wide] / np.sqrt(moments[wide])).T]
