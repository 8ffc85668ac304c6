"""One suggestion of the next press: posterior, candidates, and a rule that chooses among them."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from jaxtyping import Float

from tactorch.config import Options, option
from tactorch.errors import ConfigError
from tactorch.inverse import Point, Settings
from tactorch.mesh import TetMesh
from tactorch.recording import Press, Recording
from tactorch.sampling.candidate_jacobians import predict_jacobians, press_credibility
from tactorch.sampling.candidates import Patch, candidate_patches
from tactorch.sampling.rules import RULES, Automatic, Rule, SamplingState
from tactorch.uncertainty.gaussian import GaussianPosterior
from tactorch.uncertainty.gaussian_state import GaussianState
from tactorch.uncertainty.laplace import LaplacePosterior
from tactorch.uncertainty.variational import (
    VariationalPosterior,
    has_variational_posterior,
    variational_posterior,
)

# A coarse posterior suffices to compare candidates, and starts from the previous one.
_MAX_ITERATIONS, _TOLERANCE = 12, 0.1
_MIN_FACING = 0.85  # mean cosine between surface and sensor; an edge of a cube has 0.71
_MAX_RADIUS_SHARE = 0.25  # inferred radius of the sensor over the object's smallest extent


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
class Candidates:
    """Patches that can be pressed next.

    Attributes:
        patches: All patches.
        pressed: Indices of those pressed so far, in order.
        plan: Returns the press on a patch as it would be recorded, with displacement 0.
    """

    patches: Sequence[Patch]
    pressed: tuple[int, ...]
    plan: Callable[[Patch], Press]


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


PosteriorFunction: TypeAlias = Callable[[Point, float], GaussianPosterior]
CandidateSource: TypeAlias = Callable[[Recording], Candidates]


class Suggester:
    """Suggests the next press after each inversion."""

    def __init__(
        self,
        settings: Settings,
        options: SuggestOptions | None = None,
        *,
        candidates: CandidateSource | None = None,
        posterior: PosteriorFunction | None = None,
    ) -> None:
        """Set up.

        Args:
            settings: Settings of the inversions.
            options: Rule and candidates.
            candidates: Returns the candidates for an object and its presses; by default patches
                of the sensor's size over the surface that no press fixed, loaded by the median
                pressure so far and fixed as in the last press.
            posterior: Returns the posterior at a solution, for every rule; by default a coarse one
                that starts from the previous one, and only for rules that use it.
        """
        self.options = options or SuggestOptions()
        self._settings = settings
        self._candidates = candidates or InferredCandidates(self.options)
        self._posterior = posterior or _WarmStartedPosterior()
        self._always_posterior = posterior is not None

    def suggest(
        self, point: Point, weight: float, stop: Callable[[], bool] = lambda: False
    ) -> Suggestion | None:
        """Suggest the next press.

        Args:
            point: Solution of all presses so far.
            weight: Weight of the prior there.
            stop: Called after the posterior; True cancels the suggestion.

        Returns:
            None if the suggestion was cancelled.
        """
        started, recording = time.perf_counter(), point.objective.problem.recording
        rule, posterior, index, patch, reason = self.options.rule, None, None, None, ""
        try:
            rule = rule.resolve(recording)
            if rule.uses_posterior or self._always_posterior:
                posterior = self._posterior(point, weight)
            if stop():
                return None
            candidates = self._candidates(recording)
            index = rule.choose(self._state(rule, point, posterior, candidates))
            patch = candidates.patches[index]
        except ConfigError as error:
            reason = str(error)
        return Suggestion(
            patch,
            index,
            reason,
            RULES.name_of(type(rule)),
            None if posterior is None else posterior.deviation(),
            time.perf_counter() - started,
        )

    def _state(
        self,
        rule: Rule,
        point: Point,
        posterior: GaussianPosterior | None,
        candidates: Candidates,
    ) -> SamplingState:
        mesh = point.objective.problem.recording.mesh

        def jacobians(indices: Sequence[int]) -> list[np.ndarray | None]:
            presses = [candidates.plan(candidates.patches[i]) for i in indices]
            return predict_jacobians(presses, point, self._settings)

        gaussian = None
        if rule.uses_posterior and posterior is not None:
            covariance = posterior.covariance(np.arange(mesh.n_tets))
            gaussian = GaussianState(posterior.mean, covariance)
        return SamplingState(
            mesh=mesh,
            candidates=candidates.patches,
            pressed=candidates.pressed,
            parameterization=point.objective.parameterization,
            credibility=press_credibility(point),
            jacobians=jacobians,
            posterior=gaussian,
        )


class _WarmStartedPosterior:
    """Posterior of limited accuracy that starts at the previous one."""

    def __init__(self) -> None:
        self._previous: VariationalPosterior | None = None

    def __call__(self, point: Point, weight: float) -> GaussianPosterior:
        if not has_variational_posterior(point, weight):
            return LaplacePosterior.at(point, weight)
        previous = self._previous
        if previous is None or len(previous.mean) != len(point.elements):
            start, sizes = weight, None
        else:
            start, sizes = previous.weight, previous.sizes
        self._previous = variational_posterior(
            point, start, sizes=sizes, tolerance=_TOLERANCE, max_iterations=_MAX_ITERATIONS
        )
        return self._previous


class InferredCandidates:
    """Candidates inferred from a recording, whose presses say nothing of other places.

    Args:
        options: Radius of the sensor and number of candidates.
    """

    def __init__(self, options: SuggestOptions) -> None:
        self._options = options
        self._patches: dict[tuple[bytes, float], list[Patch]] = {}

    def __call__(self, recording: Recording) -> Candidates:
        """Return the candidates for an object and its presses.

        Raises:
            ConfigError: there is no patch to press, or the size of the sensor is unknown.
        """
        mesh, presses = recording.mesh, recording.presses
        radius = float(self._options.radius_mm or sensor_radius_mm(mesh, presses))
        held = np.any([press.held.any(axis=1) for press in presses], axis=0)
        key = held.tobytes(), radius
        if key not in self._patches:
            patches = candidate_patches(
                mesh, held, radius, self._options.candidates, min_facing=_MIN_FACING
            )
            self._patches = {key: patches}
        patches = self._patches[key]
        pressed = _pressed(mesh, presses, patches, radius)
        pressure = _pressure_mpa(mesh, presses)
        return Candidates(
            patches,
            pressed if len(pressed) < len(patches) else (),  # all pressed: start over
            lambda patch: _plan(presses[-1], patch, mesh, pressure),
        )


def sensor_radius_mm(mesh: TetMesh, presses: Sequence[Press]) -> float:
    """Return the radius of a disc of the loaded area, at most a quarter of the object's extent.

    Raises:
        ConfigError: no press loads the surface.
    """
    areas = [area for area in (_loaded_mm2(mesh, press) for press in presses) if area > 0]
    if not areas:
        raise ConfigError(
            "no press loads the surface with a force, so the size of the sensor is not known; give "
            "suggest.radius_mm."
        )
    max_radius = _MAX_RADIUS_SHARE * float(np.ptp(mesh.bounds, axis=0).min())
    return min(float(np.sqrt(np.median(areas) / np.pi)), max_radius)


def _loaded_mm2(mesh: TetMesh, press: Press) -> float:
    return float(mesh.vertex_areas[press.forces.any(axis=1)].sum())


def _pressure_mpa(mesh: TetMesh, presses: Sequence[Press]) -> float:
    """Median pressure of the presses; 0 if none has a force."""
    pressures = [
        float(np.linalg.norm(press.total_force)) / area
        for press in presses
        if (area := _loaded_mm2(mesh, press)) > 0
    ]
    return float(np.median(pressures)) if pressures else 0.0


def _plan(last: Press, patch: Patch, mesh: TetMesh, pressure_mpa: float) -> Press:
    """Press on a patch, fixed as the last press and observed where it loads."""
    unit = patch.forces(mesh)
    forces = pressure_mpa * unit
    return replace(
        last,
        forces=forces,
        observed=np.repeat(np.any(unit != 0.0, axis=1)[:, None], 3, axis=1),
        displacement=np.zeros_like(forces),
        prescribed=np.zeros_like(forces),
        weights=None,
        direction=None,
        name="",
    )


def _pressed(
    mesh: TetMesh, presses: Sequence[Press], patches: Sequence[Patch], radius_mm: float
) -> tuple[int, ...]:
    """Candidates whose centre is within half a radius of a press."""
    centers = np.array([patch.center for patch in patches])
    pressed: list[int] = []
    for press in presses:
        distances = np.linalg.norm(centers - _contact_center_mm(mesh, press), axis=1)
        nearest = int(distances.argmin())
        if distances[nearest] <= 0.5 * radius_mm and nearest not in pressed:
            pressed.append(nearest)
    return tuple(pressed)


def _contact_center_mm(mesh: TetMesh, press: Press) -> Float[np.ndarray, "3"]:
    """Force-weighted centre of a press; centre of the observed nodes if it has no force."""
    weights = np.linalg.norm(press.forces, axis=1)
    weights = weights if weights.any() else press.observed.any(axis=1).astype(float)
    return weights @ mesh.points / weights.sum()
