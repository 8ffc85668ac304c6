"""A fast search for balls in presses that come one after the other, for decisions during a session.

`find_shapes` corrects its predictions by finer meshes at every model that it accepts, which takes
minutes. Here the error of the discretisation is estimated once for each press, at a uniform body,
and subtracted from the data; a part of it stays as an error of the data. Models are balls in a
uniform background. Each fit starts from the last one, and further balls from the matched filter.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConvergenceError
from tactorch.fem import NewtonOptions, SoftBody
from tactorch.inverse.fields import ShapeField, ShapePrior
from tactorch.inverse.fit.settings import Settings
from tactorch.inverse.fit.starts import uniform_fit
from tactorch.inverse.forward.problem import InverseProblem
from tactorch.inverse.result.shapes import ShapeReconstruction
from tactorch.inverse.search.draft_errors import (
    DraftOptions,
    FinePrediction,
    Prediction,
    PressErrors,
    with_errors,
)
from tactorch.inverse.search.draft_search import DraftSearch, best_model
from tactorch.inverse.search.matched import Balls, MatchedFilter
from tactorch.recording import Recording
from tactorch.recording.append import digest

__all__ = ["DraftOptions", "DraftShapes", "FinePrediction", "Prediction"]

_RTOL, _DERIVATIVE_RTOL = 1e-5, 5e-3


class _Known(NamedTuple):
    """What is computed once for a press."""

    errors: PressErrors
    responses: Float[np.ndarray, "data balls"]  # to balls of unit log-contrast, whitened by noise


class DraftShapes:
    """A search for balls in growing presses on one object.

    Args:
        settings: Noise, solver and bounds are used.
        fine_prediction: Predictions of a finer mesh, for the error of the discretisation, which is
            not corrected by default.
        options: Errors of the data.
    """

    def __init__(
        self,
        settings: Settings | None = None,
        fine_prediction: FinePrediction | None = None,
        options: DraftOptions | None = None,
    ) -> None:
        self._settings, self._fine_prediction = settings or Settings(), fine_prediction
        self._options = options or DraftOptions()
        self._bodies: dict[str, SoftBody] = {}
        self._known: dict[str, _Known] = {}
        self._moved: dict[str, np.ndarray] = {}  # displacements of each press at the last model
        self._prior: ShapePrior | None = None
        self._balls: Balls | None = None

    def fit(
        self,
        recording: Recording,
        start: ShapeReconstruction | None = None,
        stop: Callable[[], bool] = lambda: False,
    ) -> ShapeReconstruction:
        """Return the balls that the presses determine, as many as the evidence supports.

        Args:
            recording: All presses, of which most were there in the last call.
            start: Shapes of fewer presses.
            stop: Called between fits; where it is true, `CancelledError` is raised.

        Raises:
            CancelledError: see `stop`.
            ConvergenceError: a press has no equilibrium at the best uniform modulus.
        """
        search = self._prepare(recording, stop)
        models = [search.fitted(ShapeField(search.prior), self._uniform_z(search, start))]
        if start is not None and start.field.families:
            with suppress(ConvergenceError):
                models.append(search.fitted(*start.field.changed(start.z, prior=search.prior)))
        best = best_model(models)
        while len(best.fit.field.families) < self._options.max_shapes:
            further = search.further(best)
            if best_model([best, *further]) is best:
                break
            best = best_model([best, *further])
        self._moved = dict(zip(search.keys, best.evaluation.displacements, strict=True))
        return search.result(best, models[0], self._options.pose_deviation_mm)

    def _uniform_z(self, search: DraftSearch, start: ShapeReconstruction | None) -> np.ndarray:
        """Return the parameter of the background from which the uniform body is fitted."""
        if start is None:
            return np.zeros(1)
        log = start.field.physical(start.z)[start.field.background.level]
        return ShapeField(search.prior).standard(np.array([log]))

    def _prepare(self, recording: Recording, stop: Callable[[], bool]) -> DraftSearch:
        linear, quadratic = self._problem(recording, "tet4"), self._problem(recording, "tet10")
        if self._prior is None or self._balls is None:
            youngs = uniform_fit(quadratic, self._settings.bounds).youngs_mpa
            self._prior = ShapePrior.of(recording.mesh, youngs)
            self._balls = Balls.of(recording.mesh)
        youngs = float(np.exp(self._prior.log_background))
        keys = [digest(press) for press in recording.presses]
        new = [k for k, key in enumerate(keys) if key not in self._known]
        if new:
            responses = _responses(linear, new, youngs, self._balls)
            for k, response in zip(new, responses, strict=True):
                self._known[keys[k]] = _Known(self._errors(quadratic, k, youngs), response)
        known = [self._known[key] for key in keys]
        errors = [one.errors for one in known]
        problem = quadratic.with_data(with_errors(quadratic, errors, self._options))
        rest = np.zeros((quadratic.body.n_nodes, 3))
        moved = [self._moved.get(key, rest) for key in keys]
        balls, stacked = self._balls, np.vstack([one.responses for one in known])
        matched = MatchedFilter(balls.centers, balls.radii, balls.halves, stacked)
        return DraftSearch(problem, self._prior, matched, moved, keys, stop)

    def _errors(self, problem: InverseProblem, k: int, youngs: float) -> PressErrors:
        observation, press = problem.data.observations[k], problem.recording.presses[k]
        predict = self._fine_prediction
        return PressErrors.of(observation, None if predict is None else predict(press, youngs))

    def _problem(self, recording: Recording, element: str) -> InverseProblem:
        settings, least = self._settings, self._options.model_deviation
        noise = replace(settings.noise, relative=max(settings.noise.relative, least))
        problem = InverseProblem(
            recording, element=element, solver=settings.solver, noise=noise,
            newton=NewtonOptions(rtol=_RTOL), body=self._bodies.get(element),
            derivative_rtol=_DERIVATIVE_RTOL if element == "tet10" else 0.0,
        )  # fmt: skip
        self._bodies[element] = problem.body
        return problem


def _responses(
    problem: InverseProblem, chosen: Sequence[int], youngs: float, balls: Balls
) -> list[np.ndarray]:
    """Return the change of the residuals of some presses by balls of unit log-contrast."""
    recording = problem.recording.select(chosen)
    part = InverseProblem(recording, noise=problem.noise, body=problem.body)
    jacobian = part.evaluate(np.full(recording.mesh.n_tets, youngs)).jacobian() * youngs
    return np.split(jacobian @ balls.fractions, part.data.begins[1:])
