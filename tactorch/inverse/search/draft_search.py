"""The search for balls in the presses that a session has so far, see `draft`."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float

from tactorch.errors import CancelledError, ConvergenceError
from tactorch.inverse.fields import CENTER, ShapeField, ShapePrior, Sites
from tactorch.inverse.fit.shapes import ShapeFit, fit_shapes
from tactorch.inverse.forward.problem import Evaluation, InverseProblem
from tactorch.inverse.result.shapes import ShapeReconstruction
from tactorch.inverse.search.matched import MatchedFilter
from tactorch.inverse.search.model import (
    MAX_LOG_ODDS,
    MIN_CANDIDATE_GAIN,
    MIN_GAIN,
    Model,
    gain,
    make_posterior,
    moderate,
    record,
    unexplained,
    with_ball,
    with_predictions,
    without,
)

_STARTS = 2  # fits of a further ball
_TOLERANCE, _MAX_ITERATIONS = 0.2, 8  # of fits, see `fit_shapes`


@dataclass(frozen=True, eq=False)
class DraftSearch:
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
        """Return the model of a field, fitted from `z` and the displacements of an evaluation.

        Raises:
            CancelledError: `stop` returned True.
            ConvergenceError: a press has no equilibrium at `z`.
        """
        if self.stop():
            raise CancelledError("The search for inclusions was stopped before it had a result.")
        starts = self.moved if evaluation is None else evaluation.displacements
        fit, reached = fit_shapes(
            self.problem, field, z, sites=self._sites, starts=starts, tolerance=_TOLERANCE,
            max_iterations=_MAX_ITERATIONS,
        )  # fmt: skip
        return Model(fit, reached, {})

    @cached_property
    def _sites(self) -> Sites:
        return Sites.of(self.problem.body.assembly)

    def further(self, model: Model) -> list[Model]:
        """Return fits of the model with a further ball where the residuals show one."""
        fit, models = model.fit, []
        matched = self.matched.whitened(self.problem.data)
        for candidate in matched.best(fit.residuals, fit.jacobian, _STARTS):
            if candidate.gain < MIN_CANDIDATE_GAIN:
                break
            _, field, z = with_ball(fit, candidate)
            with suppress(ConvergenceError):
                z = moderate(field, z)
                models.append(self.fitted(field, z, model.evaluation))
        return models

    def result(self, model: Model, uniform: Model, pose_mm: float) -> ShapeReconstruction:
        """Return a model with its posterior, and the evidence of its balls."""
        fit, count = model.fit, len(model.fit.field.families)
        odds = [self._log_odds(model, uniform, k) for k in range(count)]
        inflation = max(1.0, fit.chi2)
        any_odds = fit.log_evidence(inflation) - uniform.fit.log_evidence(inflation)
        posterior = make_posterior(model, self._sites)
        covariance = posterior.covariance.copy()
        for k in range(count):
            center = posterior.field.index(k, *CENTER)
            covariance[center, center] += (pose_mm / posterior.field.deviation[center]) ** 2
        result = ShapeReconstruction(
            fit.field, fit.z, replace(posterior, covariance=covariance), fit.chi2,
            tuple(odds), min(any_odds, MAX_LOG_ODDS) if count else 0.0,
            unexplained=unexplained(fit, self.problem.data),
            history=(record("draft", fit),),
        )  # fmt: skip
        return with_predictions(result, model, self.problem.recording)

    def _log_odds(self, model: Model, uniform: Model, k: int) -> float:
        """Return the log-evidence over that of the model without a ball."""
        rival = uniform
        if len(model.fit.field.families) > 1:
            rival = self.fitted(*without(model.fit.field, model.fit.z, [k]), model.evaluation)
        inflation = max(1.0, model.fit.chi2)
        odds = model.fit.log_evidence(inflation) - rival.fit.log_evidence(inflation)
        return min(odds, MAX_LOG_ODDS)


def best_model(models: Sequence[Model]) -> Model:
    """Return the model of the most evidence; further balls must raise it by enough."""
    best = models[0]
    for model in models[1:]:
        added = len(model.fit.field.families) > len(best.fit.field.families)
        if _is_better(model.fit, best.fit, MIN_GAIN if added else 0.0):
            best = model
    return best


def _is_better(fit: ShapeFit, rival: ShapeFit, least: float) -> bool:
    return gain(fit, rival) > least
