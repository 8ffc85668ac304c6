"""A fast search for balls in presses that come one after the other, for decisions during a session.

`find_shapes` corrects its predictions by finer meshes at every model that it accepts, which takes
minutes. Here the error of the discretisation is estimated once for each press, at a uniform body,
and subtracted from the data; a part of it stays as an error of the data. Models are balls in a
uniform background. Each fit starts from the last one, and further balls from the matched filter.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float

from tactorch.errors import CancelledError, ConvergenceError
from tactorch.fem import NewtonOptions, SoftBody
from tactorch.inverse.data import DataModel, rigid_patterns
from tactorch.inverse.problem import Evaluation, InverseProblem
from tactorch.inverse.settings import Settings
from tactorch.inverse.shapes.field import ShapeField, ShapePrior, Sites
from tactorch.inverse.shapes.fit import ShapeFit, fit_shapes
from tactorch.inverse.shapes.matched import Balls, MatchedFilter
from tactorch.inverse.shapes.model import (
    MAX_LOG_ODDS,
    MIN_CANDIDATE_GAIN,
    MIN_GAIN,
    Errors,
    Model,
    gain,
    make_posterior,
    moderate,
    record,
    unexplained,
    with_ball,
    without,
)
from tactorch.inverse.shapes.result import ShapeReconstruction
from tactorch.inverse.starts import uniform_fit
from tactorch.recording import Press, Recording
from tactorch.recording.append import digest

#: Nodal displacements of a press at a uniform modulus (MPa), by a finer mesh and by the recording's
#: mesh with quadratic elements, each (n, 3), mm; None where they are not known.
FinePrediction: TypeAlias = Callable[
    [Press, float], tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]] | None
]

_RTOL, _DERIVATIVE_RTOL = 1e-5, 5e-3
_STARTS = 2  # fits of a further ball
_TOLERANCE, _MAX_ITERATIONS = 0.2, 8  # of fits, see `fit_shapes`
_SCALE_DEVIATION = 0.01  # of the displacements of a press: errors of force and material
_RIGID_DEVIATION = 0.02  # lateral errors of the pose near edges of the object have this size
_MODEL_DEVIATION = 0.01
_REMAINING = 0.2  # part of the discretisation's error that remains after its correction


@dataclass(frozen=True)
class DraftOptions:
    """Errors that a draft search takes into account beside the noise.

    Attributes:
        pose_deviation_mm: Standard deviation of the reported position of a press, mm, which adds to
            the uncertainty of centres.
        rigid_deviation: Standard deviation of rigid motions at a contact, over its displacements.
        scale_deviation: Relative standard deviation of the displacements of a press as a whole.
        remaining: Part of the discretisation's error that remains after its correction.
        model_deviation: Least noise of the displacements, over their root mean square: what the
            finer mesh and the interpolation to the nodes leave. On a uniform cube it is 1 %.
        max_shapes: Largest number of balls.
    """

    pose_deviation_mm: float = 0.0
    rigid_deviation: float = _RIGID_DEVIATION
    scale_deviation: float = _SCALE_DEVIATION
    remaining: float = _REMAINING
    model_deviation: float = _MODEL_DEVIATION
    max_shapes: int = 2


class _Known(NamedTuple):
    """What is computed once for a press."""

    error: Float[np.ndarray, " data"]  # of the discretisation, mm
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
        if start is not None and start.field.distorted:
            with suppress(ConvergenceError):
                field = replace(start.field, prior=search.prior)
                z = field.standard(start.field.physical(start.z))
                models.append(search.fitted(field, z))
        best = _best(models)
        while len(best.fit.field.distorted) < self._options.max_shapes:
            further = search.further(best)
            if _best([best, *further]) is best:
                break
            best = _best([best, *further])
        self._moved = dict(zip(search.keys, best.evaluation.displacements, strict=True))
        return search.result(best, models[0], self._options.pose_deviation_mm)

    def _uniform_z(self, search: "_Search", start: ShapeReconstruction | None) -> np.ndarray:
        """Return the parameter of the background from which the uniform body is fitted."""
        if start is None:
            return np.zeros(1)
        log = start.field.physical(start.z)[0]
        return ShapeField(search.prior).standard(np.array([log]))

    def _prepare(self, recording: Recording, stop: Callable[[], bool]) -> "_Search":
        linear, quadratic = self._problem(recording, "tet4"), self._problem(recording, "tet10")
        if self._prior is None or self._balls is None:
            youngs = uniform_fit(quadratic, self._settings.bounds).youngs_mpa
            self._prior = ShapePrior.of(recording.mesh, youngs)
            self._balls = Balls.of(recording.mesh)
        youngs = float(np.exp(self._prior.log_background))
        keys = [digest(press) for press in recording.presses]
        new = [k for k, key in enumerate(keys) if key not in self._known]
        if new:
            errors = [self._error(quadratic, k, youngs) for k in new]
            responses = _responses(linear, new, youngs, self._balls)
            pairs = zip(errors, responses, strict=True)
            self._known |= {keys[k]: _Known(*pair) for k, pair in zip(new, pairs, strict=True)}
        known = [self._known[key] for key in keys]
        problem = quadratic.with_data(self._data(quadratic, known))
        rest = np.zeros((quadratic.body.n_nodes, 3))
        moved = [self._moved.get(key, rest) for key in keys]
        matched = MatchedFilter(
            self._balls.centers, self._balls.radii, np.vstack([one.responses for one in known])
        )
        return _Search(problem, self._prior, matched, moved, keys, stop)

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

    def _error(self, problem: InverseProblem, k: int, youngs: float) -> np.ndarray:
        """Return the error of a press, in proportion to its displacements (mm)."""
        observation, press = problem.data.observations[k], problem.recording.presses[k]
        predicted = None if self._fine_prediction is None else self._fine_prediction(press, youngs)
        if predicted is None:
            return np.zeros(len(observation.values))
        better, present = (u.ravel()[observation.index] for u in predicted)
        relative = max(float(better @ observation.values), 0.0) / float(better @ better)
        return relative * (better - present)

    def _data(self, problem: InverseProblem, known: Sequence[_Known]) -> DataModel:
        """Return the data without the discretisation's error, and with errors in common."""
        observations, options = problem.data.observations, self._options
        columns = []
        for k, (observation, one) in enumerate(zip(observations, known, strict=True)):
            for pattern, size in (
                (one.error, options.remaining),
                (observation.values, options.scale_deviation),
            ):
                parts = [np.zeros(len(o.values)) for o in observations]
                parts[k] = size * pattern
                columns.append(np.concatenate(parts) * problem.data.scale)
        data = problem.data.shifted([-one.error for one in known])
        data = data.with_errors(np.column_stack(columns))
        each = [(k,) for k in range(len(observations))]
        patterns = rigid_patterns(problem.recording.mesh.points, observations, each)
        return data.with_errors(options.rigid_deviation * patterns)


