"""Whether an element map explains errors of the forces, which it takes for exact, as structure.

The map is linearised at its optimum. With errors of the forces of a relative deviation as part of
the covariance of the data, the optimum of the same objective moves: where the forces are right, by
hardly anything, and where they are wrong, to another map. The gain of the objective, less the Occam
factor of the errors (half the change of the log-determinant of the covariance), is the log-evidence
for them at the optimum (MacKay, Information Theory, Inference, and Learning Algorithms, 2003,
chapter 28), without the change of the posterior volume of the map.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.sparse import block_diag

from tactorch.inverse.errors.forces import Forces
from tactorch.inverse.fit.objective import Point
from tactorch.inverse.search.model import MIN_GAIN
from tactorch.linalg import DenseCholesky

_MAX_PARAMETERS = 6_000  # whose normal matrix is solved in each step
_STEPS = 8  # of reweighted least squares
# Squared correlation of the log-moduli of the maps with and without errors of the forces. With
# forces of four random objects that are exact or wrong by 2 or 5 %, it was 0.93 or more where the
# map has a correlation of 0.6 or more with the object, and at most 0.79 where that is 0.35 or less;
# of three others 0.99 or more, and at most 0.81 (`benchmarks/results/map_criticism.md`).
_MIN_SHARED = 0.9


class ForceErrors(NamedTuple):
    """Errors of the forces of each press beside an element map.

    Attributes:
        level: Relative deviation of the forces of the largest log-evidence.
        gain: Its log-evidence over that of exact forces.
        shared: Squared correlation of the log-moduli of the maps with and without these errors.
    """

    level: float
    gain: float
    shared: float

    @property
    def are_likely(self) -> bool:
        """Whether they explain the presses better than the structure of the map."""
        return self.gain > MIN_GAIN and self.shared < _MIN_SHARED


def force_errors(point: Point, weight: float) -> ForceErrors | None:
    """Return the most probable errors of the forces at the optimum of an element map.

    None for more than 6,000 parameters, and where a press has no forces.
    """
    presses = point.objective.problem.recording.presses
    has_forces = all(press.forces.any() for press in presses)
    if len(point.x) > _MAX_PARAMETERS or not has_forces or len(point.z):
        return None
    # Errors of each press as a whole: those of single nodal forces could explain an inclusion.
    columns = [point.evaluation.load_response(i, [p.forces]) for i, p in enumerate(presses)]
    patterns = block_diag(columns).toarray()
    # The optimizer may have ended before the optimum.
    exact, x = _optimum(point, weight, 0.0 * patterns[:, :1])
    others = [_optimum(point, weight, level * patterns) for level in Forces.levels]
    best = int(np.argmin([value for value, _ in others]))
    lowest, other = others[best]
    logs = [np.log(point.objective.field.at(one).youngs) for one in (x, other)]
    volumes = point.objective.problem.recording.mesh.volumes
    covariance = np.cov(logs, aweights=volumes)
    shared = float(covariance[0, 1] ** 2 / max(covariance[0, 0] * covariance[1, 1], 1e-300))
    return ForceErrors(Forces.levels[best], exact - lowest, shared)


def _optimum(
    point: Point, weight: float, patterns: Float[np.ndarray, "data k"]
) -> tuple[float, Float[np.ndarray, " size"]]:
    """Return the least linearised objective where the data have further errors, and its map.

    It includes the Occam factor of the errors.
    """
    data, field = point.evaluation.data, point.objective.field
    wider = data.with_errors(patterns)
    evaluation = point.evaluation.with_data(wider)
    residuals, jacobian = evaluation.residuals, point.field.jacobian(evaluation)
    normal, x, best = jacobian.T @ jacobian, point.x, (np.inf, point.x)
    occam = 0.5 * (wider.log_determinant - data.log_determinant)
    for _ in range(_STEPS):
        at, left = field.at(x), residuals + jacobian @ (x - point.x)
        gradient = jacobian.T @ left + weight * at.penalty_gradient
        factor = DenseCholesky.of(normal.copy(), weight * at.penalty_curvature)
        if factor is None:
            break
        x = np.clip(x - factor.solve(gradient), *point.objective.limits)
        left = residuals + jacobian @ (x - point.x)
        value = 0.5 * float(left @ left) + weight * field.at(x).penalty + occam
        if value < best[0]:
            best = value, x
    return best
