"""Active sampling: press, invert, and choose where to press next (Section V-C)."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError
from tactorch.inverse import (
    START_MPA,
    Point,
    Settings,
    StopReason,
    invert,
    make_objective,
)
from tactorch.mesh import TetMesh
from tactorch.recording import MaterialSpec, Press, Recording
from tactorch.sampling.candidate_jacobians import credibilities, foretold
from tactorch.sampling.candidates import Patch
from tactorch.sampling.presser import Presser
from tactorch.sampling.rules import Rule, SamplingState
from tactorch.uncertainty.gaussian import GaussianPosterior
from tactorch.uncertainty.gaussian_state import GaussianState
from tactorch.uncertainty.select import posterior_at


@dataclass(frozen=True, eq=False)
class Step:
    """What stands after one more press.

    Attributes:
        place: The candidate that was pressed.
        press: What it gave; a `Recording` of all steps' presses holds the whole session.
        youngs: The map from all presses so far, MPa.
        deviation: Of each parameter (log-modulus by default) under the posterior there.
        rms_deviation: Its root mean square by volume.
        seconds: Since the first press began.
    """

    place: int
    press: Press
    youngs: Float[np.ndarray, " m"]
    deviation: Float[np.ndarray, " m"]
    rms_deviation: float
    seconds: float


def sample(
    presser: Presser,
    mesh: TetMesh,
    candidates: Sequence[Patch],
    rule: Rule,
    budget: int,
    settings: Settings | None = None,
    *,
    material: MaterialSpec,
    start_mpa: float = START_MPA,
    target_deviation: float = 0.0,
    on_press: Callable[[Step], None] | None = None,
) -> list[Step]:
    """Press where the rule says, inverting all presses after each, from the map before.

    An interruption (Ctrl-C) within an inversion keeps that inversion's best map, and no further
    press is made.

    Args:
        presser: Who presses.
        mesh: Of the inversion.
        candidates: Places to press.
        rule: Chooses among those not pressed yet.
        budget: How many presses at most.
        settings: Of the inversions.
        material: Law of the body.
        start_mpa: Where the first inversion starts.
        target_deviation: Root mean square deviation of the parameters at which to stop.
        on_press: Called after each press and its inversion.

    Raises:
        ConfigError: there are fewer candidates than the budget, nuisance parameters are to be
            estimated, or a setting cannot be used.
        ConvergenceError: the presses have no equilibrium at the map before.
    """
    if not 1 <= budget <= len(candidates):
        raise ConfigError(
            f"budget={budget} must be 1 to {len(candidates)}, as many as there are candidates."
        )
    settings, began = settings or Settings(), time.perf_counter()
    if settings.nuisance.size:
        raise ConfigError(
            "active sampling does not know nuisance parameters; estimate them from a recording "
            "first, and sample with Settings(nuisance=Unknowns())."
        )
    body = _Body(mesh, material, settings)
    presses: list[Press] = []
    steps: list[Step] = []
    youngs = np.full(mesh.n_tets, float(start_mpa))
    place = rule.first(candidates)
    while True:
        presses.append(presser.press(candidates[place]))
        point, posterior, stopped = body.solve(presses, youngs)
        youngs, deviation = point.youngs, posterior.deviation()
        rms = float(np.sqrt(mesh.volumes @ deviation**2 / mesh.volumes.sum()))
        steps.append(Step(place, presses[-1], youngs, deviation, rms, time.perf_counter() - began))
        if on_press is not None:
            on_press(steps[-1])
        if stopped or len(steps) == budget or rms <= target_deviation:
            return steps
        pressed = tuple(step.place for step in steps)

        def predict(places: Sequence[int], at: Point = point) -> list[np.ndarray | None]:
            return foretold([presser.plan(candidates[i]) for i in places], at, body.settings)

        place = rule.choose(
            SamplingState(
                mesh=mesh,
                candidates=candidates,
                pressed=pressed,
                parameterization=point.objective.parameterization,
                belief=GaussianState(posterior.mean, posterior.covariance(np.arange(mesh.n_tets))),
                credibility=credibilities(point),
                jacobians=predict,
            )
        )


@dataclass(frozen=True, eq=False)
class _Body:
    """What all inversions share."""

    mesh: TetMesh
    material: MaterialSpec
    settings: Settings

    def _recording(self, presses: Sequence[Press]) -> Recording:
        # Presses yet to be made are without displacement, so units are not told by it.
        return Recording(
            mesh=self.mesh, presses=tuple(presses), material=self.material, check_units=False
        )

    def solve(
        self, presses: Sequence[Press], start: np.ndarray
    ) -> tuple[Point, GaussianPosterior, bool]:
        """Return the map of the presses, the posterior there, and whether it was interrupted."""
        recording, settings = self._recording(presses), self.settings
        found = invert(recording, settings, start_mpa=start, show_progress=False)
        objective = make_objective(recording, settings)
        point = objective.at(objective.start(found.youngs))
        # The widest that can be had: Laplace's trusts total variation where no press was yet.
        posterior = posterior_at(point, found.history[-1].get("weight", 0.0))
        return point, posterior, found.stop_reason == StopReason.INTERRUPTED