@dataclass(frozen=True, eq=False)
class _Search:
    """The presses of one search."""

    problem: InverseProblem
    prior: ShapePrior
    matched: MatchedFilter
    moved: list[Float[np.ndarray, "nodes 3"]]  # displacements from which equilibria start
    keys: list[str]
    stop: Callable[[], bool]

    def fitted(
        self, field: ShapeField, z: np.ndarray, evaluation: Evaluation | None = None
    ) -> Model:
        if self.stop():
            raise CancelledError("The search for inclusions was stopped before it had a result.")
        starts = self.moved if evaluation is None else evaluation.displacements
        fit, reached = fit_shapes(
            self.problem, field, z, sites=self._sites, starts=starts, tolerance=_TOLERANCE,
            max_iterations=_MAX_ITERATIONS,
        )  # fmt: skip
        return Model(fit, reached, Errors(0.0, 0.0))

    @cached_property
    def _sites(self) -> Sites:
        return Sites.of(self.problem.body.assembly)

    def further(self, model: Model) -> list[Model]:
        """Return fits of the model with a further ball where the residuals show one."""
        fit, data, models = model.fit, self.problem.data, []
        for candidate in self.matched.best(fit.residuals, fit.jacobian, data, _STARTS):
            if candidate.gain < MIN_CANDIDATE_GAIN:
                break
            _, field, z = with_ball(fit, candidate)
            with suppress(ConvergenceError):
                z = moderate(field, z)
                models.append(self.fitted(field, z, model.evaluation))
        return models

    def result(self, model: Model, uniform: Model, pose_mm: float) -> ShapeReconstruction:
        """Return a model with its posterior, and the evidence of its balls."""
        fit, count = model.fit, len(model.fit.field.distorted)
        odds = [self._log_odds(model, uniform, k) for k in range(count)]
        inflation = max(1.0, fit.chi2)
        any_odds = fit.log_evidence(inflation) - uniform.fit.log_evidence(inflation)
        posterior = make_posterior(model, self._sites)
        covariance = posterior.covariance.copy()
        added = (pose_mm / self.prior.ball()[1][:3]) ** 2  # centres come first
        for part in posterior.field.parts:
            center = np.arange(part.start, part.start + 3)
            covariance[center, center] += added
        return ShapeReconstruction(
            fit.field, fit.z, replace(posterior, covariance=covariance), fit.chi2,
            tuple(odds), min(any_odds, MAX_LOG_ODDS) if count else 0.0,
            unexplained=unexplained(fit, self.problem.data),
            history=(record("draft", fit),),
        )  # fmt: skip

    def _log_odds(self, model: Model, uniform: Model, k: int) -> float:
        """Return the log-evidence over that of the model without a ball."""
        rival = uniform
        if len(model.fit.field.distorted) > 1:
            rival = self.fitted(*without(model.fit.field, model.fit.z, [k]), model.evaluation)
        inflation = max(1.0, model.fit.chi2)
        odds = model.fit.log_evidence(inflation) - rival.fit.log_evidence(inflation)
        return min(odds, MAX_LOG_ODDS)


def _responses(
    problem: InverseProblem, chosen: Sequence[int], youngs: float, balls: Balls
) -> list[np.ndarray]:
    """Return the change of the residuals of some presses by balls of unit log-contrast."""
    recording = problem.recording.select(chosen)
    part = InverseProblem(recording, noise=problem.noise, body=problem.body)
    jacobian = part.evaluate(np.full(recording.mesh.n_tets, youngs)).jacobian() * youngs
    return np.split(jacobian @ balls.fractions, part.data.begins[1:])


def _best(models: Sequence[Model]) -> Model:
    """Return the model of the most evidence; further balls must raise it by enough."""
    best = models[0]
    for model in models[1:]:
        added = len(model.fit.field.distorted) > len(best.fit.field.distorted)
        if _is_better(model.fit, best.fit, MIN_GAIN if added else 0.0):
            best = model
    return best


def _is_better(fit: ShapeFit, rival: ShapeFit, least: float) -> bool:
    return gain(fit, rival) > least
