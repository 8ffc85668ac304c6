"""The search for inclusions under the presses of a palpation.

A round adds a ball or a rod that the matched filter sees in the residuals, lets the background
vary, makes a ball an ellipsoid, or changes the size of smooth errors of the forces. The models that
promise most evidence by linearised predictions are fitted, and the first whose evidence is larger
is kept. Smooth errors are tried together with each of the others, so that they do not replace an
inclusion that explains as much. The body is linear, so that predictions need no correction at the
contacts (see `tactorch.fem.indentation`).
"""

import logging
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from tactorch.errors import CancelledError
from tactorch.inverse.data.observations import DataModel
from tactorch.inverse.fields import Candidate, ShapeField, ShapePrior
from tactorch.inverse.fields.family import families_beyond
from tactorch.inverse.fit.settings import Settings
from tactorch.inverse.fit.shapes import ShapeFit, ShapesOnSites
from tactorch.inverse.forward.palpation import PALPATION_ELEMENT
from tactorch.inverse.result.shapes import ShapeReconstruction, ShapeState
from tactorch.inverse.search.matched import MatchedFilter
from tactorch.inverse.search.model import (
    DEGREES,
    MAX_LOG_ODDS,
    MIN_CANDIDATE_GAIN,
    Model,
    Start,
    TimeLimit,
    falls_short,
    gain,
    improve,
    make_posterior,
    record,
    unexplained,
    varied,
    with_ball,
    with_family,
    with_predictions,
    without,
)
from tactorch.inverse.search.palpation_presses import PalpationPresses
from tactorch.progress import progress_line
from tactorch.recording import Recording

_log = logging.getLogger(__name__)
_STARTS = 3  # balls and rods that are tried in a round
_SEARCHED = "tet4"  # elements of the search; the result is fitted with better ones
_ROUGH, _FINE = 0.5, 0.05  # tolerances of fits
_MAX_STEPS, _FEW_STEPS = 12, 4  # of a fit, and of one by which models are compared
_OPTIMISM = 3.0  # falls of the objective over those of its quadratic model, at best
_MAX_FITS = 5  # of a round
# Of the log-evidence, over the presses of a place, for a model that is accepted: the errors of
# these presses are not independent.
_MIN_GAIN = 10.0
_CERTAIN = 20.0  # log-odds beyond which they need not be known
_OUTSIDE_MM = 1.0  # standard deviation of the length of inclusions outside the object


class _Proposal(NamedTuple):
    """A model to be fitted, and the gain of log-evidence that is expected."""

    start: Start
    promise: float
    inclusion: str = ""  # name of a further one


class _Response(NamedTuple):
    """Derivatives of the residuals by the parameters, and residuals, before whitening."""

    jacobian: Float[np.ndarray, "data size"]
    residuals: Float[np.ndarray, " data"]


