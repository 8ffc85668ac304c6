"""How far a map is to be believed, element by element and press by press."""

import logging
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from tactorch.applications import Confidence, confidence_of, find_lump
from tactorch.credibility import credibility
from tactorch.credibility.trust import posterior_at
from tactorch.errors import TactorchError
from tactorch.inverse import Point, Settings, solution
from tactorch.recording import Recording
from tactorch.viz.report.runs import Run
from tactorch.viz.report.settings import settings_of

LEVEL = 0.95
#: Called with what is about to be done, and how many such steps are done of how many.
Tell = Callable[[str, int, int], None]

_STEPS = 4
_AT_BOUND = 1e-3  # of the way from one bound to the other, in parameters
_log = logging.getLogger("tactorch")


@dataclass(frozen=True, eq=False)
class Belief:
    """What is known of each element's modulus.

    Attributes:
        credibility: L of the paper's eq. (15), mm/MPa, (m,).
        low: Lower end of the interval of 95 %, MPa, (m,).
        high: Its upper end, MPa, (m,).
        resolution: Share of the data in each modulus: near 1 they decide, near 0 the prior, (m,).
        at_bound: Where the map lies at a bound of the moduli, which cuts the interval off, (m,).
        kind: Class of the posterior.
        sure: Of what stands out of the map; None where nothing does.
    """

    credibility: Float[np.ndarray, " m"]
    low: Float[np.ndarray, " m"]
    high: Float[np.ndarray, " m"]
    resolution: Float[np.ndarray, " m"]
    at_bound: Bool[np.ndarray, " m"]
    kind: str
    sure: Confidence | None = None

    @property
    def spread(self) -> Float[np.ndarray, " m"]:
        """Half the interval, as a share of the modulus: 0.3 is up or down by a factor of 1.3.

        NaN at a bound, where there is no such interval.
        """
        return np.where(self.at_bound, np.nan, np.sqrt(self.high / self.low) - 1.0)


@dataclass(frozen=True, eq=False)
class Fit:
    """How well one press is foretold.

    Attributes:
        residual: Predicted less observed, mm, (n, 3); NaN where nothing was observed.
        deviations: It in independent standard deviations, as the inversion weighs it, (n, 3).
    """

    residual: Float[np.ndarray, "n 3"]
    deviations: Float[np.ndarray, "n 3"]

    @property
    def rms_mm(self) -> float:
        """Root mean square of the residual, mm."""
        return float(np.sqrt(np.nanmean(self.residual**2)))

    @property
    def rms_deviations(self) -> float:
        """Root mean square of the residual in standard deviations."""
        return float(np.sqrt(np.nanmean(self.deviations**2)))


@dataclass(frozen=True, eq=False)
class Judgement:
    """What can be told of a run.

    Attributes:
        belief: Of each element; None where it was left out or could not be had.
        fits: Of each press; empty without a recording.
        missing: Why something is missing; empty where nothing is.
        corrected: Whether the mesh's own error is taken off the residuals, as the inversion did.
    """

    belief: Belief | None
    fits: list[Fit]
    missing: str
    corrected: bool


def judge(run: Run, *, uncertainty: bool = True, tell: Tell | None = None) -> Judgement:
    """Tell how far to believe a run's map and how well its presses are foretold.

    Args:
        run: The run.
        uncertainty: Whether to solve its presses again, for credibility and posterior: some ten
            seconds for two thousand elements, minutes for ten thousand.
        tell: Called before each step.
    """
    if run.recording is None:
        return Judgement(None, [], run.missing, False)
    if not uncertainty:
        return Judgement(None, _plain_fits(run, run.recording), "it was left out", False)
    try:
        belief, fits = _believed(run, run.recording, tell or (lambda *_: None))
    except TactorchError as error:
        _log.warning("%s: no uncertainty: %s", run.name, error)
        return Judgement(None, _plain_fits(run, run.recording), str(error), False)
    return Judgement(belief, fits, "", True)


def _believed(run: Run, recording: Recording, tell: Tell) -> tuple[Belief, list[Fit]]:
    tell("presses at the map", 0, _STEPS)
    point = solution(recording, run.found, run.settings or settings_of(run.found.config))
    tell("credibility", 1, _STEPS)
    felt = credibility(point.evaluation).values
    tell("posterior", 2, _STEPS)
    posterior = posterior_at(point, run.found.history[-1].get("weight", 0.0))
    tell("intervals", 3, _STEPS)
    low, high = posterior.interval(LEVEL)
    resolution = np.clip(posterior.resolution_diagonal(), 0.0, 1.0)
    tell("done", _STEPS, _STEPS)
    lower, upper = posterior.parameterization.limits
    edge = _AT_BOUND * (upper - lower)
    at_bound = (point.elements < lower + edge) | (point.elements > upper - edge)
    lump = find_lump(recording.mesh, run.found.youngs)
    sure = None if lump is None else confidence_of(recording.mesh, lump, posterior)
    belief = Belief(felt, low, high, resolution, at_bound, type(posterior).__name__, sure)
    return belief, _fits(recording, point)


def _fits(recording: Recording, point: Point) -> list[Fit]:
    found, fits = point.evaluation, []
    for seen, reported, deviations in zip(
        point.objective.problem.observations, found.reported, found.deviations, strict=True
    ):
        both = np.full((2, recording.mesh.n_points * 3), np.nan)
        both[0, seen.index] = reported.ravel()[seen.index] - seen.displacement
        both[1, seen.index] = deviations
        fits.append(Fit(*both.reshape(2, -1, 3)))
    return fits


def _plain_fits(run: Run, recording: Recording) -> list[Fit]:
    """Residuals as they are without the corrections that take solving the presses again."""
    try:
        noise = settings_of(run.found.config).noise
    except TactorchError:
        noise = Settings().noise
    fits = []
    for press, moved, deviation in zip(
        recording.presses, run.found.displacements, noise.deviations(recording), strict=True
    ):
        residual = np.where(press.data, moved - press.displacement, np.nan)
        fits.append(Fit(residual, residual / deviation))
    return fits
