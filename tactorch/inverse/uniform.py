"""The uniform map that fits best, with the nuisance parameters that are free."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConvergenceError
from tactorch.inverse.evaluation import Evaluation
from tactorch.inverse.nuisance import Nuisance, NuisancePrior
from tactorch.inverse.parameterization import Bounds
from tactorch.inverse.problem import InverseProblem
from tactorch.mesh import TetMesh
from tactorch.recording import Press

FIRST_MPA = 0.2
_LARGEST_STEP, _SETTLED, _ROUNDS, _HALVINGS = 1.5, 1e-3, 30, 8
_STIFFER = 4.0  # factor to try where the object collapses under its presses


@dataclass(frozen=True, eq=False)
class UniformFit:
    """A uniform map and nuisance parameters.

    Attributes:
        youngs_mpa: The modulus of all elements, MPa.
        nuisance: The nuisance parameters' values.
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
    """Find the uniform modulus, and nuisance parameters, that fit best.

    Gauss-Newton on the logarithm and on z, halving steps that fit worse, and stiffening where a
    press has no equilibrium.

    Args:
        problem: Presses and observations.
        bounds: Of the modulus.
        nuisance: Nuisance parameters that are free.
        first_mpa: Where to begin, MPa; by default 0.2, or what mean stress and strain under the
            presses come to where that is much more.

    Raises:
        ConvergenceError: no modulus within the bounds carries the presses.
    """
    bounds = bounds or Bounds()
    fit = _Fit(problem, bounds, nuisance or NuisancePrior())
    first = _first_mpa(problem) if first_mpa is None else first_mpa
    x = np.concatenate([[np.clip(np.log(first), fit.low[0], fit.high[0])], np.zeros(fit.k)])
    point = fit.at(x)
    while point is None:
        if x[0] >= fit.high[0]:
            raise ConvergenceError(
                f"No uniform modulus up to {bounds.upper:g} MPa carries the presses; check the "
                "units of the forces (N)."
            )
        x[0] = min(x[0] + np.log(_STIFFER), fit.high[0])
        point = fit.at(x)
    for _ in range(_ROUNDS):
        step = fit.step(x, point)
        moved = None if step is None else fit.better(x, step, point)
        if moved is None:
            break
        settled = np.abs(moved[0] - x).max() < _SETTLED
        x, point = moved
        if settled:
            break
    return UniformFit(float(np.exp(x[0])), fit.nuisance(x))


def _first_mpa(problem: InverseProblem) -> float:
    """Return where to begin: a body much softer than it is would collapse under its presses.

    To find that out, and to stiffen, takes far longer than all the rest.
    """
    recording = problem.recording
    found = [_stress_over_strain(recording.mesh, press) for press in recording.presses]
    told = [value for value in found if value is not None]
    guess = float(np.median(told)) if told else FIRST_MPA
    return guess if guess > _STIFFER * FIRST_MPA else FIRST_MPA


def _stress_over_strain(mesh: TetMesh, press: Press) -> float | None:
    """Mean pressure over how far the contact gives way, as a share of the body's length there."""
    total = press.forces.sum(axis=0)
    force = float(np.linalg.norm(total))
    touched = np.any(press.forces != 0, axis=1)
    surface = mesh.surface
    area = float(surface.areas[touched[surface.triangles].all(axis=1)].sum())
    if force == 0.0 or area == 0.0:
        return None
    inward = total / force
    seen = press.observed.all(axis=1) & touched
    if not seen.any():
        return None
    given = float((press.displacement[seen] @ inward).mean())
    length = float(np.ptp(mesh.points @ inward))
    return force / area * length / given if given > 0.0 else None


class _Fit:
    """The small problem: x is the logarithm of the modulus, then z."""

    def __init__(self, problem: InverseProblem, bounds: Bounds, nuisance: NuisancePrior) -> None:
        self._problem, self._prior, self.k = problem, nuisance, nuisance.size
        low, high = nuisance.limits(problem.assumed)
        self.low = np.concatenate([[np.log(bounds.lower)], low])
        self.high = np.concatenate([[np.log(bounds.upper)], high])

    def nuisance(self, x: Float[np.ndarray, " u"]) -> Nuisance:
        return self._prior.nuisance(x[1:], self._problem.assumed)

    def at(self, x: Float[np.ndarray, " u"], near: Evaluation | None = None) -> Evaluation | None:
        """Evaluate; None where there is no equilibrium with derivatives."""
        youngs = np.full(self._problem.n_elements, np.exp(x[0]))
        try:
            point = self._problem.evaluate(youngs, near, self.nuisance(x))
            for sensitivity in point.sensitivities:
                sensitivity.linearization.factor()
            return point
        except ConvergenceError:
            return None

    def step(self, x: Float[np.ndarray, " u"], point: Evaluation) -> Float[np.ndarray, " u"] | None:
        """One Gauss-Newton step; None where the data say nothing."""
        columns = [point.jacobian_times(point.youngs)[:, None]]
        if self.k:
            slopes = self._prior.slopes()
            columns.append(point.nuisance_jacobian(self._prior.names) * slopes)
        jacobian = np.hstack(columns)
        prior = np.concatenate([[0.0], np.ones(self.k)])
        curvature = jacobian.T @ jacobian + np.diag(prior)
        if curvature[0, 0] == 0.0:
            return None
        step = -np.linalg.solve(curvature, jacobian.T @ point.residuals + prior * x)
        return np.clip(step, -_LARGEST_STEP, _LARGEST_STEP)

    def better(
        self, x: Float[np.ndarray, " u"], step: Float[np.ndarray, " u"], point: Evaluation
    ) -> tuple[np.ndarray, Evaluation] | None:
        """The step, halved until it fits better; None if it does not."""
        for _ in range(_HALVINGS):
            there = np.clip(x + step, self.low, self.high)
            trial = None if np.array_equal(there, x) else self.at(there, point)
            if trial is not None and _value(there, trial) < _value(x, point):
                return there, trial
            step = 0.5 * step
        return None


def _value(x: Float[np.ndarray, " u"], point: Evaluation) -> float:
    return float(point.residuals @ point.residuals + x[1:] @ x[1:])
