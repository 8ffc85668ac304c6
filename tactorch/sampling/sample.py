"""Active sampling with a presser that carries out every suggestion (Section V-C)."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float

from tactorch.errors import ConfigError
from tactorch.fem import SoftBody, Supports
from tactorch.fem.transfer import Transfer
from tactorch.inverse import Settings
from tactorch.inverse.fit.starts import START_MPA
from tactorch.inverse.posterior.select import posterior_at
from tactorch.mesh import TetMesh
from tactorch.recording import MaterialSpec, Press, Recording
from tactorch.recording.append import digest
from tactorch.sampling.candidates import Candidates, all_directions, planned_press
from tactorch.sampling.loop import LoopOptions, Observer, SamplingLoop, Update
from tactorch.sampling.rules import Rule
from tactorch.sampling.sources import Arrival, PressSource
from tactorch.sampling.suggest import Suggester, SuggestOptions
from tactorch.simulation.curved import Patch


@runtime_checkable
class Presser(Protocol):
    """Presses a patch, and reports it over the nodes of the mesh of the inversion."""

    def plan(self, patch: Patch) -> Press:
        """Return the press as it would be reported, with displacement 0."""

    def press(self, patch: Patch) -> Press:
        """Carry the press out."""


@dataclass(frozen=True, eq=False)
class SimulatedPresser:
    """Simulated presses on a body of known moduli.

    Attributes:
        body: The body, preferably on a finer mesh than the inversion's.
        youngs: True moduli, MPa.
        held: Mask of the fixed nodes of the body's mesh.
        mesh: Mesh of the inversion.
        mesh_held: Mask of its fixed nodes.
        pressure_mpa: Pressure of the sensor, MPa.
        noise_mm: Standard deviation of the noise of every press, mm.
        seed: Seed of the noise; a patch that is pressed again has the same noise.
    """

    body: SoftBody
    youngs: Float[np.ndarray, " e"]
    held: Bool[np.ndarray, " k"]
    mesh: TetMesh
    mesh_held: Bool[np.ndarray, " n"]
    pressure_mpa: float
    noise_mm: float
    seed: int = 0

    @cached_property
    def _transfer(self) -> Transfer:
        return Transfer.between(self.body.discretisation, self.mesh.points)

    def plan(self, patch: Patch) -> Press:
        """Return the press as it would be reported, with displacement 0."""
        return planned_press(patch, self.mesh, self.mesh_held, self.pressure_mpa, self.noise_mm)

    def press(self, patch: Patch) -> Press:
        """Press, and observe the nodes in contact."""
        supports = Supports(fixed=all_directions(self.held))
        load = self.pressure_mpa * patch.forces(self.body.mesh)
        result = self.body.equilibrate(self.youngs, load, supports).require()
        place = np.round(patch.center * 1e6).astype(np.int64) & 0xFFFFFFFF
        rng = np.random.default_rng([self.seed, *place.tolist()])
        plan = self.plan(patch)
        noise = self.noise_mm * rng.standard_normal(plan.forces.shape)
        return replace(plan, displacement=self._transfer(result.displacement) + noise)


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

    Returns one step per press. Ctrl-C ends the session. During an inversion it keeps that
    inversion's best map. Nuisance parameters are not estimated.

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
    first = rule.first(candidates)
    session = _Session(presser, mesh, material, candidates, budget, on_press, first)
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


@dataclass(eq=False)
class _Session(PressSource, Observer):
    """Presses where the rule suggests, and keeps the steps."""

    presser: Presser
    mesh: TetMesh
    material: MaterialSpec
    candidates: Sequence[Patch]
    budget: int
    on_press: Callable[[Step], None] | None
    next_place: int | None
    places: list[int] = field(default_factory=list)
    steps: list[Step] = field(default_factory=list)
    started: float = field(default_factory=time.perf_counter)
    name = "the presser"

    def available(self, recording: Recording) -> Candidates:
        if len(self.places) == self.budget:
            raise ConfigError(f"all presses of budget={self.budget} were made")
        return Candidates(self.candidates, tuple(self.places), self.presser.plan)

    def poll(self) -> list[Arrival]:
        if self.next_place is None:
            return []
        press = self.presser.press(self.candidates[self.next_place])
        self.places.append(self.next_place)
        self.next_place = None
        # A single press may be too small for the check of units.
        self.about = Recording(self.mesh, (press,), self.material, check_units=False)
        return [Arrival(press, f"press {len(self.places)}", digest(press))]

    def suggested(self, update: Update) -> None:
        suggestion, rms = update.suggestion, update.rms_deviation
        assert suggestion is not None
        ended = len(self.places) == self.budget
        if suggestion.deviation is None or rms is None or (suggestion.index is None and not ended):
            raise ConfigError(suggestion.reason)
        press = update.recording.presses[-1]
        seconds = time.perf_counter() - suggestion.seconds - self.started
        step = Step(self.places[-1], press, update.youngs, suggestion.deviation, rms, seconds)
        self.steps.append(step)
        self.next_place = suggestion.index
        if self.on_press is not None:
            self.on_press(step)
