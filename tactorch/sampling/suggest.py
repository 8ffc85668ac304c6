"""Suggestion of the next press: posterior, candidates, and a rule that chooses among them."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from jaxtyping import Float

from tactorch.config import Options, option
from tactorch.errors import ConfigError, ConvergenceError, RecordingError
from tactorch.inverse import InverseProblem, Point, Settings, ShapeReconstruction
from tactorch.inverse.data.observations import CorrelatedNoise
from tactorch.inverse.errors.discretisation import smooth_pattern
from tactorch.inverse.posterior.gaussian import GaussianPosterior
from tactorch.inverse.posterior.gaussian_state import GaussianState
from tactorch.inverse.posterior.laplace import LaplacePosterior
from tactorch.inverse.posterior.variational import (
    VariationalPosterior,
    has_variational_posterior,
    variational_posterior,
)
from tactorch.recording import Press, Recording
from tactorch.sampling.candidates import Candidates, InferredCandidates
from tactorch.sampling.rules import RULES, Automatic, Jacobian, Rule, SamplingState
from tactorch.simulation.curved import Patch

# A coarse posterior suffices to compare candidates, and starts from the previous one.
_MAX_ITERATIONS, _TOLERANCE = 12, 0.1

PosteriorFunction: TypeAlias = Callable[[Point, float], GaussianPosterior]


@dataclass(frozen=True)
class SuggestOptions(Options):
    """Suggestion of the next press."""

    section = "suggest"

    rule: Rule = option(factory=Automatic, help="Rule that chooses the next press", section="rule")
    radius_mm: float | None = option(
        None, "Radius of the sensor; null: that of the area the presses loaded", unit="mm", gt=0
    )
    candidates: int = option(24, "Number of candidate places that are compared", ge=1)


@dataclass(frozen=True, eq=False)
class Suggestion:
    """Next press, and the uncertainty of the map.

    Attributes:
        patch: Patch to press; None if there is none.
        index: Its index among the candidates.
        reason: Reason why there is none.
        rule: Name of the rule that chose.
        deviation: Standard deviation of each parameter (log-modulus by default); None if no
            posterior was computed.
        seconds: Duration.
    """

    patch: Patch | None
    index: int | None
    reason: str
    rule: str
    deviation: Float[np.ndarray, " m"] | None
    seconds: float


class Suggester:
    """Suggests the next press after each inversion.

    Args:
        settings: Settings of the inversions.
        options: Rule and candidates.
        candidates: Returns the candidates for an object and its presses; by default patches of the
            sensor's size over the surface that no press fixed, loaded by the median pressure so
            far and fixed as in the last press.
        posterior: Returns the posterior at a solution, for every rule; by default a coarse one
            that starts from the previous one, and only for rules that use it.
    """

    def __init__(
        self,
        settings: Settings,
        options: SuggestOptions | None = None,
        *,
        candidates: Callable[[Recording], Candidates] | None = None,
        posterior: PosteriorFunction | None = None,
    ) -> None:
        options = options or SuggestOptions()
        self._settings, self._rule = settings, options.rule
        self._candidates = candidates or InferredCandidates(options.radius_mm, options.candidates)
        self._posterior = posterior or _WarmStartedPosterior()
        self._always_posterior = posterior is not None

    @property
    def uses_shapes(self) -> bool:
        """Whether a suggestion depends on the shapes that were fitted to the presses."""
        return self._rule.uses_shapes

    def suggest(
        self,
        point: Point,
        weight: float,
        stop: Callable[[], bool] = lambda: False,
        shapes: ShapeReconstruction | None = None,
    ) -> Suggestion | None:
        """Suggest the next press.

        Args:
            point: Solution of all presses so far.
            weight: Weight of the prior there.
            stop: Called after the posterior; True cancels the suggestion: the result is None.
            shapes: Shapes that were fitted to these presses, or to the first of them.
        """
        started, recording = time.perf_counter(), point.objective.problem.recording
        rule, posterior, index, patch, reason = self._rule, None, None, None, ""
        try:
            rule = rule.resolve(recording)
            if rule.uses_posterior or self._always_posterior:
                posterior = self._posterior(point, weight)
            if stop():
                return None
            candidates = self._candidates(recording)
            gaussian = posterior if rule.uses_posterior else None
            index = rule.choose(self._state(point, gaussian, candidates, shapes))
            patch = candidates.patches[index]
        except (ConfigError, ConvergenceError, RecordingError) as error:
            reason = str(error)
        deviation = None if posterior is None else posterior.deviation()
        name, seconds = RULES.name_of(type(rule)), time.perf_counter() - started
        return Suggestion(patch, index, reason, name, deviation, seconds)

    def _state(
        self,
        point: Point,
        posterior: GaussianPosterior | None,
        candidates: Candidates,
        shapes: ShapeReconstruction | None,
    ) -> SamplingState:
        mesh, gaussian = point.objective.problem.recording.mesh, None
        if posterior is not None:
            covariance = posterior.covariance(np.arange(mesh.n_tets))
            gaussian = GaussianState(posterior.mean, covariance)

        def jacobians(indices: Sequence[int]) -> list[Jacobian | None]:
            presses = [candidates.plan(candidates.patches[i]) for i in indices]
            return _predict(presses, point, self._settings)

        patches, pressed, _ = candidates
        parameterization = point.objective.elements.parameterization
        credibility = _credibility(point)
        known = point.jacobian[:, : mesh.n_tets]
        per_log = point.youngs / parameterization.slope(point.coefficients)
        return SamplingState(
            mesh, patches, pressed, parameterization, credibility, jacobians, gaussian,
            known, per_log, shapes,
        )  # fmt: skip


class _WarmStartedPosterior:
    """Posterior of limited accuracy that starts at the previous one."""

    def __init__(self) -> None:
        self._previous: VariationalPosterior | None = None

    def __call__(self, point: Point, weight: float) -> GaussianPosterior:
        if not has_variational_posterior(point, weight):
            return LaplacePosterior.at(point, weight)
        previous, sizes = self._previous, None
        if previous is not None and len(previous.mean) == len(point.coefficients):
            weight, sizes = previous.weight, previous.sizes
        self._previous = variational_posterior(
            point, weight, sizes=sizes, tolerance=_TOLERANCE, max_iterations=_MAX_ITERATIONS
        )
        return self._previous


def _credibility(point: Point) -> Float[np.ndarray, "presses m"]:
    """Square of L (eq. 15) of each press by itself, see `SamplingState.credibility`."""
    problem, mesh = point.objective.problem, point.objective.problem.recording.mesh
    blocks = np.split(point.jacobian[:, : mesh.n_tets], problem.data.begins[1:])
    sensitivity = np.array([np.abs(block).max(axis=0) for block in blocks])
    # Small elements do not count as less sensitive.
    return (sensitivity * mesh.volumes.mean() / mesh.volumes) ** 2


def _predict(presses: Sequence[Press], point: Point, settings: Settings) -> list[Jacobian | None]:
    """Predict the Jacobians of candidate presses at the current map.

    Their noise is that of the current data: the sensor's noise, and the model error of the mesh,
    white and smooth.
    """
    current = point.objective.problem
    noise = float(1.0 / np.median(current.data.scale))
    # The Jacobian does not depend on the measured displacement, but presses with none are refused.
    nonzero = np.full(presses[0].forces.shape, noise)
    planned = tuple(replace(press, displacement=nonzero, noise_mm=noise) for press in presses)
    # Planned displacements are no measurements, so their magnitude is not checked.
    recording = replace(current.recording, presses=planned, check_units=False)
    problem = InverseProblem(recording, newton=settings.newton, body=current.body)
    slope = point.objective.elements.parameterization.slope(point.coefficients)
    try:
        jacobian = problem.evaluate(point.youngs).jacobian() * slope
    except ConvergenceError:
        if len(presses) == 1:
            return [None]
        return [_predict([press], point, settings)[0] for press in presses]
    blocks = np.split(jacobian, problem.data.begins[1:])
    if current.data.model_deviation is None:
        return [*blocks]
    deviation, points = float(np.median(current.data.model_deviation)), recording.mesh.points
    patterns = [smooth_pattern(points, data, deviation) for data in problem.data.observations]
    return [CorrelatedNoise(s).whiten(block) for s, block in zip(patterns, blocks, strict=True)]
