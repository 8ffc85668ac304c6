"""The presses of a search for shapes: predictions, data with their errors, fits and trials."""

import logging
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from threading import Lock
from typing import Any

import numpy as np
from jaxtyping import Float

from tactorch.errors import CancelledError, ConfigError, ConvergenceError
from tactorch.fem import NewtonOptions
from tactorch.inverse.data.observations import DataModel, Observation, group_by_contact
from tactorch.inverse.errors import ERRORS, ErrorModel, Levels, MeasuredPresses
from tactorch.inverse.errors.kept import KeptRims
from tactorch.inverse.fields import ShapeField, ShapePrior, Sites
from tactorch.inverse.fit.settings import Settings
from tactorch.inverse.fit.shapes import ShapeFit, ShapesOnSites, fit_shapes
from tactorch.inverse.fit.starts import uniform_fit
from tactorch.inverse.forward.problem import Evaluation, InverseProblem
from tactorch.inverse.forward.reduced import ReducedProblem
from tactorch.inverse.result.shapes import ShapeReconstruction, ShapeState
from tactorch.inverse.search.correction import Correction
from tactorch.inverse.search.matched import MatchedFilter
from tactorch.inverse.search.model import Model, Start, Trial, falls_short
from tactorch.recording import Recording

_log = logging.getLogger(__name__)
_OPTIMISM = 1.5  # falls of the objective over those of its quadratic model, at best
_TRIAL_STEPS = 8  # of Gauss-Newton with the reduced model
# Error of the discretisation that remains after its correction, over the displacements. It is the
# same in all presses of a contact.
_DISCRETISATION = 1e-3
# Mean squared residual of models that are corrected during the search: where the signal that is
# not explained exceeds the noise, the error of the discretisation does not matter yet.
_MAX_ROUGH_CHI2 = 3.0
_SAME_MODEL = 3.0  # change of a parameter that a correction outlasts, in standard deviations
_DERIVATIVE_RTOL = 2e-3  # of the solves for derivatives: far below the curvature of the objective
# Tolerances of fits: within one standard deviation of the optimum, and a sixth of the gain by which
# models are accepted; and within a fifth of a standard deviation, for the last fit.
_ROUGH_TOLERANCE, _TOLERANCE = 0.5, 0.02
_RTOL = 1e-6  # of equilibria: far below the noise of a sensor


