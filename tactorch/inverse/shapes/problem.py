"""The presses of a search for shapes: predictions, data with their errors, fits and trials."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import replace
from threading import Lock
from typing import Any

import numpy as np
from jaxtyping import Float

from tactorch.errors import CancelledError, ConfigError, ConvergenceError
from tactorch.fem import NewtonOptions
from tactorch.inverse.data import DataModel, Observation, group_by_contact, rigid_patterns
from tactorch.inverse.fields import ShapeField, ShapePrior, Sites
from tactorch.inverse.press_errors import error_patterns, has_errors
from tactorch.inverse.problem import Evaluation, InverseProblem
from tactorch.inverse.settings import Settings
from tactorch.inverse.shapes.correction import Correction
from tactorch.inverse.shapes.error_patterns import ErrorPatterns
from tactorch.inverse.shapes.fit import ShapeFit, ShapesOnSites, fit_shapes
from tactorch.inverse.shapes.kept import KeptRims
from tactorch.inverse.shapes.matched import MatchedFilter
from tactorch.inverse.shapes.model import (
    EDGE_DEVIATION,
    FORCE_DEVIATIONS,
    MIN_POSE_DEVIATION,
    RIM_DEVIATIONS,
    Errors,
    Model,
    Start,
    Trial,
    falls_short,
)
from tactorch.inverse.shapes.poses import probe_patterns
from tactorch.inverse.shapes.result import ShapeReconstruction, ShapeState
from tactorch.inverse.shapes.rims import rim_patterns
from tactorch.inverse.starts import uniform_fit
from tactorch.recording import Recording

_log = logging.getLogger(__name__)
_OPTIMISM = 1.5  # falls of the objective over those of its quadratic model, at best
_TRIAL_STEPS = 8  # of Gauss-Newton with linear elements
# Error of the discretisation that remains after its correction, over the displacements. It is the
# same in all presses of a contact.
_DISCRETISATION = 1e-3
_CORRECTION_DEVIATION = 0.3  # of the correction of each contact, over the correction
_MAX_ROUGH_CHI2 = 3.0  # of models that are corrected during the search
_SAME_MODEL = 3.0  # change of a parameter that a correction outlasts, in standard deviations
_MIN_FORCE_ERROR = 0.3  # norm of a change of the data that is left out, in standard deviations
_DERIVATIVE_RTOL = 2e-3  # of the solves for derivatives
_ROUGH_TOLERANCE, _TOLERANCE = 0.5, 0.02  # of fits; rough with quadratic elements, but the last
_RTOL = 1e-6  # of equilibria: far below the noise of a sensor


class ShapeProblem:
    """The presses with quadratic elements and with linear ones.

    Args:
        recording: The presses.
        settings: Noise, solver, bounds and equilibrium search are used.
        stop: Called before each step of a fit and each equilibrium of a correction, by one thread
            at a time; once it is true they raise `CancelledError`.
        kept: Errors at rims of an earlier search on fewer presses; those of others are added.

    Attributes:
        quadratic: The presses with quadratic elements, on which models are judged.
        linear: The presses with linear elements, on which they are tried.
        sites: Volumes of the quadrature points of the quadratic elements.
        prior: Prior of the parameters of shapes.
        matched: Matched filter for balls.
        least_errors: Errors of the data in the simplest model.
    """

    def __init__(
        self,
        recording: Recording,
        settings: Settings,
        stop: Callable[[], bool] = lambda: False,
        kept: KeptRims | None = None,
    ) -> None:
        self._stop, self._is_stopped, self._lock = stop, False, Lock()
        self._kept = kept or KeptRims()
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
        self._correction = None
        if not same:
            self._correction = Correction.of(
                self.quadratic, self._element, settings.solver, self._kept
            )
        singular = self._correction is not None and self._correction.has_singular_ends
        self.least_errors = Errors(
            0.0, 0.0 if same else MIN_POSE_DEVIATION, EDGE_DEVIATION if singular else 0.0
        )
        self._corrected_at: ShapeFit | None = None
        self._correction_mm = [np.zeros(count) for count in self.quadratic.data.counts]
        youngs = uniform_fit(self.linear, settings.bounds).youngs_mpa
        self.matched = MatchedFilter.of(self.linear, youngs)
        self.prior = ShapePrior.of(recording.mesh, youngs)
        self._noisy: dict[Errors, DataModel] = {}
        self._last: tuple[ShapeFit, Evaluation] | None = None
        self._floored = noise.floored(recording)
        observations = self.quadratic.data.observations
        self._rigid_patterns = rigid_patterns(recording.mesh.points, observations, contacts)
        self._patterns = ErrorPatterns(self._rigid_patterns)

    @property
    def has_rims(self) -> bool:
        """Whether the traction of a contact is uncertain where it ends."""
        return self._correction is not None and bool(self._correction.uncertain)

    def uniform(self) -> Model:
        """Fit the uniform body with quadratic elements."""
        return self.first(Start("uniform", ShapeField(self.prior), np.zeros(1), self.least_errors))

    def first(self, start: Start) -> Model:
        """Fit the first model of a search with quadratic elements.

        Raises:
            ConvergenceError: it has no equilibrium under the recorded forces.
        """
        extend, field = self.quadratic.body.discretisation.extend, start.field
        youngs = ShapesOnSites(field, self._linear_sites).at(start.z).youngs
        coarse = self.linear.evaluate(youngs)
        forces = coarse.force_patterns(_MIN_FORCE_ERROR / FORCE_DEVIATIONS[-1])
        pose = self._rigid_patterns
        if self.quadratic.recording.has_probes:
            probes = probe_patterns(self.quadratic.recording, coarse)
            pose = np.hstack([pose, probes])
        self._patterns = ErrorPatterns(pose, forces)
        displacements = [extend(u) for u in coarse.displacements]
        has_contacts = self._correction is not None and self._correction.has_contacts
        if not has_contacts and not has_errors(self.quadratic.recording):
            return self.fit(start, displacements)
        youngs = ShapesOnSites(field, self.sites).at(start.z).youngs
        evaluation = self.quadratic.evaluate(youngs, starts=displacements)
        self._linearise_errors(evaluation)
        if self._correction is not None and self.has_rims:
            rims = rim_patterns(
                self.quadratic.recording, evaluation, self._correction.uncertain,
                _MIN_FORCE_ERROR / RIM_DEVIATIONS[-1], self._kept,
            )  # fmt: skip
            self._patterns = replace(self._patterns, rims=rims)
        model = self.fit(start, evaluation.displacements)
        return self.corrected(model) if has_contacts else model

    def _linearise_errors(self, evaluation: Evaluation) -> None:
        """Compute the patterns of the correlated errors of the presses about an evaluation."""
        recording = self.quadratic.recording
        if has_errors(recording):
            stated = error_patterns(evaluation.with_data(self.quadratic.data), recording)
            self._patterns = replace(self._patterns, stated=stated)
            self._noisy.clear()

    def continued(self, result: ShapeReconstruction | ShapeState) -> Start:
        """Return the model of a search on other presses of the same object."""
        field, z = result.field.changed(result.z, prior=self.prior)
        pose = max(result.pose_deviation, self.least_errors.pose)
        rims = max(result.rim_deviation, self.least_errors.rims) if self.has_rims else 0.0
        return Start("the model before", field, z, Errors(result.force_deviation, pose, rims))

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
        by the derivatives of linear elements, or between steps.
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
        """Return predictions of quadratic elements as a fit with derivatives of linear ones."""
        point = ShapesOnSites(start.field, self._linear_sites).at(z)
        data = self.data(start.errors)
        columns = point.jacobian(self.linear.evaluate(point.youngs).with_data(data))
        hessian, residuals = columns.T @ columns + np.eye(len(z)), evaluation.residuals
        determinant = float(np.linalg.slogdet(hessian)[1]) + data.log_determinant
        return ShapeFit(
            start.field, z, np.linalg.inv(hessian), evaluation.chi2,
            0.5 * float(residuals @ residuals), start.field.penalty(z), 0.5 * determinant,
            residuals, columns, z,
        )  # fmt: skip

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
        before = self.quadratic, self._correction_mm, self._patterns
        try:
            offsets = self._correction.offsets(model.fit, model.evaluation, self._check)
            self._linearise_errors(model.evaluation)
            pairs = zip(self._correction_mm, offsets, strict=True)
            data = self.quadratic.data.shifted([old - new for old, new in pairs])
            self.quadratic, self._correction_mm = self.quadratic.with_data(data), offsets
            self._noisy.clear()
            corrected = self._fit_further(model, "corrected", tolerance)
            self._corrected_at = model.fit
            return corrected
        except (ConfigError, ConvergenceError) as error:
            self.quadratic, self._correction_mm, self._patterns = before
            self._noisy.clear()
            _log.warning("The error of the discretisation is not corrected: %s", error)
            return model

    def try_model(self, start: Start, offsets: list[np.ndarray]) -> tuple[Trial, np.ndarray]:
        """Fit with linear elements, whose predictions have errors; return evidence and parameters.

        Args:
            start: Model and parameters to start from.
            offsets: See `offsets`.
        """
        self._check()
        problem = self.linear.with_data(self.data(start.errors).shifted(offsets))
        try:
            fit, _ = fit_shapes(
                problem, start.field, start.z, sites=self._linear_sites,
                max_iterations=_TRIAL_STEPS, tolerance=_TOLERANCE, give_up=self._never,
            )  # fmt: skip
        except ConvergenceError:
            return Trial(np.inf, np.inf, 0.0), start.z
        return Trial(fit.chi2, fit.misfit, -fit.log_evidence(np.inf)), fit.z

    def offsets(self, model: Model) -> list[np.ndarray]:
        """Return predictions of linear less those of quadratic elements at a model."""
        pairs = zip(self._coarse(model).predicted, model.evaluation.predicted, strict=True)
        return [linear - quadratic for linear, quadratic in pairs]

    def jacobian(self, model: Model) -> Float[np.ndarray, "data size"]:
        """Return the derivatives of the residuals of white noise by a model's parameters."""
        field = ShapesOnSites(model.fit.field, self.sites)
        return field.at(model.fit.z).jacobian(self._raw(model))

    def coarse_jacobian(
        self, model: Model, field: ShapeField, z: Float[np.ndarray, " size"]
    ) -> Float[np.ndarray, "data size"]:
        """Return the derivatives of the residuals of white noise, by linear elements.

        Args:
            model: The model.
            field: A field, maybe with further parameters.
            z: Its parameters, for which its map is that of the model.
        """
        coarse = self._coarse(model).with_data(self.quadratic.data)
        return ShapesOnSites(field, self._linear_sites).at(z).jacobian(coarse)

    def _coarse(self, model: Model) -> Evaluation:
        """Return the predictions of linear elements; those of the last model are kept."""
        if self._last is None or self._last[0] is not model.fit:
            field = ShapesOnSites(model.fit.field, self._linear_sites).at(model.fit.z)
            self._last = model.fit, self.linear.evaluate(field.youngs)
        return self._last[1]

    def linearised(
        self,
        model: Model,
        z: Float[np.ndarray, " size"],
        jacobian: Float[np.ndarray, "data size"],
        errors: Errors,
    ) -> Trial:
        """Return the evidence of a linearised model with these errors of the data.

        Args:
            model: The model about which it is linearised.
            z: Parameters for which its map is that of the model.
            jacobian: Their derivatives, see `jacobian`.
            errors: Errors of the data.
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

    def data(self, errors: Errors) -> DataModel:
        """Return the data with these errors; their covariances are computed once."""
        if errors not in self._noisy:
            self._noisy[errors] = self._with_errors(errors)
        return self._noisy[errors]

    def _with_errors(self, errors: Errors) -> DataModel:
        data = self.quadratic.data
        if self._correction is not None:
            data = data.with_errors(_CORRECTION_DEVIATION * self._correction_patterns())
        return self._patterns.added_to(data, errors)

    def _correction_patterns(self) -> Float[np.ndarray, "data contacts"]:
        """Return the corrections of each contact, in standard deviations of the white noise."""
        assert self._correction is not None
        columns = []
        for numbers, _ in self._correction.contacts:
            parts = [(k in numbers) * mm for k, mm in enumerate(self._correction_mm)]
            columns.append(np.concatenate(parts) * self.quadratic.data.scale)
        return np.column_stack(columns)


def _predicted_fall(fit: ShapeFit) -> float:
    """Return the fall of the objective by a Gauss-Newton step."""
    gradient = fit.jacobian.T @ fit.residuals + fit.z
    return 0.5 * float(gradient @ fit.covariance @ gradient)


def is_same_model(recording: Recording) -> bool:
    """Return whether the recording's mesh, on which the presses were computed, is the object."""
    return bool(recording.provenance.get("inverse_crime"))
