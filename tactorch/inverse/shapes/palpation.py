"""The search for inclusions under the presses of a palpation.

A round adds the ball that the matched filter sees in the residuals, lets the background vary, or
makes a ball an ellipsoid. The models that promise most evidence by linearised predictions are
fitted, and the first whose evidence is larger is kept. The body is linear, so that predictions need
no correction at the contacts (see `tactorch.fem.indentation`).
"""

import logging
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from tactorch.errors import CancelledError
from tactorch.inverse.palpation import PalpationProblem
from tactorch.inverse.settings import Settings
from tactorch.inverse.shapes.field import ShapeField, ShapePrior, Sites
from tactorch.inverse.shapes.fit import ShapeFit, ShapesOnSites, fit_shapes
from tactorch.inverse.shapes.matched import MatchedFilter
from tactorch.inverse.shapes.model import (
    DEGREES,
    MAX_LOG_ODDS,
    MIN_CANDIDATE_GAIN,
    Errors,
    Model,
    as_ellipsoid,
    falls_short,
    gain,
    make_posterior,
    record,
    unexplained,
    varied,
    with_ball,
    without,
)
from tactorch.inverse.shapes.result import ShapeReconstruction, ShapeState
from tactorch.recording import Recording

_log = logging.getLogger(__name__)
_STARTS = 2  # balls that are tried in a round
_ROUGH, _FINE = 0.5, 0.05  # tolerances of fits
_MAX_STEPS = 12  # of a fit
_OPTIMISM = 3.0  # falls of the objective over those of its quadratic model, at best
_MAX_FITS = 3  # of a round
# Of the log-evidence, for a model that is accepted: errors of real presses are not independent.
_MIN_GAIN = 10.0
_CERTAIN = 20.0  # log-odds beyond which they need not be known
_NO_ERRORS = Errors(0.0, 0.0)


class _Proposal(NamedTuple):
    """A model to be fitted, and the gain of log-evidence that is expected."""

    what: str
    field: ShapeField
    z: np.ndarray
    promise: float