class ShapeProblem:
    """The presses with quadratic elements and with linear ones.

    Args:
        recording: The presses.
        settings: Noise, solver, bounds and equilibrium search are used.
        stop: Called before each step of a fit and each equilibrium of a correction, by one thread
            at a time; once it is true they raise `CancelledError`.
        kept: Errors at rims of an earlier search on fewer presses; those of others are added.
        requested: Names of errors that are taken into account on request.

    Attributes:
        quadratic: The presses with quadratic elements, on which models are judged.
        linear: The presses with linear elements.
        reduced: The presses with predictions about a uniform body, with which models are tried.
        sites: Volumes of the quadrature points of the quadratic elements.
        prior: Prior of the parameters of shapes.
        matched: Matched filter for balls.
        errors: Errors of the data that occur.
        least_errors: Their deviations in the simplest model.
    """

    def __init__(
        self,
        recording: Recording,
        settings: Settings,
        stop: Callable[[], bool] = lambda: False,
        kept: KeptRims | None = None,
        requested: Collection[str] = (),
    ) -> None:
        self._stop, self._is_stopped, self._lock = stop, False, Lock()
        same, self._element = is_same_model(recording), "tet10"
        if same:
            self._element = str(recording.provenance.get("element", settings.element))
        newton = NewtonOptions(rtol=max(settings.newton.rtol, _RTOL))
        unscaled = [Observation.of(press, 1.0) for press in recording.presses]
        contacts, noise = group_by_contact(recording.presses, unscaled), settings.noise
        if not same:
            floor = _DISCRETISATION * np.sqrt(len(recording.presses) / len(contacts))
            noise = replace(noise, relative=max(noise.relative, float(floor)))
        options: dict[str, Any] = {"solver": settings.solver, "noise": noise}

        def problem(element: str, **more: Any) -> InverseProblem:
            return InverseProblem(recording, element=element, newton=newton, **options, **more)

        self.linear = problem("tet4")
        if recording.has_probes:
            options["contact_mpa"] = self.linear.contact_mpa
        self.quadratic = problem(self._element, derivative_rtol=_DERIVATIVE_RTOL)
        self.sites = Sites.of(self.quadratic.body.assembly)
        self._linear_sites = Sites.of(self.linear.body.assembly)
        # Where the presses were computed on this mesh, it is the object.
        self._correction, presses = None, MeasuredPresses(self.quadratic, contacts)
        if not same:
            correction = Correction.of(self.quadratic, self._element, settings.solver, kept)
            self._correction, presses = correction, replace(
                presses,
                corrections_mm=[np.zeros(count) for count in self.quadratic.data.counts],
                rims=[(numbers, rim.nodes) for numbers, rim in correction.uncertain],
                at_edge=correction.has_singular_ends,
                kept=correction.kept,
            )  # fmt: skip
        self.errors = ErrorModel(presses, ERRORS, requested)
        self.least_errors = self.errors.least
        self._corrected_at: ShapeFit | None = None
        youngs = uniform_fit(self.linear, settings.bounds).youngs_mpa
        self.reduced = ReducedProblem(self.linear, youngs)
        self.matched = MatchedFilter.of(self.reduced, youngs)
        self.prior = ShapePrior.of(recording.mesh, youngs)
        self._floored = noise.floored(recording)

    @property
    def _has_contacts(self) -> bool:
        return self._correction is not None and self._correction.has_contacts

    def uniform(self) -> Model:
        """Fit the uniform body with quadratic elements."""
        return self.first(self._uniform)

    @property
    def _uniform(self) -> Start:
        return Start("uniform", ShapeField(self.prior), np.zeros(1), self.least_errors)

    def first(self, start: Start) -> Model:
        """Fit the first model of a search with quadratic elements.

        Raises:
            ConvergenceError: it has no equilibrium under the recorded forces.
        """
        model = self.fit(start, self._linearise(start))
        return self.corrected(model) if self._has_contacts else model

    def _linearise(self, start: Start) -> list[Float[np.ndarray, "nodes 3"]]:
        """Compute the effects of the errors about a model, and return its displacements (mm)."""
        extend = self.quadratic.body.discretisation.extend
        youngs = ShapesOnSites(start.field, self._linear_sites).at(start.z).youngs
        coarse = self.linear.evaluate(youngs)
        self.errors.linearise(coarse, "linear")
        displacements = [extend(u) for u in coarse.displacements]
        if not (self._has_contacts or any(e.elements == "quadratic" for e in self.errors.errors)):
            return displacements
        youngs = ShapesOnSites(start.field, self.sites).at(start.z).youngs
        evaluation = self.quadratic.evaluate(youngs, starts=displacements)
        self.errors.linearise(evaluation, "quadratic")
        return evaluation.displacements

    def continued(self, result: ShapeReconstruction | ShapeState) -> Start:
        """Return the model of a search on other presses of the same object."""
        field, z = result.field.changed(result.z, prior=self.prior)
        return Start("the model before", field, z, self.errors.at_least(result.errors))

    def fit(
        self,
        start: Start,
        displacements: Sequence[Float[np.ndarray, "nodes 3"]] | None,
        tolerance: float = _ROUGH_TOLERANCE,
        held: Float[np.ndarray, " size"] | None = None,
        evaluation: Evaluation | None = None,
    ) -> Model:
        """Fit with quadratic elements, from these displacements or the equilibria of an evaluation.

        See `fit_shapes` for `held` and `evaluation`.
        """
        self._check()
        problem = self.quadratic.with_data(self.data(start.errors))
        fit = fit_shapes(
            problem, start.field, start.z, sites=self.sites, starts=displacements,
            evaluation=evaluation, tolerance=tolerance, held=held, give_up=self._never,
        )  # fmt: skip
        return Model(*fit, start.errors)

    def challenge(self, start: Start, model: Model) -> Model:
        """Fit a proposal with quadratic elements, as far as it may have more evidence than a model.

        A fit that will hardly have more ends early: before its first step, whose gain is predicted
        by the derivatives of the reduced model, or between steps.
        """
        self._check()
        problem = self.quadratic.with_data(self.data(start.errors))

        def is_worse(fit: ShapeFit, fall: float) -> bool:
            self._check()
            return falls_short(fit, _OPTIMISM * fall, model.fit)

        family = ShapesOnSites(start.field, self.sites)
        z = np.clip(start.z, *family.limits)
        evaluation = problem.evaluate(family.at(z).youngs, starts=model.evaluation.displacements)
        first = Model(self._coarse_fit(start, z, evaluation), evaluation, start.errors)
        if is_worse(first.fit, _predicted_fall(first.fit)):
            return first
        fit = fit_shapes(
            problem, start.field, z, sites=self.sites, evaluation=evaluation,
            tolerance=_ROUGH_TOLERANCE, give_up=is_worse,
        )  # fmt: skip
        return Model(*fit, start.errors)

    def _coarse_fit(
        self, start: Start, z: Float[np.ndarray, " size"], evaluation: Evaluation
    ) -> ShapeFit:
        """Return a fit of quadratic elements with derivatives of the reduced model."""
        point = ShapesOnSites(start.field, self._linear_sites).at(z)
        coarse = self.reduced.evaluate(point.youngs).with_data(evaluation.data)
        return ShapeFit.at(point, evaluation, point.jacobian(coarse))

    def precise(self, model: Model) -> Model:
        """Return a model of the search corrected for the discretisation.

        Otherwise the search would explain the error of the discretisation by more inclusions, or by
        a background that varies. A model that leaves much more than the noise unexplained is not
        corrected yet, unless the noise may be less than the error of the discretisation.
        """
        is_rough = model.fit.chi2 > _MAX_ROUGH_CHI2 and not self._floored
        if self._correction is None or is_rough or self._is_corrected(model.fit):
            return model
        return self.corrected(model)

    def final(self, model: Model) -> Model:
        """Return the model fitted closely, with predictions corrected for the discretisation."""
        if self._correction is not None and not self._is_corrected(model.fit):
            corrected = self.corrected(model, _TOLERANCE)
            if corrected is not model:
                return corrected
        return self._fit_further(model, "final", _TOLERANCE)

    def _fit_further(self, model: Model, what: str, tolerance: float) -> Model:
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

    def _is_corrected(self, fit: ShapeFit) -> bool:
        """Whether the last correction was computed at nearly the same parameters."""
        last = self._corrected_at
        if last is None or (last.field is not fit.field):
            return False
        deviations = np.sqrt(np.diag(fit.covariance))
        return bool((np.abs(fit.z - last.z) <= _SAME_MODEL * deviations).all())

    def corrected(self, model: Model, tolerance: float = _ROUGH_TOLERANCE) -> Model:
        """Return the model fitted to data that are shifted by the error of the discretisation.

        The model remains, with a warning, where a finer mesh fails.
        """
        self._check()
        assert self._correction is not None
        before = self.quadratic, self.errors
        try:
            offsets = self._correction.offsets(model.fit, model.evaluation, self._check)
            self.errors = self.errors.corrected(offsets)
            self.errors.linearise(model.evaluation, "quadratic")
            self.quadratic = self.errors.presses.problem
            corrected = self._fit_further(model, "corrected", tolerance)
            self._corrected_at = model.fit
            return corrected
        except (ConfigError, ConvergenceError) as error:
            self.quadratic, self.errors = before
            _log.warning("The error of the discretisation is not corrected: %s", error)
            return model

    def try_model(self, start: Start, offsets: list[np.ndarray]) -> tuple[Trial, np.ndarray]:
        """Return the evidence and the parameters of a fit with the reduced model.

        Args:
            start: Model and parameters to start from.
            offsets: See `offsets`.
        """
        self._check()
        problem = self.reduced.with_data(self.data(start.errors).shifted(offsets))
        fit, _ = fit_shapes(
            problem, start.field, start.z, sites=self._linear_sites,
            max_iterations=_TRIAL_STEPS, tolerance=_TOLERANCE, give_up=self._never,
        )  # fmt: skip
        return Trial(fit.chi2, fit.misfit, -fit.log_evidence(np.inf)), fit.z

    def offsets(self, model: Model) -> list[np.ndarray]:
        """Return predictions of the reduced model less those of quadratic elements at a model."""
        pairs = zip(self._coarse(model).predicted, model.evaluation.predicted, strict=True)
        return [reduced - quadratic for reduced, quadratic in pairs]

    def jacobian(self, model: Model) -> Float[np.ndarray, "data size"]:
        """Return the derivatives of the residuals of white noise by a model's parameters."""
        field = ShapesOnSites(model.fit.field, self.sites)
        return field.at(model.fit.z).jacobian(self._raw(model))

    def coarse_jacobian(
        self, model: Model, field: ShapeField, z: Float[np.ndarray, " size"]
    ) -> Float[np.ndarray, "data size"]:
        """Return the derivatives of the residuals of white noise, by the reduced model.

        Args:
            model: The model.
            field: A field, maybe with further parameters.
            z: Its parameters, for which its map is that of the model.
        """
        coarse = self._coarse(model).with_data(self.quadratic.data)
        return ShapesOnSites(field, self._linear_sites).at(z).jacobian(coarse)

    def _coarse(self, model: Model) -> Evaluation:
        """Return the predictions of the reduced model."""
        field = ShapesOnSites(model.fit.field, self._linear_sites).at(model.fit.z)
        return self.reduced.evaluate(field.youngs)

    def linearised(
        self,
        model: Model,
        z: Float[np.ndarray, " size"],
        jacobian: Float[np.ndarray, "data size"],
        errors: Levels,
    ) -> Trial:
        """Return the evidence of a linearised model with these errors of the data.

        Args:
            model: The model about which it is linearised.
            z: Parameters for which its map is that of the model.
            jacobian: Their derivatives, see `jacobian`.
            errors: Levels of the data.
        """
        data, inflation = self.data(errors), max(1.0, model.fit.chi2)
        residuals, columns = data.whiten(self._raw(model).residuals), data.whiten(jacobian)
        hessian = columns.T @ columns
        gradient = columns.T @ residuals / inflation + z
        step = -np.linalg.solve(hessian / inflation + np.eye(len(z)), gradient)
        residuals, z = residuals + columns @ step, z + step
        logs = np.linalg.slogdet(hessian + np.eye(len(z)))[1] + data.log_determinant
        squares = float(residuals @ residuals)
        return Trial(squares / len(residuals), 0.5 * squares, 0.5 * float(z @ z + logs))

    def _never(self, fit: ShapeFit, fall: float) -> bool:
        """Return that a fit is not given up, unless the search is stopped."""
        self._check()
        return False

    def _check(self) -> None:
        with self._lock:  # presses are solved in threads, each of which ends at its next check
            self._is_stopped = self._is_stopped or self._stop()
        if self._is_stopped:
            raise CancelledError("The search for inclusions was stopped before it had a result.")

    def _raw(self, model: Model) -> Evaluation:
        """Return the predictions of a model with the residuals of white noise."""
        return model.evaluation.with_data(self.quadratic.data)

    def data(self, errors: Levels) -> DataModel:
        """Return the data with these errors, about a uniform body where there is no model yet."""
        if self.errors.lacks(errors):
            self._linearise(self._uniform)
        return self.errors.data(errors)


def _predicted_fall(fit: ShapeFit) -> float:
    """Return the fall of the objective by a Gauss-Newton step."""
    gradient = fit.jacobian.T @ fit.residuals + fit.z
    return 0.5 * float(gradient @ fit.covariance @ gradient)


def is_same_model(recording: Recording) -> bool:
    """Return whether the recording's mesh, on which the presses were computed, is the object."""
    return bool(recording.provenance.get("inverse_crime"))
