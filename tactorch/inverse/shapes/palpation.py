"""The search for inclusions under the presses of a palpation.

A round adds the ball that the matched filter sees in the residuals, lets the background vary, or
makes a ball an ellipsoid. The models that promise most evidence by linearised predictions are
fitted, and the first whose evidence is larger is kept. The body is
linear, so that predictions need no correction at the contacts (see `tactorch.fem.indentation`).
"""

import logging
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from tactorch.errors import CancelledError
from tactorch.inverse.palpation import PalpationProblem
from tactorch.inverse.problem import Evaluation
from tactorch.inverse.settings import Settings
from tactorch.inverse.shapes.field import ShapeField, ShapePrior, Sites
from tactorch.inverse.shapes.fit import ShapeFit, ShapesOnSites, fit_shapes
from tactorch.inverse.shapes.matched import MatchedFilter
from tactorch.inverse.shapes.model import as_ellipsoid, gain, varied, without
from tactorch.inverse.shapes.posterior import ShapePosterior
from tactorch.inverse.shapes.result import ShapeReconstruction, ShapeState
from tactorch.recording import Recording

_log = logging.getLogger(__name__)
_DEGREES = (2, 4)  # of smooth backgrounds
_MIN_CANDIDATE_GAIN = 8.0  # see `tactorch.inverse.shapes.proposals`
_STARTS = 2  # balls that are tried in a round
_START_CONTRAST = (0.5, 1.5)  # range of the log-contrast of a start
_ROUGH, _FINE = 0.5, 0.05  # tolerances of fits
_MAX_STEPS = 12  # of a fit
_OPTIMISM = 3.0  # falls of the objective over those of its quadratic model, at best
_MAX_FITS = 3  # of a round
# Of the log-evidence, for a model that is accepted: errors of real presses are not independent.
_MIN_GAIN = 10.0
_MAX_LOG_ODDS = 1e6


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
        self.prior = ShapePrior.of(recording.mesh, youngs)
        self.matched = MatchedFilter.of(self.problem, youngs)
        self.history: list[dict[str, Any]] = []
        field = ShapeField(self.prior)
        self.fit, self.evaluation = self._fit(field, np.zeros(field.size), _ROUGH)
        self._record("uniform")

    def _fit(
        self, field: ShapeField, z: np.ndarray, tolerance: float, rival: ShapeFit | None = None
    ) -> tuple[ShapeFit, Evaluation]:
        def give_up(fit: ShapeFit, fall: float) -> bool:
            self._check()
            if rival is None:
                return False
            misfit = max(0.0, fit.misfit - _OPTIMISM * fall)
            best = replace(fit, misfit=misfit, chi2=2.0 * misfit / len(fit.residuals))
            return gain(best, rival) < 0.0

        self._check()
        return fit_shapes(
            self.problem, field, z, sites=self.sites, tolerance=tolerance,
            max_iterations=_MAX_STEPS, give_up=give_up,
        )  # fmt: skip

    def _check(self) -> None:
        if self._stop():
            error = CancelledError("the search for inclusions was stopped.")
            error.reached = ShapeState(self.fit.field, self.fit.z, 0.0, 0.0, 0.0)
            raise error

    def _record(self, what: str) -> None:
        chi2 = self.fit.chi2
        evidence = self.fit.log_evidence(max(1.0, chi2))
        self.history.append({"model": what, "chi2": chi2, "log_evidence": evidence})
        _log.info("%s: chi2 %.4g", what, chi2)

    def improve(self, max_shapes: int) -> bool:
        """Accept a model of more evidence; return whether there was one."""
        for proposal in self._proposals(max_shapes)[:_MAX_FITS]:
            fit, evaluation = self._fit(proposal.field, proposal.z, _ROUGH, self.fit)
            change = gain(fit, self.fit)
            _log.info("%s: chi2 %.4g, log-evidence %+.4g", proposal.what, fit.chi2, change)
            if change > _MIN_GAIN:
                self.fit, self.evaluation = fit, evaluation
                self._record(proposal.what)
                return True
        return False

    def _proposals(self, max_shapes: int) -> list["_Proposal"]:
        """Return models that may have more evidence, those that seem to have most first."""
        field, z = self.fit.field, self.fit.z
        starts = [
            (f"inclusion {k} as an ellipsoid", *as_ellipsoid(field, z, k))
            for k, distorted in enumerate(field.distorted)
            if not distorted
        ]
        degree = next((degree for degree in _DEGREES if degree > field.degree), None)
        if degree is not None:
            starts.append((f"background of degree {degree}", *varied(field, z, degree=degree)))
        found = [_Proposal(*start, self._promise(*start[1:])) for start in starts]
        if len(field.distorted) < max_shapes:
            found += self._balls()
        found = [proposal for proposal in found if proposal.promise > 0.0]
        return sorted(found, key=lambda proposal: -proposal.promise)

    def _promise(self, field: ShapeField, z: np.ndarray) -> float:
        """Return the gain of log-evidence by a linearised fit."""
        self._check()
        jacobian = ShapesOnSites(field, self.sites).at(z).jacobian(self.evaluation)
        residuals, inflation = self.fit.residuals, max(1.0, self.fit.chi2)
        hessian = jacobian.T @ jacobian / inflation + np.eye(len(z))
        step = -np.linalg.solve(hessian, jacobian.T @ residuals / inflation + z)
        left = residuals + jacobian @ step
        misfit = 0.5 * float(left @ left) / inflation + 0.5 * float((z + step) @ (z + step))
        unscaled = jacobian.T @ jacobian + np.eye(len(z))
        determinant = 0.5 * (
            float(np.linalg.slogdet(unscaled)[1]) + self.problem.data.log_determinant
        )
        return -misfit - determinant - self.fit.log_evidence(inflation)

    def _balls(self) -> list["_Proposal"]:
        fit, inflation = self.fit, max(1.0, self.fit.chi2)
        field = replace(fit.field, distorted=(*fit.field.distorted, False))
        proposals = []
        for candidate in self.matched.best(fit.residuals, fit.jacobian, self.problem.data, _STARTS):
            size = np.clip(abs(candidate.log_contrast), *_START_CONTRAST)
            contrast = np.copysign(size, candidate.log_contrast)
            ball = [*candidate.center_mm, np.log(candidate.radius_mm), contrast]
            z = field.standard(np.concatenate([fit.field.physical(fit.z), ball]))
            what = f"ball at {np.round(candidate.center_mm, 1).tolist()} mm"
            promise = candidate.gain / inflation - _MIN_CANDIDATE_GAIN
            proposals.append(_Proposal(what, field, z, promise))
        return proposals

    def result(self) -> ShapeReconstruction:
        """Fit the model closely, and return it with its posterior."""
        self.fit, self.evaluation = self._fit(self.fit.field, self.fit.z, _FINE)
        self._record("final fit")
        fit = self.fit
        observed = np.concatenate([o.values for o in self.problem.data.observations])
        signal = np.mean((observed * self.problem.data.scale) ** 2)
        unexplained = float(np.sqrt(max(fit.chi2 - 1.0, 0.0) / signal))
        each = tuple(self._log_odds([k]) for k in range(len(fit.field.parts)))
        return ShapeReconstruction(
            fit.field, fit.z, self._posterior(), fit.chi2, each, max(each, default=0.0),
            unexplained=unexplained, history=tuple(self.history),
        )  # fmt: skip

    def _log_odds(self, removed: list[int]) -> float:
        """Return the log-evidence over that of the model without some inclusions."""
        field, z = without(self.fit.field, self.fit.z, removed)
        trial, _ = self._fit(field, z, _ROUGH, self.fit)
        inflation = max(1.0, self.fit.chi2)
        odds = self.fit.log_evidence(inflation) - trial.log_evidence(inflation)
        return min(odds, _MAX_LOG_ODDS)

    def _posterior(self) -> ShapePosterior:
        """Return the posterior, where balls may be ellipsoids."""
        fit = self.fit
        field, z = fit.field, fit.z
        for k in range(len(field.distorted)):
            field, z = as_ellipsoid(field, z, k)
        inflation = max(1.0, fit.chi2)
        jacobian = ShapesOnSites(field, self.sites).at(z).jacobian(self.evaluation)
        covariance = np.linalg.inv(jacobian.T @ jacobian / inflation + np.eye(len(z)))
        gradient = jacobian.T @ fit.residuals / inflation + z
        return ShapePosterior(field, z, -covariance @ gradient, covariance)


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
