"""Where to press next, by the rules of active sampling, from presses that somebody else made.

A robot's presses tell where it pressed, but not where else it might: candidates are patches of the
sensor's size over what was never held of the surface, pressed as hard as before and held as in the
last press.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError
from tactorch.inverse import Point, Settings
from tactorch.mesh import TetMesh
from tactorch.recording import Press
from tactorch.sampling.candidate_jacobians import credibilities, foretold
from tactorch.sampling.candidates import Patch, candidate_patches
from tactorch.sampling.rules import ExpectedError, LargestUncertainty, SamplingState
from tactorch.uncertainty.gaussian import GaussianPosterior
from tactorch.uncertainty.gaussian_state import GaussianState
from tactorch.uncertainty.laplace import LaplacePosterior
from tactorch.uncertainty.variational import (
    VariationalPosterior,
    has_variational_posterior,
    variational_posterior,
)

RULES = ("auto", "expected_error", "largest_uncertainty", "none")
# Elements up to which a dense posterior takes seconds.
_DENSE = 4_000
# Of the posterior: it need not be exact to compare places by it, and begins at the last one.
_ROUNDS, _TOLERANCE = 12, 0.1
_SQUARE = 0.85  # how squarely a place faces the sensor; an edge of a cube has 0.71
_LARGEST_SHARE = 0.25  # of the object's least extent, of a sensor whose size is not given


@dataclass(frozen=True)
class SuggestOptions:
    """How places are suggested.

    Attributes:
        rule: "expected_error", which takes a dense posterior; "largest_uncertainty", the paper's;
            "auto", the former up to 4,000 elements; or "none".
        radius_mm: Of the sensor; None for what the presses loaded, at most a quarter of the
            object's least extent.
        candidates: How many places are compared.
    """

    rule: str = "auto"
    radius_mm: float | None = None
    candidates: int = 24

    def __post_init__(self) -> None:
        """Check ranges."""
        if self.rule not in RULES:
            raise ConfigError(f"suggest.rule={self.rule} is unknown; choose {', '.join(RULES)}.")
        if self.radius_mm is not None and not self.radius_mm > 0:
            raise ConfigError(f"suggest.radius_mm={self.radius_mm}: give a radius above 0 mm.")
        if self.candidates < 1:
            raise ConfigError(f"suggest.candidates={self.candidates}: compare at least 1 place.")


@dataclass(frozen=True, eq=False)
class Suggestion:
    """Where to press next, and how sure the map is.

    Attributes:
        patch: The place; None where there is none to suggest.
        why_not: Why there is none.
        rule: What has chosen.
        deviation: Of each log-modulus (by default) under the posterior; None where the rule
            takes none.
        seconds: It took.
    """

    patch: Patch | None
    why_not: str
    rule: str
    deviation: Float[np.ndarray, " m"] | None
    seconds: float


class Suggester:
    """Suggests places, from press to press."""

    def __init__(self, settings: Settings, options: SuggestOptions | None = None) -> None:
        """Take the settings of the inversions."""
        self.options = options or SuggestOptions()
        self._settings = settings
        self._places: tuple[tuple[bytes, float], list[Patch] | str] = ((b"", 0.0), "")
        self._before: VariationalPosterior | None = None

    def suggest(
        self, point: Point, weight: float, stop: Callable[[], bool] = lambda: False
    ) -> Suggestion | None:
        """Suggest the next place; None where it was stopped.

        Args:
            point: Where the inversion of all presses so far has ended.
            weight: Of the prior there.
            stop: Asked between the parts of the work whether to leave the rest.
        """
        began = time.perf_counter()
        presses = point.objective.problem.recording.presses
        mesh = point.objective.problem.recording.mesh
        rule, posterior = self._rule(mesh, presses), None
        patch, why_not = None, "it was not asked for"
        try:
            if rule == "expected_error":
                posterior = self._posterior(point, weight)
            if stop():
                return None
            if rule != "none":
                patch, why_not = self._choose(rule, point, posterior)
        except ConfigError as error:
            patch, why_not = None, str(error)
        deviation = None if posterior is None else posterior.deviation()
        return Suggestion(patch, why_not, rule, deviation, time.perf_counter() - began)

    def _rule(self, mesh: TetMesh, presses: Sequence[Press]) -> str:
        """The rule by its name, where "auto" goes by size, and by whether a force is known."""
        if self.options.rule != "auto":
            return self.options.rule
        foreseen = mesh.n_tets <= _DENSE and any(press.forces.any() for press in presses)
        return "expected_error" if foreseen else "largest_uncertainty"

    def _posterior(self, point: Point, weight: float) -> GaussianPosterior:
        if not has_variational_posterior(point, weight):
            return LaplacePosterior.at(point, weight)
        before = self._before
        if before is None or len(before.mean) != len(point.elements):
            first, sizes = weight, None
        else:
            first, sizes = before.weight, before.sizes
        self._before = variational_posterior(
            point, first, sizes=sizes, tolerance=_TOLERANCE, max_iterations=_ROUNDS
        )
        return self._before

    def _choose(
        self, rule: str, point: Point, posterior: GaussianPosterior | None
    ) -> tuple[Patch | None, str]:
        recording = point.objective.problem.recording
        mesh, presses = recording.mesh, recording.presses
        radius = self.options.radius_mm or sensor_radius_mm(mesh, presses)
        places = self._candidates(mesh, presses, radius)
        m = mesh.n_tets
        if posterior is None:  # a rule that does not look at what is believed
            belief = GaussianState(point.elements, np.broadcast_to(0.0, (m, m)))
        else:
            belief = GaussianState(posterior.mean, posterior.covariance(np.arange(m)))
        pressed = _pressed(mesh, presses, places, radius)
        pressure = _pressure_mpa(mesh, presses)
        plans = [_plan(presses[-1], place, mesh, pressure) for place in places]
        chooser = ExpectedError() if rule == "expected_error" else LargestUncertainty()
        best = chooser.choose(
            SamplingState(
                mesh=mesh,
                candidates=places,
                # All pressed: again from the first.
                pressed=pressed if len(pressed) < len(places) else (),
                parameterization=point.objective.parameterization,
                belief=belief,
                credibility=credibilities(point),
                jacobians=lambda which: foretold([plans[i] for i in which], point, self._settings),
            )
        )
        return places[best], ""

    def _candidates(self, mesh: TetMesh, presses: Sequence[Press], radius_mm: float) -> list[Patch]:
        """Places that no press was held at: what it stands on cannot be pressed.

        Raises:
            ConfigError: there is none.
        """
        held = np.any([press.held.any(axis=1) for press in presses], axis=0)
        key = held.tobytes(), float(radius_mm)
        if self._places[0] != key:
            try:
                found = candidate_patches(
                    mesh, held, float(radius_mm), self.options.candidates, min_facing=_SQUARE
                )
                self._places = key, found
            except ConfigError as error:
                self._places = key, str(error)
        places = self._places[1]
        if isinstance(places, str):
            raise ConfigError(places)
        return places


def sensor_radius_mm(mesh: TetMesh, presses: Sequence[Press]) -> float:
    """Return the radius of a disc as large as what a press loads, at most a quarter of the object.

    Raises:
        ConfigError: no press loads the surface.
    """
    areas = [area for area in (_loaded_mm2(mesh, press) for press in presses) if area > 0]
    if not areas:
        raise ConfigError(
            "no press loads the surface with a force, so the size of the sensor is not known; give "
            "suggest.radius_mm."
        )
    most = _LARGEST_SHARE * float(np.ptp(mesh.bounds, axis=0).min())
    return min(float(np.sqrt(np.median(areas) / np.pi)), most)


def _loaded_mm2(mesh: TetMesh, press: Press) -> float:
    return float(mesh.vertex_areas[press.forces.any(axis=1)].sum())


def _pressure_mpa(mesh: TetMesh, presses: Sequence[Press]) -> float:
    """Median pressure of the presses; 0 where none has a force."""
    pressures = [
        float(np.linalg.norm(press.total_force)) / area
        for press in presses
        if (area := _loaded_mm2(mesh, press)) > 0
    ]
    return float(np.median(pressures)) if pressures else 0.0


def _plan(last: Press, place: Patch, mesh: TetMesh, pressure_mpa: float) -> Press:
    """A press there, held as the last one and seen where it loads."""
    unit = place.forces(mesh)
    forces = pressure_mpa * unit
    seen = np.repeat(np.any(unit != 0.0, axis=1)[:, None], 3, axis=1)
    return replace(
        last,
        forces=forces,
        observed=seen,
        displacement=np.zeros_like(forces),
        prescribed=np.zeros_like(forces),
        weights=None,
        direction=None,
        name="",
    )


def _pressed(
    mesh: TetMesh, presses: Sequence[Press], places: Sequence[Patch], radius_mm: float
) -> tuple[int, ...]:
    """Candidates whose middle lies within half a radius of where a press was."""
    centers = np.array([place.center for place in places])
    found: list[int] = []
    for press in presses:
        gaps = np.linalg.norm(centers - contact_center_mm(mesh, press), axis=1)
        near = int(gaps.argmin())
        if gaps[near] <= 0.5 * radius_mm and near not in found:
            found.append(near)
    return tuple(found)


def contact_center_mm(mesh: TetMesh, press: Press) -> Float[np.ndarray, "3"]:
    """Return the middle of a press's forces, mm; of what was seen where it has none."""
    weights = np.linalg.norm(press.forces, axis=1)
    weights = weights if weights.any() else press.observed.any(axis=1).astype(float)
    return weights @ mesh.points / weights.sum()