class _Search:
    """The presses, and the present model."""

    def __init__(self, recording: Recording, settings: Settings, stop: Callable[[], bool]) -> None:
        self._recording, self._settings, self._stop = recording, settings, stop
        self.presses = PalpationPresses(recording, settings, _SEARCHED)
        problem = self.presses.problem
        youngs = self._linear_mpa = problem.contact_mpa
        white = problem.with_data(self.presses.white)
        self.matched = MatchedFilter.of(white, youngs, self.presses.are_resolved)
        self._filters: dict[DataModel, MatchedFilter] = {}
        self.history: list[dict[str, Any]] = []
        prior = replace(ShapePrior.of(recording.mesh, youngs), outside_mm=_OUTSIDE_MM)
        field = ShapeField(prior)
        start = Start("uniform", field, np.zeros(field.size), self.presses.errors.least)
        self._accept("uniform", self._fit(start))

    def _fit(
        self,
        start: Start,
        tolerance: float = _ROUGH,
        *,
        max_steps: int = _MAX_STEPS,
        rival: ShapeFit | None = None,
        margin: float = 0.0,
    ) -> Model:
        """Fit a model, as far as it may have at most so much less evidence than a rival."""

        def give_up(fit: ShapeFit, fall: float) -> bool:
            self._check(fit)
            return rival is not None and falls_short(fit, _OPTIMISM * fall, rival, margin)

        return self.presses.fit(start, tolerance, max_steps, give_up)

    def _check(self, first: ShapeFit) -> None:
        """Raise `CancelledError` where the search is stopped, with the model that it reached."""
        if self._stop():
            fit, errors = first, self.presses.errors.least
            if self.history:
                fit, errors = self.model.fit, self.model.errors
            error = CancelledError("the search for inclusions was stopped.")
            error.reached = ShapeState(fit.field, fit.z, errors)
            raise error

    def _accept(self, what: str, model: Model) -> None:
        self.model = model
        self.history.append(record(what, model.fit))
        _log.info("%s: chi2 %.4g", what, model.fit.chi2)

    def improve(self, max_shapes: int) -> bool:
        """Accept a model of more evidence; return whether there was one."""
        response = self._response(self._present)
        others = list(self._with_levels(self._present, response))
        of_errors = max(others, key=lambda proposal: proposal.promise)
        trials: list[tuple[Start, float]] = []
        # Errors are linear, and an inclusion is not: its linearised gain and that of a few steps
        # are less. One without larger errors is tried in any case.
        for proposals in self._proposals(others, response, max_shapes):
            best = self._best(proposals)
            if best is not None and all(best.what != start.what for start, _ in trials):
                # Larger errors alone may explain most of what an inclusion beside them does.
                trials.append((best, max(of_errors.promise, 0.0)))
        for start, least in [*trials, (of_errors.start, 0.0)]:
            trial = self._fit(start)
            change = self._gain(trial.fit, self.model.fit)
            _log.info(
                "%s: chi2 %.4g, log-evidence %+.4g, by errors %.4g",
                start.what, trial.fit.chi2, change, least,
            )  # fmt: skip
            if change > least + self._least_gain:
                self._accept(start.what, trial)
                return True
        return False

    @property
    def _least_gain(self) -> float:
        """Smallest gain of log-evidence for a model that is accepted."""
        problem = self.presses.problem
        return _MIN_GAIN * len(problem.recording.presses) / len(problem.indentation.places)

    def _best(self, proposals: Sequence[_Proposal]) -> Start | None:
        """Return the proposal that is best after a few steps of a fit, with its parameters."""
        fit, best, most = self.model.fit, None, 0.0
        for start, promise, _ in proposals:
            with progress_line(start.what):
                trial = self._fit(start, max_steps=_FEW_STEPS, rival=fit)
            change = gain(trial.fit, fit)
            _log.debug("proposal: %s, log-evidence %+.4g of %+.4g", start.what, change, promise)
            if change > most:
                best, most = replace(start, z=trial.fit.z), change
        return best

    def _weights(self, *residuals: Float[np.ndarray, " data"]) -> Float[np.ndarray, " data"]:
        """Return one over the chi2 of each place, where even the best explanation exceeds one."""
        place_of = self.presses.place_of
        counts = np.bincount(place_of)
        chi2 = np.min([np.bincount(place_of, r**2) / counts for r in residuals], axis=0)
        return (1.0 / np.maximum(chi2, 1.0))[place_of]

    def _gain(self, fit: ShapeFit, rival: ShapeFit) -> float:
        """Return the log-evidence of a fit over that of another one.

        Places that neither explains count less, by their chi2: there the contact is not modelled.
        """
        weights = self._weights(fit.residuals, rival.residuals)
        misfit = 0.5 * float(weights @ (rival.residuals**2 - fit.residuals**2))
        return misfit + rival.penalty - fit.penalty + rival.log_determinant - fit.log_determinant

    def _proposals(
        self, others: list[_Proposal], response: _Response, max_shapes: int
    ) -> tuple[list[_Proposal], list[_Proposal]]:
        """Return models that may have most evidence, and the best inclusion without larger errors.

        Args:
            others: The present model with each size of the smooth errors.
            response: Its derivatives and residuals.
            max_shapes: Largest number of inclusions.
        """
        found = list(others)
        for start in self._starts():
            levels = self._with_levels(start, self._response(start))
            found.append(max(levels, key=lambda proposal: proposal.promise))
        if len(self.model.fit.field.families) < max_shapes:
            found += self._further(others, response)
        found = [proposal for proposal in found if proposal.promise > 0.0]
        found = sorted(found, key=lambda proposal: -proposal.promise)
        each = {proposal.inclusion or proposal.start.what: proposal for proposal in found[::-1]}
        best = [proposal for proposal in found if any(proposal is p for p in each.values())]
        errors = self.model.errors
        alone = [p for p in found if p.inclusion and p.start.errors == errors]
        return best[:_MAX_FITS], alone[:1]

    @property
    def _present(self) -> Start:
        return Start("", self.model.fit.field, self.model.fit.z, self.model.errors)

    def _with_levels(self, start: Start, response: _Response) -> Iterator[_Proposal]:
        """Yield a model with its errors, and with others of the data."""
        for what, errors in [("", start.errors), *self.presses.errors.others(start.errors)]:
            what = ", ".join(filter(None, (start.what, what)))
            promise = self._promise(response, start, self.presses.data(errors))
            yield _Proposal(replace(start, what=what, errors=errors), promise)

    def _starts(self) -> Iterator[Start]:
        field, z, errors = self.model.fit.field, self.model.fit.z, self.model.errors
        for k, family in enumerate(field.families):
            for other in families_beyond(family):
                what = f"inclusion {k} as {other.noun}"
                yield Start(what, *with_family(field, z, k, other), errors)
        degree = next((degree for degree in DEGREES if degree > field.background.degree), None)
        if degree is not None:
            what = f"background of degree {degree}"
            yield Start(what, *varied(field, z, degree=degree), errors)

    def _further(self, others: Sequence[_Proposal], response: _Response) -> Iterator[_Proposal]:
        """Yield the model with a further ball or rod, with each size of the smooth errors."""
        for start, promise, _ in others:
            data = self.presses.data(start.errors)
            residuals, explained = data.whiten(response.residuals), data.whiten(response.jacobian)
            for ball in self._candidates(residuals, explained, data):
                expected = promise + ball.gain - MIN_CANDIDATE_GAIN
                what, field, z = with_ball(self.model.fit, ball)
                errors = start.errors
                named = f"{what}{', ' * bool(start.what)}{start.what}"
                yield _Proposal(Start(named, field, z, errors), expected, what)

    def _candidates(
        self,
        residuals: Float[np.ndarray, " data"],
        explained: Float[np.ndarray, "data size"],
        data: DataModel,
    ) -> Iterator[Candidate]:
        """Yield balls and rods that would reduce the misfit most.

        Where the misfit is large at some places, it hides others: all places are seen alike at
        first, and then each by its weight.
        """
        if data not in self._filters:
            self._filters[data] = self.matched.whitened(data)
        matched, inflation = self._filters[data], max(1.0, float(np.mean(residuals**2)))
        for candidate in matched.best(residuals, explained, _STARTS):
            yield candidate._replace(gain=candidate.gain / inflation)
        weights = np.sqrt(self._weights(residuals))
        yield from matched.best(residuals, explained, _STARTS, weights)

    def _response(self, start: Start) -> _Response:
        """Return the response of a model whose moduli are those of the present one."""
        raw = self.model.evaluation.with_data(self.presses.white)
        self._check(self.model.fit)
        point = ShapesOnSites(start.field, self.presses.sites).at(start.z)
        return _Response(point.jacobian(raw), raw.residuals)

    def _promise(self, response: _Response, start: Start, data: DataModel) -> float:
        """Return the gain of log-evidence by a linearised fit."""
        fit, z = self.model.fit, start.z
        jacobian, residuals = data.whiten(response.jacobian), data.whiten(response.residuals)
        excess, slopes = start.field.excess(z), start.field.excess_jacobian(z)
        squares = jacobian.T @ jacobian + slopes.T @ slopes + np.eye(len(z))
        step = -np.linalg.solve(squares, jacobian.T @ residuals + slopes.T @ excess + z)
        left = residuals + jacobian @ step
        weights = self._weights(left, fit.residuals)
        misfit = 0.5 * float(weights @ (fit.residuals**2 - left**2))
        penalty = 0.5 * float(np.sum((z + step) ** 2) + np.sum((excess + slopes @ step) ** 2))
        determinant = float(np.linalg.slogdet(squares)[1]) + data.log_determinant
        return misfit + fit.penalty - penalty + fit.log_determinant - 0.5 * determinant

    def result(self) -> ShapeReconstruction:
        """Fit the model closely with better elements, and return it with its posterior."""
        self.presses = PalpationPresses(self._recording, self._settings, PALPATION_ELEMENT)
        fit = self.model.fit
        field, z, level = fit.field, fit.z.copy(), fit.field.background.level
        # Linear elements are too stiff under the balls.
        log = np.log(self.presses.problem.contact_mpa / self._linear_mpa)
        z[level] += log / field.deviation[level]
        self._accept("final fit", self._fit(Start("", field, z, self.model.errors), _FINE))
        fit = self.model.fit
        count = len(fit.field.parts)
        each = tuple(self._log_odds([k]) for k in range(count))
        whole = each[0] if count == 1 else self._log_odds(range(count)) if count else 0.0
        return ShapeReconstruction(
            fit.field, fit.z, make_posterior(self.model, self.presses.sites), fit.chi2, each, whole,
            self.model.errors, unexplained(fit, self.presses.problem.data), tuple(self.history),
        )  # fmt: skip

    def _log_odds(self, removed: Sequence[int]) -> float:
        """Return the log-evidence over that of the model without some inclusions.

        The fit ends where it is certain that the other model has much less.
        """
        fit = self.model.fit
        field, z = without(fit.field, fit.z, removed)
        start = Start("without", field, z, self.model.errors)
        trial = self._fit(start, rival=fit, margin=_CERTAIN).fit
        inflation = max(1.0, fit.chi2)
        return min(fit.log_evidence(inflation) - trial.log_evidence(inflation), MAX_LOG_ODDS)


def find_palpation_shapes(
    recording: Recording,
    settings: Settings,
    *,
    max_shapes: int,
    max_models: int,
    limit: TimeLimit,
) -> ShapeReconstruction:
    """Find the inclusions under the presses of a palpation; see `find_shapes`."""
    with progress_line("search for inclusions") as update:
        update("uniform body")
        search = _Search(recording, settings, limit)

        def step(number: int) -> bool:
            update(f"model {number}")
            return search.improve(max_shapes)

        ended = improve(step, max_models, limit)
        update("final fit")
        result = replace(search.result(), ended=ended)
        return with_predictions(result, search.model, recording)
