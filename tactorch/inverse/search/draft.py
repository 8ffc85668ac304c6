"""A fast search for balls in presses that come one after the other, for decisions during a session.

`find_shapes` corrects its predictions by finer meshes at every model that it accepts, which takes
minutes. Here the error of the discretisation is estimated once for each press, at a uniform body,
and subtracted from the data; a part of it stays as an error of the data. Models are balls in a
uniform background. Each search starts from the last one.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from tactorch.fem import NewtonOptions, SoftBody
from tactorch.inverse.errors import ErrorModel, MeasuredPresses
from tactorch.inverse.fields import ShapePrior, Sites
from tactorch.inverse.fit.settings import Settings
from tactorch.inverse.fit.starts import uniform_fit
from tactorch.inverse.forward.predictions import Predictions
from tactorch.inverse.forward.problem import InverseProblem
from tactorch.inverse.forward.reduced import ReducedProblem
from tactorch.inverse.posterior.shapes import ShapePosterior
from tactorch.inverse.result.shapes import ShapeReconstruction
from tactorch.inverse.search.base import SearchProblem
from tactorch.inverse.search.draft_errors import (
    DraftOptions,
    FinePrediction,
    PressErrors,
    with_errors,
)
from tactorch.inverse.search.matched import MatchedFilter
from tactorch.inverse.search.model import Model, Start, TimeLimit
from tactorch.inverse.search.proposals import further, removed
from tactorch.inverse.search.search import search
from tactorch.recording import Recording
from tactorch.recording.append import digest

_RTOL, _DERIVATIVE_RTOL = 1e-5, 5e-3
_MAX_SHAPES = 2


class _Presses(SearchProblem):
    """The presses of one search, see `SearchProblem`; errors of their data are known."""

    proposals = (further, removed)
    rival_share, tolerance, max_alternatives = 1.0, 0.2, 0

    def __init__(
        self,
        full: InverseProblem,
        reduced: ReducedProblem,
        prior: ShapePrior,
        moved: list[Float[np.ndarray, "nodes 3"]],
        pose_mm: float,
        stop: Callable[[], bool],
    ) -> None:
        super().__init__(stop, _MAX_SHAPES)
        self.full, self.reduced, self.prior = full, reduced, prior
        self.sites = Sites.of(full.body.assembly)
        self._reduced_sites = Sites.of(reduced.body.assembly)
        self.matched = MatchedFilter.of(reduced)
        self.errors = ErrorModel(MeasuredPresses(full), ())
        self._moved, self._pose_mm = moved, pose_mm

    def first(self, start: Start) -> Model:
        return self.fit(start, self._moved)  # from the displacements of the last search

    def final(self, model: Model) -> Model:
        return model  # exact enough

    def posterior(self, model: Model) -> tuple[Model, ShapePosterior]:
        """Return the posterior, with the error of the positions of presses."""
        _, posterior = super().posterior(model)
        return model, posterior.misplaced(self._pose_mm)


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
        self._known: dict[str, tuple[PressErrors, ReducedProblem]] = {}  # of each press
        self._moved: dict[str, np.ndarray] = {}  # displacements of each press at the last model
        self._prior: ShapePrior | None = None

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
        limit = TimeLimit(self._settings.max_seconds, stop)
        keys = [digest(press) for press in recording.presses]
        model, result = search(self._prepare(recording, keys, limit), limit, start)
        self._moved = dict(zip(keys, model.evaluation.displacements, strict=True))
        return replace(result, predictions=Predictions.of(model.evaluation, recording))

    def _prepare(self, recording: Recording, keys: list[str], stop: TimeLimit) -> _Presses:
        quadratic, options = self._problem(recording, "tet10"), self._options
        if self._prior is None:
            youngs = uniform_fit(quadratic, self._settings.bounds).youngs_mpa
            self._prior = ShapePrior.of(recording.mesh, youngs)
        youngs = float(np.exp(self._prior.log_background))
        predict, observations = self._fine_prediction, quadratic.data.observations
        for k, key in enumerate(keys):
            if key not in self._known:
                one = self._problem(recording.select([k]), "tet4")
                fine = None if predict is None else predict(recording.presses[k], youngs)
                error = PressErrors.of(observations[k], fine)
                self._known[key] = error, ReducedProblem.about_uniform(one, youngs)
        errors, reduced = zip(*(self._known[key] for key in keys), strict=True)
        linear = self._problem(recording, "tet4")
        rest = np.zeros((quadratic.body.n_nodes, 3))
        return _Presses(
            quadratic.with_data(with_errors(quadratic, errors, options)),
            ReducedProblem.joined(linear, reduced),
            self._prior, [self._moved.get(key, rest) for key in keys],
            options.pose_deviation_mm, stop,
        )  # fmt: skip

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
