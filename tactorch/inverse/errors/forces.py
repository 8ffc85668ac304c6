"""Relative errors of the forces of presses."""

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float

from tactorch.inverse.errors.base import ErrorSource, MeasuredPresses
from tactorch.inverse.palpation import is_palpation
from tactorch.inverse.problem import Evaluation
from tactorch.linalg import map_cases
from tactorch.recording import Recording

_MIN_MOMENT = 0.01  # of the loaded points along an axis, over the largest


class Forces(ErrorSource):
    """Errors of the forces of each press, over the forces; see `force_patterns`.

    Force sensors are calibrated to a few percent, and badly to ten.
    """

    name, elements, proposal = "forces", "linear", "forces wrong by {:.0%}"
    levels = (0.02, 0.05, 0.1)

    def least(self, presses: MeasuredPresses) -> float | None:
        """Return zero; a palpation has smooth errors instead."""
        return None if is_palpation(presses.problem.recording) else 0.0

    def patterns(self, presses: MeasuredPresses) -> Float[np.ndarray, "data k"]:
        """Return the changes of the data by the errors of each press."""
        return force_patterns(presses.evaluation, presses.problem.recording, self.smallest)

    def sentence(self, level: float) -> str:
        """Return what a deviation means for the result."""
        if not level:
            return ""
        return (
            f"The forces of the presses are wrong by about {level:.0%}; the intervals of the lumps "
            "account for it. Check the calibration of the force sensor."
        )


def force_patterns(
    evaluation: Evaluation, recording: Recording, smallest: float = 0.0
) -> Float[np.ndarray, "data k"]:
    """Return the changes of the data by relative errors of the forces of each press.

    The errors are those of its forces as a whole, of gradients of unit root mean square along the
    principal axes of its loaded nodes, and of each nodal force, all of unit deviation. The patterns
    are orthogonal for each press, and the products with their transpose are those of all these
    errors. Where nothing is applied the error is that of the measured forces as a whole. The unit
    is the standard deviation of the white noise; patterns of a norm below `smallest` are left out.
    """
    points, data = recording.mesh.points, evaluation.data.observations

    def work(i: int) -> np.ndarray:
        forces = recording.presses[i].forces
        nodes = np.flatnonzero((forces != 0.0).any(axis=1))
        if not len(nodes):  # moved by a probe, prescribed displacements or its weight
            measured = data[i].scale * data[i].values
            measured[data[i].units[0]] = 0.0
            count = int(np.linalg.norm(measured) > smallest)
            return measured[:, None][:, :count]
        shapes = [*_gradients(points, forces), *np.eye(len(points))[nodes]]
        columns = evaluation.load_response(i, [forces * shape[:, None] for shape in shapes])
        basis, sizes, _ = np.linalg.svd(columns, full_matrices=False)
        kept = sizes > smallest
        return basis[:, kept] * sizes[kept]

    return sp.block_diag(map_cases(work, len(recording.presses))).toarray()


def _gradients(
    points: Float[np.ndarray, "n 3"], forces: Float[np.ndarray, "n 3"]
) -> list[Float[np.ndarray, " n"]]:
    """Return unity, and linear functions of unit mean square over the loaded points."""
    sizes = np.linalg.norm(forces, axis=1)
    weights = sizes / sizes.sum()
    offsets = points - weights @ points
    moments, axes = np.linalg.eigh((offsets * weights[:, None]).T @ offsets)
    # A flat contact has two axes; a single loaded point has none.
    wide = moments > _MIN_MOMENT * moments[-1]
    wide &= moments > 0.0
    return [np.ones(len(points)), *(offsets @ axes[:, wide] / np.sqrt(moments[wide])).T]