class _Search:
    """The presses, and the present model."""

    def __init__(self, recording: Recording, settings: Settings, stop: Callable[[], bool]) -> None:
        self.problem = PalpationProblem(
            recording, solver=settings.solver, noise=settings.noise, newton=settings.newton
        )
        self._stop = stop
        self.sites = Sites.of(self.problem.body.assembly)
        youngs = self.problem.contact_mpa
        field = ShapeField(ShapePrior.of(recording.mesh, youngs))
        self.matched = MatchedFilter.of(self.problem, youngs)
        self.history: list[dict[str, Any]] = []
        self._accept("uniform", self._fit(field, np.zeros(field.size)))

    def _fit(
        self,
        field: ShapeField,
        z: np.ndarray,
        tolerance: float = _ROUGH,
        *,
        rival: ShapeFit | None = None,
        margin: float = 0.0,
    ) -> Model:
        """Fit a model, as far as it may have at most so much less evidence than a rival."""

        def give_up(fit: ShapeFit, fall: float) -> bool:
            self._check(fit)
            return rival is not None and falls_short(fit, _OPTIMISM * fall, rival, margin)

        fitted = fit_shapes(
            self.problem, field, z, sites=self.sites, tolerance=tolerance,
            max_iterations=_MAX_STEPS, give_up=give_up,
        )  # fmt: skip
        return Model(*fitted, _NO_ERRORS)

    def _check(self, first: ShapeFit) -> None:
        """Raise `CancelledError` where the search is stopped, with the model that it reached."""
        if self._stop():
            fit = self.model.fit if self.history else first
            error = CancelledError("the search for inclusions was stopped.")
            error.reached = ShapeState(fit.field, fit.z, *_NO_ERRORS)
            raise error

    def _accept(self, what: str, model: Model) -> None:
        self.model = model
        self.history.append(record(what, model.fit))
        _log.info("%s: chi2 %.4g", what, model.fit.chi2)

    def improve(self, max_shapes: int) -> bool:
        """Accept a model of more evidence; return whether there was one."""
        fit = self.model.fit
        for proposal in self._proposals(max_shapes)[:_MAX_FITS]:
            trial = self._fit(proposal.field, proposal.z, rival=fit)
            change = gain(trial.fit, fit)
            _log.info("%s: chi2 %.4g, log-evidence %+.4g", proposal.what, trial.fit.chi2, change)
            if change > _MIN_GAIN:
                self._accept(proposal.what, trial)
                return True
        return False

    def _proposals(self, max_shapes: int) -> list[_Proposal]:
        """Return models that may have more evidence, those that seem to have most first."""
        fit, inflation = self.model.fit, max(1.0, self.model.fit.chi2)
        field, z = fit.field, fit.z
        starts = [
            (f"inclusion {k} as an ellipsoid", *as_ellipsoid(field, z, k))
            for k, distorted in enumerate(field.distorted)
            if not distorted
        ]
        degree = next((degree for degree in DEGREES if degree > field.degree), None)
        if degree is not None:
            starts.append((f"background of degree {degree}", *varied(field, z, degree=degree)))
        found = [_Proposal(*start, self._promise(*start[1:])) for start in starts]
        if len(field.distorted) < max_shapes:
            data = self.problem.data
            found += [
                _Proposal(*with_ball(fit, ball), ball.gain / inflation - MIN_CANDIDATE_GAIN)
                for ball in self.matched.best(fit.residuals, fit.jacobian, data, _STARTS)
            ]
        found = [proposal for proposal in found if proposal.promise > 0.0]
        return sorted(found, key=lambda proposal: -proposal.promise)

    def _promise(self, field: ShapeField, z: np.ndarray) -> float:
        """Return the gain of log-evidence by a linearised fit."""
        fit, inflation = self.model.fit, max(1.0, self.model.fit.chi2)
        self._check(fit)
        jacobian = ShapesOnSites(field, self.sites).at(z).jacobian(self.model.evaluation)
        squares, unit = jacobian.T @ jacobian, np.eye(len(z))
        step = -np.linalg.solve(
            squares / inflation + unit, jacobian.T @ fit.residuals / inflation + z
        )
        left = fit.residuals + jacobian @ step
        misfit = 0.5 * float(left @ left) / inflation + 0.5 * float((z + step) @ (z + step))
        determinant = float(np.linalg.slogdet(squares + unit)[1])
        determinant += self.problem.data.log_determinant
        return -misfit - 0.5 * determinant - fit.log_evidence(inflation)

    def result(self) -> ShapeReconstruction:
        """Fit the model closely, and return it with its posterior."""
        fit = self.model.fit
        self._accept("final fit", self._fit(fit.field, fit.z, _FINE))
        fit = self.model.fit
        count = len(fit.field.parts)
        each = tuple(self._log_odds([k]) for k in range(count))
        whole = each[0] if count == 1 else self._log_odds(range(count)) if count else 0.0
        return ShapeReconstruction(
            fit.field, fit.z, make_posterior(self.model, self.sites), fit.chi2, each, whole,
            unexplained=unexplained(fit, self.problem.data), history=tuple(self.history),
        )  # fmt: skip

    def _log_odds(self, removed: Sequence[int]) -> float:
        """Return the log-evidence over that of the model without some inclusions.

        The fit ends where it is certain that the other model has much less.
        """
        fit = self.model.fit
        field, z = without(fit.field, fit.z, removed)
        trial = self._fit(field, z, rival=fit, margin=_CERTAIN).fit
        inflation = max(1.0, fit.chi2)
        return min(fit.log_evidence(inflation) - trial.log_evidence(inflation), MAX_LOG_ODDS)


def find_palpation_shapes(
    recording: Recording,
    settings: Settings,
    *,
    max_shapes: int,
    max_models: int,
    stop: Callable[[], bool] = lambda: False,
) -> ShapeReconstruction:
    """Find the inclusions under the presses of a palpation; see `find_shapes`."""
    search = _Search(recording, settings, stop)
    for _ in range(max_models):
        if not search.improve(max_shapes):
            break
    return search.result()
