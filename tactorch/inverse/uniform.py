"""The uniform map that fits best, together with the nuisance parameters that are estimated."""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from tactorch.errors import ConvergenceError
from tactorch.inverse.monitor import Monitor, StopCondition, StopOptimization, StopReason
from tactorch.inverse.nuisance import Nuisance, NuisancePrior
from tactorch.inverse.objective import Objective
from tactorch.inverse.optimizers import GaussNewton
from tactorch.inverse.parameterization import Bounds, Log
from tactorch.inverse.problem import InverseProblem
from tactorch.inverse.regularization import Quadratic
from tactorch.mesh import TetMesh
from tactorch.recording import Press

FIRST_MPA = 0.2
_STEP_TOLERANCE = 1e-3  # change of the log-modulus, or of z
_STIFFENING = 4.0  # factor to try where the object collapses, or seems much stiffer than FIRST_MPA
#: Tolerance of the objective where the size of the step alone ends the optimization.
NO_TOLERANCE = 1e-15
_OPTIMIZER = GaussNewton(max_iterations=30, tolerance=NO_TOLERANCE, max_trials=8)


@dataclass(frozen=True, eq=False)
class UniformFit:
    """A uniform map and nuisance values.

    Attributes:
        youngs_mpa: Modulus of all elements, MPa.
        nuisance: Nuisance values.
    """

    youngs_mpa: float
    nuisance: Nuisance


def uniform_fit(
    problem: InverseProblem,
    bounds: Bounds | None = None,
    nuisance: NuisancePrior | None = None,
    *,
    first_mpa: float | None = None,
) -> UniformFit:
    """Find the uniform modulus, and the nuisance parameters, that fit best.

    Damped Gauss-Newton on the log-modulus and z, from a stiffer start where a press has no
    equilibrium.

    Args:
        problem: Presses and observations.
        bounds: Limits of the modulus.
        nuisance: Nuisance parameters to be estimated.
        first_mpa: Start, MPa; by default 0.2, or the ratio of mean stress and strain under the
            presses where that is much larger.

    Raises:
        ConvergenceError: no modulus within the bounds carries the presses.
    """
    bounds = bounds or Bounds()
    objective = Objective(
        problem,
        Log(bounds),
        Quadratic(sp.csr_matrix((1, 1))),
        nuisance or NuisancePrior(),
        weight=0.0,
        groups=np.zeros(problem.n_elements, dtype=np.int64),
        stable_only=True,
    )
    first = _first_mpa(problem) if first_mpa is None else first_mpa
    x, upper = np.zeros(objective.size), np.log(bounds.upper)
    x[0] = np.clip(np.log(first), np.log(bounds.lower), upper)
    while True:
        monitor = Monitor(stop_condition=small_step(_STEP_TOLERANCE), log=False)
        try:
            _OPTIMIZER.minimize(objective, x, monitor)
        except StopOptimization:
            pass
        except ConvergenceError as error:
            if monitor.point is None and x[0] >= upper:
                raise ConvergenceError(
                    f"No uniform modulus up to {bounds.upper:g} MPa carries the presses; check the "
                    "units of the forces (N)."
                ) from error
        if (point := monitor.point) is not None:
            return UniformFit(float(point.youngs[0]), point.evaluation.nuisance)
        x[0] = min(x[0] + np.log(_STIFFENING), upper)


def small_step(tolerance: float) -> StopCondition:
    """Return a condition that stops after a step whose largest change is below a tolerance."""

    def stop_condition(history: list[dict[str, float]]) -> StopReason | None:
        small = len(history) > 1 and history[-1]["step"] < tolerance
        return StopReason.CONVERGED if small else None

    return stop_condition


def _first_mpa(problem: InverseProblem) -> float:
    """Return the start, MPa: a much too soft body would collapse, which takes long to detect."""
    recording = problem.recording
    estimates = [_stress_over_strain(recording.mesh, press) for press in recording.presses]
    known = [value for value in estimates if value is not None]
    guess = float(np.median(known)) if known else FIRST_MPA
    return guess if guess > _STIFFENING * FIRST_MPA else FIRST_MPA


def _stress_over_strain(mesh: TetMesh, press: Press) -> float | None:
    """Mean pressure over the mean displacement of the contact relative to the body's length."""
    total = press.forces.sum(axis=0)
    force = float(np.linalg.norm(total))
    contact = np.any(press.forces != 0, axis=1)
    surface = mesh.surface
    area = float(surface.areas[contact[surface.triangles].all(axis=1)].sum())
    if force == 0.0 or area == 0.0:
        return None
    inward = total / force
    observed = press.observed.all(axis=1) & contact
    if not observed.any():
        return None
    depth = float((press.displacement[observed] @ inward).mean())
    length = float(np.ptp(mesh.points @ inward))
    return force / area * length / depth if depth > 0.0 else None
