"""Active sampling with a presser that carries out every suggestion (Section V-C)."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError
from tactorch.inverse import Settings
from tactorch.inverse.starts import START_MPA
from tactorch.mesh import TetMesh
from tactorch.recording import MaterialSpec, Press, Recording
from tactorch.recording.append import digest
from tactorch.sampling.candidates import Candidates, Patch
from tactorch.sampling.loop import LoopOptions, Observer, SamplingLoop, Update
from tactorch.sampling.presser import Presser
from tactorch.sampling.rules import Rule
from tactorch.sampling.sources import Arrival, PressSource
from tactorch.sampling.suggest import Suggester, SuggestOptions
from tactorch.uncertainty.select import posterior_at


@dataclass(frozen=True, eq=False)
class Step:
    """State after a press.

    Attributes:
        place: Index of the pressed candidate.
        press: The press; a `Recording` of all steps' presses holds the whole session.
        youngs: Map from all presses so far, MPa.
        deviation: Posterior standard deviation of each parameter (log-modulus by default).
        rms_deviation: Its volume-weighted root mean square.
        seconds: Time since the first press began.
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
    """Press where the rule suggests, inverting all presses after each from the previous map.

    Ctrl-C ends the session. During an inversion it keeps that inversion's best map.

    Args:
        presser: Carries out the presses.
        mesh: Mesh of the inversion.
        candidates: Patches that can be pressed.
        rule: Chooses among those not pressed yet.
        budget: Largest number of presses.
        settings: Settings of the inversions.
        material: Constitutive law of the body.
        start_mpa: Uniform start of the first inversion.
        target_deviation: Root mean square deviation of the parameters at which to stop.
        on_press: Called after each press and its inversion.

    Returns:
        One step per press.

    Raises:
        ConfigError: there are fewer candidates than the budget, nuisance parameters are to be
            estimated, or a setting cannot be used.
        ConvergenceError: the presses have no equilibrium, neither at the previous map nor at a
            uniform one.
    """
    settings = settings or Settings()
    if not 1 <= budget <= len(candidates):
        raise ConfigError(
            f"budget={budget} must be 1 to {len(candidates)}, as many as there are candidates."
        )
    if settings.nuisance.size:
        raise ConfigError(
            "active sampling does not estimate nuisance parameters; estimate them from a recording "
            "first, and sample with Settings(nuisance=NuisancePrior())."
        )
    session = _Session(presser, mesh, material, candidates, rule.first(candidates), budget)
    session.on_press = on_press
    # The posterior is the variational one under total variation: Laplace's is too narrow where no
    # press has been.
    suggester = Suggester(
        settings, SuggestOptions(rule=rule), candidates=session.available, posterior=posterior_at
    )
    SamplingLoop(
        session,
        settings,
        None,
        session,
        options=LoopOptions(max_batch=1, max_presses=budget),
        suggester=suggester,
        start_mpa=start_mpa,
        restart=True,
        target_deviation=target_deviation,
    ).run()
    return session.steps


class _Session(PressSource, Observer):
    """Presses where the rule suggests, and keeps the steps."""

    name = "the presser"

    def __init__(
        self,
        presser: Presser,
        mesh: TetMesh,
        material: MaterialSpec,
        candidates: Sequence[Patch],
        first: int,
        budget: int,
    ) -> None:
        self._presser, self._mesh, self._material = presser, mesh, material
        self._candidates, self._budget = candidates, budget
        self._places, self._pressed = [first], 0
        self._started = self._updated = time.perf_counter()
        self.steps: list[Step] = []
        self.on_press: Callable[[Step], None] | None = None

    def available(self, recording: Recording) -> Candidates:
        """Return the candidates, unless the budget is spent."""
        if len(self._places) == self._budget:
            raise ConfigError(f"all presses of budget={self._budget} were made")
        return Candidates(self._candidates, tuple(self._places), self._presser.plan)

    def poll(self) -> list[Arrival]:
        """Carry out the suggested press, if any."""
        if self._pressed == len(self._places):
            return []
        press = self._presser.press(self._candidates[self._places[-1]])
        self._pressed += 1
        # A single press may be too small for the check of units.
        self.about = Recording(self._mesh, (press,), self._material, check_units=False)
        return [Arrival(press, f"press {self._pressed}", digest(press))]

    def updated(self, update: Update) -> None:
        """See `Observer.updated`."""
        self._updated = time.perf_counter()

    def suggested(self, update: Update) -> None:
        """See `Observer.suggested`."""
        suggestion, rms = update.suggestion, update.rms_deviation
        assert suggestion is not None
        ended = len(self._places) == self._budget
        if suggestion.deviation is None or rms is None or (suggestion.index is None and not ended):
            raise ConfigError(suggestion.reason)
        press, seconds = update.recording.presses[-1], self._updated - self._started
        step = Step(self._places[-1], press, update.youngs, suggestion.deviation, rms, seconds)
        self.steps.append(step)
        if suggestion.index is not None:
            self._places.append(suggestion.index)
        if self.on_press is not None:
            self.on_press(step)
