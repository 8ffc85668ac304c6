"""The presses of a search for inclusions: predictions, data with their errors, fits and trials."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from threading import Lock
from typing import Any, ClassVar, TypeAlias

import numpy as np
from jaxtyping import Float, Int

from tactorch.errors import CancelledError
from tactorch.inverse.data.observations import DataModel
from tactorch.inverse.errors import ErrorModel, Levels
from tactorch.inverse.fields import ShapeField, ShapePrior, Sites
from tactorch.inverse.fit.shapes import ShapeFit, ShapesOnSites, fit_shapes
from tactorch.inverse.forward.palpation import contacts_of
from tactorch.inverse.forward.predictions import Predictions
from tactorch.inverse.forward.problem import Evaluation, InverseProblem
from tactorch.inverse.forward.reduced import ReducedProblem
from tactorch.inverse.posterior.shapes import ShapePosterior
from tactorch.inverse.result.shapes import ShapeReconstruction
from tactorch.inverse.search.held_out import held_out_score
from tactorch.inverse.search.matched import MatchedFilter
from tactorch.inverse.search.model import (
    MIN_GAIN,
    OPTIMISM,
    Model,
    Start,
    falls_short,
    gain,
    make_posterior,
    rivals,
    with_ball,
)
from tactorch.recording import Recording

_QUICK_STEPS = 8  # of Gauss-Newton, for a provisional answer
_WIDE = 3.0  # deviations of the misfit of samples beyond which parameters do not belong together
_QUICK_STARTS = 2  # fits of an inclusion for a provisional answer
# Tolerances of fits: within one standard deviation of the optimum, and a sixth of the gain by which
# models are accepted; and within a fifth of a standard deviation, for the last fit.
ROUGH, FINE = 0.5, 0.02
_SAME_MODEL = 3.0  # change of a parameter that a correction outlasts, in standard deviations
#: Families as which inclusions are tried where presses show their form.
FORMS = ("ellipsoid", "cuboid", "rod", "tapered rod", "bent rod", "ring", "irregular lump")


#: Source of models that may be better than the present one, to be fitted with the reduced model.
Proposals: TypeAlias = Callable[["SearchProblem", Model], Iterable[Start]]


class SearchProblem:
    """The presses of a search, and what differs between searches.

    Args:
        stop: Called before each step of a fit and each equilibrium of a correction, by one thread
            at a time; once it is true they raise `CancelledError`.
        max_shapes: Largest number of inclusions.

    Attributes:
        full: The presses with the elements by which models are judged.
        sites: Volumes of the quadrature points of these elements.
        reduced: The presses linearised about a uniform body or an accepted model, with which models
            are tried.
        matched: Matched filter for inclusions.
        prior: Prior of the parameters of inclusions.
        errors: Errors of the data that occur.
        proposals: Sources of models.
        forms: Families as which inclusions are tried.
        step_sides: Sides of the body at which steps of the background may end.
        max_shapes: Largest number of inclusions.
        max_fits: Largest number of proposals from one model that are fitted with `full`.
        max_alternatives: The same from the last model, of other inclusions that may be as probable.
        rival_share: Part of the gain that the best proposal promises, beyond which one of another
            kind is compared with it; one where the first that has enough evidence is accepted.
        tolerance: Of fits, see `fit_shapes`.
        final_tolerance: Of the last fit.
        trial_steps: Largest number of Gauss-Newton steps of a trial with the reduced model.
        trial_share: Part of the least gain that a trial with the reduced model has to promise.
        min_gain: Gain of log-evidence by which a model is accepted.
    """

    full: InverseProblem
    sites: Sites
    reduced: ReducedProblem
    matched: MatchedFilter
    prior: ShapePrior
    errors: ErrorModel
    proposals: Sequence[Proposals]
    forms: Sequence[str] = ()
    step_sides: Sequence[str] = ("x-", "x+", "y-", "y+", "z-", "z+")
    max_fits: ClassVar[int] = 4
    max_alternatives: ClassVar[int] = 2
    rival_share: ClassVar[float] = 0.1
    tolerance: float = ROUGH
    final_tolerance: ClassVar[float] = FINE
    trial_steps: ClassVar[int] = 8
    trial_share: ClassVar[float] = 1.0
    min_gain: float = MIN_GAIN
    _reduced_sites: Sites
    _corrected_at: tuple[ShapeFit, Levels] | None = None

    def __init__(self, stop: Callable[[], bool] = lambda: False, max_shapes: int = 0) -> None:
        self.max_shapes = max_shapes
        self._stop, self._is_stopped, self._lock = stop, False, Lock()

    def posterior(self, model: Model) -> tuple[Model, ShapePosterior]:
        """Return the posterior of a final model, and the model or one of more evidence."""
        return model, make_posterior(model, self.sites)

    def predictions(self, model: Model, recording: Recording) -> Predictions | None:
        """Return the predictions of all presses of a recording at a final model, if there are."""
        return Predictions.of(model.evaluation, recording)

    def provisional(self) -> ShapeFit:
        """Return a quick answer by the reduced model: a further inclusion in a uniform body.

        It is the uniform body where none raises the evidence by enough. Errors of the data beside
        white noise, and of the reduced model, are not taken into account.
        """
        problem = self.reduced.with_data(self._white)

        def fitted(field: ShapeField, z: Float[np.ndarray, " size"]) -> ShapeFit:
            return fit_shapes(
                problem, field, z, sites=self._reduced_sites, max_iterations=_QUICK_STEPS,
                give_up=self._never,
            )[0]  # fmt: skip

        best = uniform = fitted(self._uniform.field, self._uniform.z)
        for candidate in self.matched.best(uniform.residuals, uniform.jacobian, _QUICK_STARTS):
            _, field, z = with_ball(uniform, candidate)
            fit = fitted(field, z)
            if self.gain(fit, best) > (self.min_gain if best is uniform else 0.0):
                best = fit
        return best

    def final(self, model: Model) -> Model:
        """Return the model fitted closely."""
        return self._fit_further(model, "final", self.final_tolerance)

    def precise(self, model: Model) -> Model:
        """Return an accepted model with predictions as exact as the search needs them."""
        return model

    def _is_corrected(self, model: Model) -> bool:
        """Whether the last correction was computed at nearly the same parameters."""
        if self._corrected_at is None:
            return False
        (last, errors), fit = self._corrected_at, model.fit
        if last.field is not fit.field or self.errors.differs(errors, model.errors):
            return False
        deviations = np.sqrt(np.diag(fit.covariance))
        return bool((np.abs(fit.z - last.z) <= _SAME_MODEL * deviations).all())

    def first(self, start: Start) -> Model:
        """Fit the first model of a search.

        Raises:
            ConvergenceError: it has no equilibrium under the recorded forces.
        """
        return self.precise(self.fit(start, None))

    def uniform(self) -> Model:
        """Fit the uniform body."""
        return self.first(self._uniform)

    @property
    def _uniform(self) -> Start:
        return Start("uniform", ShapeField(self.prior), np.zeros(1), self.errors.least)

    def continued(self, result: ShapeReconstruction | Start) -> Start:
        """Return the model of a search on other presses of the same object."""
        field, z = result.field.changed(result.z, prior=self.prior)
        return Start("the model before", field, z, self.errors.at_least(result.errors))

    def gain(self, fit: ShapeFit, rival: ShapeFit) -> float:
        """Return the log-evidence of a fit over that of another one, see `gain`."""
        return gain(fit, rival, self.groups)

    @property
    def groups(self) -> Int[np.ndarray, " data"] | None:
        """Group of each datum, in each of which a model may fail for itself; None for one group."""
        return None

    def filter(self, errors: Levels) -> MatchedFilter:
        """Return the matched filter for data with these errors."""
        return self.matched.whitened(self.data(errors))

    def error_levels(self, model: Model) -> Iterator[Levels]:
        """Yield the errors with which further inclusions are proposed, those of the model first."""
        yield model.errors
        if (exact := self.errors.specific(model.errors)) != model.errors:
            yield exact

    def fit(
        self,
        start: Start,
        displacements: Sequence[Float[np.ndarray, "nodes 3"]] | None,
        tolerance: float | None = None,
        held: Float[np.ndarray, " size"] | None = None,
        evaluation: Evaluation | None = None,
    ) -> Model:
        """Fit with the full model, from these displacements or the equilibria of an evaluation.

        See `fit_shapes` for `held` and `evaluation`.
        """
        self._check()
        problem = self.full.with_data(self.data(start.errors))
        fit = fit_shapes(
            problem, start.field, start.z, sites=self.sites, starts=displacements,
            evaluation=evaluation, tolerance=tolerance or self.tolerance, held=held,
            give_up=self._never,
        )  # fmt: skip
        return Model(*fit, start.errors)

    def challenge(
        self, start: Start, model: Model, margin: float = 0.0, rival: Model | None = None
    ) -> Model:
        """Fit a proposal with the full model, as far as it may have more evidence than a model.

        It is fitted from that model, and compared with a rival if there is one.

        A fit that will hardly have more, or less by no more than a margin, which may be negative,
        ends early: before its first step, whose gain is predicted by the derivatives of the reduced
        model, or between steps.
        """
        self._check()
        problem = self.full.with_data(self.data(start.errors))

        def is_worse(fit: ShapeFit, fall: float) -> bool:
            self._check()
            return falls_short(fit, OPTIMISM * fall, (rival or model).fit, self.groups, margin)

        family = ShapesOnSites(start.field, self.sites)
        if start.field is model.fit.field:  # with other errors of the data
            z, evaluation = model.fit.z, model.evaluation.with_data(problem.data)
        else:
            z, starts = np.clip(start.z, *family.limits), model.evaluation.displacements
            evaluation = problem.evaluate(family.at(z).youngs, starts=starts)
        point = ShapesOnSites(start.field, self._reduced_sites).at(z)
        coarse = self.reduced.evaluate(point.youngs).with_data(problem.data)
        first = ShapeFit.at(point, evaluation, point.jacobian(coarse))
        if is_worse(first, first.predicted_fall):
            return Model(first, evaluation, start.errors)
        fit = fit_shapes(
            problem, start.field, z, sites=self.sites, evaluation=evaluation,
            tolerance=self.tolerance, give_up=is_worse,
        )  # fmt: skip
        return Model(*fit, start.errors)

    def _fit_further(self, model: Model, what: str, tolerance: float | None) -> Model:
        """Return a model fitted again to the present data, from its equilibria."""
        start = Start(what, model.fit.field, model.fit.z, model.errors)
        return self.fit(start, None, tolerance, evaluation=model.evaluation)

    def displacements(
        self, model: Model, z: Float[np.ndarray, " size"]
    ) -> list[Float[np.ndarray, "nodes 3"]]:
        """Return the displacements (mm) of a model with other parameters, linearised about it."""
        changes = ShapesOnSites(model.fit.field, self.sites).at(model.fit.z).changes
        _, fields = model.evaluation.linear_response(changes)
        step = z - model.fit.z
        return model.evaluation.moved([np.tensordot(step, field, 1) for field in fields])

    def try_model(self, start: Start, offsets: list[np.ndarray]) -> ShapeFit:
        """Return the fit of a model with the reduced model.

        Args:
            start: Model and parameters to start from.
            offsets: See `offsets`.
        """
        self._check()
        problem = self.reduced.with_data(self.data(start.errors).shifted(offsets))
        return fit_shapes(
            problem, start.field, start.z, sites=self._reduced_sites,
            max_iterations=self.trial_steps, tolerance=FINE, give_up=self._never,
        )[0]  # fmt: skip

    def without(self, model: Model, removed: Sequence[int]) -> Iterator[tuple[Levels, ShapeFit]]:
        """Yield the errors and the fit of `rivals` of a final model, by the reduced model.

        They are tried with larger general errors, such as a discrepancy of the model, too.
        """
        offsets = self.offsets(model)
        plain, *smooth = rivals(model, removed)
        doubted = (replace(plain, errors=errors) for errors in self.errors.doubts(model.errors))
        for rival in (plain, *smooth, *doubted):
            yield rival.errors, self.try_model(rival, offsets)

    def held_out_score(self, fit: ShapeFit, errors: Levels) -> float | None:
        """Return how well a fit predicts the presses of a contact from the others."""
        data = self.data(errors)
        return held_out_score(data, self.contacts, fit.residuals, fit.jacobian, fit.covariance)

    @property
    def contacts(self) -> Sequence[Sequence[int]]:
        """Numbers of the presses of each contact."""
        return contacts_of(self.full.recording)

    def predictive_gain(self, score: float | None, rival: ShapeFit, errors: Levels) -> float | None:
        """Return the log-density of held-out presses of a score over that by a rival."""
        other = None if score is None else self.held_out_score(rival, errors)
        return None if score is None or other is None else len(rival.residuals) * (score - other)

    def offsets(self, model: Model) -> list[np.ndarray]:
        """Return predictions of the reduced model less those of the full one at a model."""
        field = ShapesOnSites(model.fit.field, self._reduced_sites).at(model.fit.z)
        pairs = zip(self.reduced.predicted(field.youngs), model.evaluation.predicted, strict=True)
        return [reduced - full for reduced, full in pairs]

    def belong_together(self, model: Model, z: Float[np.ndarray, " size"]) -> bool:
        """Return whether parameters explain the presses as well as samples of the posterior.

        The rise of the sum of squares from the best fit to samples is chi-squared of as many
        degrees of freedom as there are parameters. It is that of the reduced model. With groups of
        data of different noise it is not known, and the posterior is normal about the best fit.
        """
        if self.groups is not None:
            return True
        rise, count = self.misfit_rise(model, z) / max(1.0, model.fit.chi2), len(z)
        return rise < count + _WIDE * np.sqrt(2.0 * count)

    def misfit_rise(self, model: Model, z: Float[np.ndarray, " size"]) -> float:
        """Return the sum of squared residuals at other parameters, less that of a model."""
        data = self.data(model.errors).shifted(self.offsets(model))
        family = ShapesOnSites(model.fit.field, self._reduced_sites)
        best, other = (
            float(np.sum(self.reduced.with_data(data).evaluate(family.at(x).youngs).residuals ** 2))
            for x in (model.fit.z, z)
        )
        return other - best

    def jacobian(self, model: Model) -> Float[np.ndarray, "data size"]:
        """Return the derivatives of the residuals of white noise by a model's parameters."""
        field = ShapesOnSites(model.fit.field, self.sites)
        return field.at(model.fit.z).jacobian(self.raw(model))

    def _linearise(self, start: Start) -> Any:
        """Compute the effects of errors of the data about a model."""
        youngs = ShapesOnSites(start.field, self.sites).at(start.z).youngs
        self.errors.linearise(self.full.evaluate(youngs), "linear")

    def _never(self, fit: ShapeFit, fall: float) -> bool:
        """Return that a fit is not given up, unless the search is stopped."""
        self._check()
        return False

    def _check(self) -> None:
        with self._lock:  # presses are solved in threads, each of which ends at its next check
            self._is_stopped = self._is_stopped or self._stop()
        if self._is_stopped:
            raise CancelledError("The search for inclusions was stopped before it had a result.")

    def raw(self, model: Model) -> Evaluation:
        """Return the predictions of a model with the residuals of white noise."""
        return model.evaluation.with_data(self._white)

    @property
    def _white(self) -> DataModel:
        return replace(self.errors.presses.problem.data, correlated=None)

    def data(self, errors: Levels) -> DataModel:
        """Return the data with these errors, about a uniform body where there is no model yet."""
        if self.errors.lacks(errors):
            self._linearise(replace(self._uniform, errors=errors))
        return self.errors.data(errors)
