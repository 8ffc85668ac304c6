"""Active sampling with a presser that carries out every suggestion (Section V-C)."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError
from tactorch.inverse import IncrementalResult, Settings, invert, make_objective
from tactorch.inverse.starts import START_MPA
from tactorch.mesh import TetMesh
from tactorch.recording import MaterialSpec, Press, Recording
from tactorch.sampling.candidates import Patch
from tactorch.sampling.loop import LoopOptions, Observer, SamplingLoop, Update
from tactorch.sampling.presser import Presser
from tactorch.sampling.rules import Rule
from tactorch.sampling.sources import PresserSource
from tactorch.sampling.suggest import Candidates, Suggester, SuggestOptions
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
        ConvergenceError: the presses have no equilibrium at the previous map.
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
    source = PresserSource(presser)
    session = _Session(presser, candidates, budget, [rule.first(candidates)], on_press)
    source.request(candidates[session.places[0]])
    loop = SamplingLoop(
        source,
        lambda: _RestartedInversion(mesh, material, settings, start_mpa),
        # The posterior is the variational one under total variation: Laplace's is too narrow where
        # no press has been.
        Suggester(
            settings,
            SuggestOptions(rule=rule),
            candidates=session.available,
            posterior=posterior_at,
        ),
        [session],
        options=LoopOptions(max_batch=1, max_presses=budget),
        skip_invalid=False,
        target_deviation=target_deviation,
    )
    loop.run()
    return session.steps


class _Session(Observer):
    """Pressed places, and the steps so far."""

    def __init__(
        self,
        presser: Presser,
        candidates: Sequence[Patch],
        budget: int,
        places: list[int],
        on_press: Callable[[Step], None] | None,
    ) -> None:
        self.places, self.steps = places, list[Step]()
        self._presser, self._candidates, self._budget = presser, candidates, budget
        self._on_press = on_press
        self._started = self._updated = time.perf_counter()

    def available(self, recording: Recording) -> Candidates:
        """Return the candidates, unless the budget is spent."""
        if len(self.places) == self._budget:
            raise ConfigError(f"all presses of budget={self._budget} were made")
        return Candidates(self._candidates, tuple(self.places), self._presser.plan)

    def updated(self, update: Update) -> None:
        """See `Observer.updated`."""
        self._updated = time.perf_counter()

    def suggested(self, update: Update) -> None:
        """See `Observer.suggested`."""
        suggestion = update.suggestion
        assert suggestion is not None
        if suggestion.deviation is None or (
            suggestion.index is None and len(self.places) < self._budget
        ):
            raise ConfigError(suggestion.reason)
        rms = update.rms_deviation
        assert rms is not None
        press, seconds = update.recording.presses[-1], self._updated - self._started
        step = Step(self.places[-1], press, update.youngs, suggestion.deviation, rms, seconds)
        self.steps.append(step)
        if suggestion.index is not None:
            self.places.append(suggestion.index)
        if self._on_press is not None:
            self._on_press(step)


class _RestartedInversion:
    """`invert` of all presses after each, started from the previous map."""

    def __init__(
        self, mesh: TetMesh, material: MaterialSpec, settings: Settings, start_mpa: float
    ) -> None:
        self._mesh, self._material, self._settings = mesh, material, settings
        self._presses: tuple[Press, ...] = ()
        self._youngs = np.full(mesh.n_tets, float(start_mpa))
        self._result: IncrementalResult | None = None

    @property
    def recording(self) -> Recording:
        """The object with all presses so far."""
        # A single press may be too small for the check of units.
        return Recording(self._mesh, self._presses, self._material, check_units=False)

    def add(self, presses: Sequence[Press]) -> IncrementalResult:
        """Invert all presses so far and these."""
        self._presses += tuple(presses)
        recording, settings = self.recording, self._settings
        result = invert(recording, settings, start_mpa=self._youngs, show_progress=False)
        self._youngs = result.youngs
        objective = make_objective(recording, settings)
        point = objective.at(objective.start(result.youngs))
        weight = float(result.history[-1].get("weight", 0.0))
        self._result = IncrementalResult(result, point, weight, converged=True)
        return self._result

    def refine(self, *, stop: Callable[[], bool]) -> IncrementalResult:
        """Return the last result, which is converged."""
        assert self._result is not None
        return self._result
