"""The search for inclusions: proposals by linear elements, decisions by quadratic ones.

A model is a background, uniform, smooth or layered, with a number of balls and ellipsoids, and
deviations of the recorded forces and poses. From a model others follow: with a further ball where a
matched filter sees one in the residuals, with a background of more modes, with a ball as an
ellipsoid, or with larger errors of the forces or poses. Each is fitted with linear elements, whose
data are shifted so that they agree with quadratic elements at the present model. They are then
fitted with quadratic elements, the best first, and the first that raises the evidence enough is
accepted.
"""

import logging
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError, ConvergenceError
from tactorch.fem import NewtonOptions
from tactorch.inverse.data import DataModel, group_by_contact, rigid_patterns
from tactorch.inverse.problem import Evaluation, InverseProblem
from tactorch.inverse.settings import Settings
from tactorch.inverse.shapes.correction import Correction
from tactorch.inverse.shapes.field import ShapeField, ShapePrior, Sites
from tactorch.inverse.shapes.fit import ShapeFit, ShapesOnSites, fit_shapes
from tactorch.inverse.shapes.matched import MatchedFilter
from tactorch.inverse.shapes.posterior import ShapePosterior
from tactorch.inverse.shapes.result import ShapeReconstruction
from tactorch.inverse.shapes.sizing import contact_sizing
from tactorch.inverse.starts import uniform_fit
from tactorch.recording import Recording, refine_recording

_log = logging.getLogger(__name__)
_STARTS = 3  # fits of each further inclusion
_TRIAL_STEPS = 8  # of Gauss-Newton with linear elements
_MAX_SHAPES = 4
_MAX_MODELS = 10  # one after the other
_MAX_FITS = 3  # with quadratic elements, of proposals from one model
_DEGREES = (2, 4)  # of smooth backgrounds
_LAYERS = 8  # largest wave number of layers
_FORCE_DEVIATIONS = (0.02, 0.05, 0.1)
_MIN_POSE_DEVIATION = 0.001  # that of the discretisation after its correction
_POSE_DEVIATIONS = (0.002, 0.01, 0.05)
# Error of the discretisation that remains after its correction, over the displacements. It is the
# same in all presses of a contact.
_DISCRETISATION = 1e-3
_CORRECTION_DEVIATION = 0.3  # of the correction of each contact, over the correction
_MIN_FORCE_ERROR = 0.3  # norm of a change of the data that is left out, in standard deviations
_MAX_LOG_ODDS = 1e6  # where the model without an inclusion has no equilibrium
_MIN_GAIN = 3.0  # of the log-evidence, for a model that is accepted
# Smallest linearised reduction of the misfit that is worth a fit: the best of a few hundred balls
# reduces that of pure noise by six or so.
_MIN_CANDIDATE_GAIN = 8.0
_MAX_START_CONTRAST = 1.0  # log-contrast of a start with quadratic elements
_START_CONTRAST = (0.3, 1.5)  # range of the log-contrast of a start
_DERIVATIVE_RTOL = 2e-3  # of the solves for derivatives
_ROUGH_TOLERANCE, _TOLERANCE = 0.5, 0.02  # of fits; rough with quadratic elements, but the last
_SAME = 2.0  # distance of centres, in radii, below which two starts are of the same ball
_RTOL = 1e-6  # of equilibria: far below the noise of a sensor


class Errors(NamedTuple):
    """Relative deviations of errors that the data have in common."""

    forces: float  # of the forces of each press
    pose: float  # of rigid motions at each place, over the observed displacements

    def others(self, least: "Errors") -> Iterator["tuple[str, Errors]"]:
        """Yield errors that differ in one respect, at least these, with their descriptions."""
        for level in (least.forces, *_FORCE_DEVIATIONS):
            if level != self.forces:
                yield f"forces wrong by {level:.0%}", self._replace(forces=level)
        for level in (least.pose, *_POSE_DEVIATIONS):
            if level != self.pose:
                yield f"poses wrong by {level:.1%}", self._replace(pose=level)


@dataclass(frozen=True, eq=False)
class _Start:
    """A model to be fitted."""

    what: str
    field: ShapeField
    z: Float[np.ndarray, " size"]
    errors: Errors


class _Trial(NamedTuple):
    """Evidence of a model that is fitted with linear elements, or to linearised predictions."""

    chi2: float
    misfit: float
    complexity: float  # the negative log-evidence but for the misfit

    def log_evidence(self, inflation: float) -> float:
        """Return the log-evidence where the variance of the noise is `inflation` times as large."""
        return -self.misfit / inflation - self.complexity


@dataclass(frozen=True, eq=False)
class _Proposal(_Start):
    """A model with the evidence of its trial."""

    trial: _Trial


@dataclass(frozen=True, eq=False)
class _Model:
    """A model fitted with quadratic elements."""

    fit: ShapeFit
    evaluation: Evaluation
    errors: Errors


class _Search:
    """The presses with quadratic elements and with linear ones."""

    def __init__(self, recording: Recording, settings: Settings) -> None:
        same, self._element = _same_model(recording), "tet10"
        if same:
            self._element = str(recording.provenance.get("element", settings.element))
        newton = NewtonOptions(rtol=max(settings.newton.rtol, _RTOL))
        noise = settings.noise
        if not same:
            floor = _DISCRETISATION * np.sqrt(len(recording.presses) / _n_contacts(recording))
            noise = replace(noise, relative=max(noise.relative, float(floor)))
        self._floored = noise.floored(recording)
        options: dict[str, Any] = {"solver": settings.solver, "noise": noise}

        def problem(element: str, **more: Any) -> InverseProblem:
            return InverseProblem(recording, element=element, newton=newton, **options, **more)

        self.quadratic = problem(self._element, derivative_rtol=_DERIVATIVE_RTOL)
        self.sites = Sites.of(self.quadratic.body.assembly)
        self.linear = problem("tet4")
        self.linear_sites = Sites.of(self.linear.body.assembly)
        # Where the presses were computed on this mesh, it is the object.
        self._correction = None
        if not same:
            self._correction = Correction.of(self.quadratic, self._element, settings.solver)
        self._least_errors = Errors(0.0, 0.0 if same else _MIN_POSE_DEVIATION)
        self._correction_mm = [np.zeros(count) for count in self.quadratic.data.counts]
        youngs = uniform_fit(self.linear, settings.bounds).youngs_mpa
        self.matched = MatchedFilter.of(self.linear, youngs)
        self.prior = ShapePrior.of(recording.mesh, youngs)
        self._force_patterns: np.ndarray | None = None
        self._noisy: dict[Errors, DataModel] = {}
        observations = self.quadratic.data.observations
        contacts = group_by_contact(recording.presses, observations)
        self._pose_patterns = rigid_patterns(recording.mesh.points, observations, contacts)

    def precise(self, model: _Model) -> _Model:
        """Return the model corrected for the discretisation, if the noise may be less than that.

        Otherwise the search would explain the error of the discretisation by more inclusions.
        """
        return self._corrected(model) if self._correction and self._floored else model

    def final(self, model: _Model) -> _Model:
        """Return the model fitted closely, with predictions corrected for the discretisation."""
        if self._correction is not None:
            corrected = self._corrected(model, _TOLERANCE)
            if corrected is not model:
                return corrected
        start = _Start("final", model.fit.field, model.fit.z, model.errors)
        return self.fit(start, model.evaluation.displacements, _TOLERANCE)

    def _corrected(self, model: _Model, tolerance: float = _ROUGH_TOLERANCE) -> _Model:
        """Return the model fitted to data that are shifted by the error of the discretisation.

        The model remains, with a warning, where a finer mesh fails.
        """
        assert self._correction is not None
        before = self.quadratic, self._correction_mm
        try:
            offsets = self._correction.offsets(model.fit, model.evaluation)
            pairs = zip(self._correction_mm, offsets, strict=True)
            data = self.quadratic.data.shifted([old - new for old, new in pairs])
            self.quadratic, self._correction_mm = self.quadratic.with_data(data), offsets
            self._noisy.clear()
            start = _Start("corrected", model.fit.field, model.fit.z, model.errors)
            return self.fit(start, model.evaluation.displacements, tolerance)
        except (ConfigError, ConvergenceError) as error:
            self.quadratic, self._correction_mm = before
            self._noisy.clear()
            _log.warning("The error of the discretisation is not corrected: %s", error)
            return model

    def uniform(self) -> _Model:
        """Fit the uniform body with quadratic elements."""
        youngs = np.full(self.linear.n_elements, np.exp(self.prior.log_background))
        extend, coarse = self.quadratic.body.discretisation.extend, self.linear.evaluate(youngs)
        self._force_patterns = coarse.force_patterns(_MIN_FORCE_ERROR / _FORCE_DEVIATIONS[-1])
        start = _Start("uniform", ShapeField(self.prior), np.zeros(1), self._least_errors)
        model = self.fit(start, [extend(u) for u in coarse.displacements])
        if self._correction is None or not self._correction.has_rims:
            return model
        return self._corrected(model)

    def fit(
        self,
        start: _Start,
        displacements: Sequence[Float[np.ndarray, "nodes 3"]],
        tolerance: float = _ROUGH_TOLERANCE,
    ) -> _Model:
        """Fit with quadratic elements, from these displacements."""
        problem = self.quadratic.with_data(self._data(start.errors))
        fit = fit_shapes(
            problem, start.field, start.z, sites=self.sites, starts=displacements,
            tolerance=tolerance,
        )  # fmt: skip
        return _Model(*fit, start.errors)

    def _data(self, errors: Errors) -> DataModel:
        """Return the data with these errors; their covariances are computed once."""
        if errors not in self._noisy:
            self._noisy[errors] = self._with_errors(errors)
        return self._noisy[errors]

    def _with_errors(self, errors: Errors) -> DataModel:
        data = self.quadratic.data
        if self._correction is not None:
            data = data.with_errors(_CORRECTION_DEVIATION * self._correction_patterns())
        if errors.pose:
            data = data.with_errors(errors.pose * self._pose_patterns)
        if errors.forces:
            assert self._force_patterns is not None
            data = data.with_errors(errors.forces * self._force_patterns)
        return data

    def _correction_patterns(self) -> Float[np.ndarray, "data contacts"]:
        """Return the corrections of each contact, in standard deviations of the white noise."""
        assert self._correction is not None
        columns = []
        for numbers, _ in self._correction.contacts:
            parts = [(k in numbers) * mm for k, mm in enumerate(self._correction_mm)]
            columns.append(np.concatenate(parts) * self.quadratic.data.scale)
        return np.column_stack(columns)

    def posterior(self, model: _Model) -> ShapePosterior:
        """Return the posterior of a model, where balls may be ellipsoids.

        The data of a ball's evidence do not exclude an ellipsoid, whose modulus and size are less
        certain, and differ. The model is linearised at the balls.
        """
        fit = model.fit
        field, z = fit.field, fit.z
        for k in range(len(field.distorted)):
            field, z = _distorted(field, z, k)
        inflation = max(1.0, fit.chi2)
        jacobian = ShapesOnSites(field, self.sites).at(z).jacobian(model.evaluation)
        covariance = np.linalg.inv(jacobian.T @ jacobian / inflation + np.eye(len(z)))
        gradient = jacobian.T @ fit.residuals / inflation + z
        return ShapePosterior(field, z, -covariance @ gradient, covariance)

    def propose(self, model: _Model, max_shapes: int) -> list[_Proposal]:
        """Return models that seem better than the present one, the best first.

        They are compared at the noise of the one that explains the data best: at the noise that the
        present model would need, the differences between them are lost.
        """
        fit, offsets = model.fit, self._offsets(model)
        proposals = list(self._other_errors(model))
        for start in self._starts(model, max_shapes):
            # A start inside a ball that was fitted already would lead to it again.
            if not any(_is_inside(start, proposal) for proposal in proposals):
                trial, z = self._try(start, model, offsets)
                if len(start.field.distorted) > len(fit.field.distorted):
                    z = _moderate(start.field, z)
                proposals.append(_Proposal(start.what, start.field, z, start.errors, trial))
        inflation = max(1.0, min([fit.chi2, *(p.trial.chi2 for p in proposals)]))
        gains = [p.trial.log_evidence(inflation) - fit.log_evidence(inflation) for p in proposals]
        for proposal, gain in zip(proposals, gains, strict=True):
            chi2 = proposal.trial.chi2
            _log.debug("proposal: %s, chi2 %.4g, log-evidence %+.4g", proposal.what, chi2, gain)
        best = sorted(zip(gains, range(len(gains)), proposals, strict=True), reverse=True)
        return [proposal for gain, _, proposal in best if gain > _MIN_GAIN]

    def _other_errors(self, model: _Model) -> Iterator[_Proposal]:
        """Yield the model with other errors of the data; the fits are linearised."""
        fit = model.fit
        jacobian = ShapesOnSites(fit.field, self.sites).at(fit.z).jacobian(self._raw(model))
        for what, errors in model.errors.others(self._least_errors):
            trial = self._linearised(model, fit.z, jacobian, errors)
            yield _Proposal(what, fit.field, fit.z, errors, trial)

    def _raw(self, model: _Model) -> Evaluation:
        """Return the predictions of a model with the residuals of white noise."""
        return model.evaluation.with_data(self.quadratic.data)

    def _linearised(
        self,
        model: _Model,
        z: Float[np.ndarray, " size"],
        jacobian: Float[np.ndarray, "data size"],
        errors: Errors,
    ) -> _Trial:
        """Return the evidence of the linearised model at z, by which its map is the present one."""
        data, inflation = self._data(errors), max(1.0, model.fit.chi2)
        residuals, columns = data.whiten(self._raw(model).residuals), data.whiten(jacobian)
        hessian = columns.T @ columns
        gradient = columns.T @ residuals / inflation + z
        step = -np.linalg.solve(hessian / inflation + np.eye(len(z)), gradient)
        residuals, z = residuals + columns @ step, z + step
        logs = np.linalg.slogdet(hessian + np.eye(len(z)))[1] + data.log_determinant
        squares = float(residuals @ residuals)
        return _Trial(squares / len(residuals), 0.5 * squares, 0.5 * float(z @ z + logs))

    def unexplained(self, fit: ShapeFit) -> float:
        """Return the root mean square of the residuals beyond their noise, over the data's."""
        data = self.quadratic.data
        observed = np.concatenate([o.displacement for o in data.observations]) * data.scale
        return float(np.sqrt(max(fit.chi2 - 1.0, 0.0) / np.mean(observed**2)))

    def log_odds(self, model: _Model) -> tuple[tuple[float, ...], float]:
        """Return the log-evidence of a model over those without an inclusion, or without any."""
        count, offsets = len(model.fit.field.parts), self._offsets(model)

        def without(removed: Sequence[int]) -> float:
            start = _Start(f"without {removed}", *_without(model.fit, removed), model.errors)
            inflation, (trial, _) = max(1.0, model.fit.chi2), self._try(start, model, offsets)
            odds = model.fit.log_evidence(inflation) - trial.log_evidence(inflation)
            return min(odds, _MAX_LOG_ODDS)

        each = tuple(without([k]) for k in range(count))
        return each, (each[0] if count == 1 else without(range(count)) if count else 0.0)

    def _try(
        self, start: _Start, model: _Model, offsets: list[np.ndarray]
    ) -> tuple[_Trial, np.ndarray]:
        """Fit with linear elements; return the evidence, and the parameters."""
        problem = self.linear.with_data(self._data(start.errors).shifted(offsets))
        try:
            fit, _ = fit_shapes(
                problem, start.field, start.z, sites=self.linear_sites,
                max_iterations=_TRIAL_STEPS, tolerance=_TOLERANCE,
            )  # fmt: skip
        except ConvergenceError:
            return _Trial(np.inf, np.inf, 0.0), start.z
        return _Trial(fit.chi2, fit.misfit, -fit.log_evidence(np.inf)), fit.z

    def _offsets(self, model: _Model) -> list[np.ndarray]:
        """Return predictions of linear less those of quadratic elements at a model, mm."""
        field = ShapesOnSites(model.fit.field, self.linear_sites).at(model.fit.z)
        coarse, observations = self.linear.evaluate(field.youngs), self.quadratic.data.observations
        pairs = zip(coarse.reported, model.evaluation.reported, observations, strict=True)
        return [(u - v).ravel()[o.index] for u, v, o in pairs]

    def _starts(self, model: _Model, max_shapes: int) -> Iterator[_Start]:
        fit, errors = model.fit, model.errors
        if len(fit.field.distorted) < max_shapes:
            yield from self._further(fit, errors)
        for degree in _DEGREES:
            if degree > fit.field.degree:
                yield _Start(f"background of degree {degree}", *_varied(fit, degree=degree), errors)
                break
        yield from self._layers(model)
        for k, distorted in enumerate(fit.field.distorted):
            # A further part of the model may explain what an inclusion was found for.
            if len(fit.field.distorted) > 1 or len(fit.field.waves):
                yield _Start(f"inclusion {k} removed", *_without(fit, [k]), errors)
            if not distorted:
                other = _distorted(fit.field, fit.z, k)
                yield _Start(f"inclusion {k} as an ellipsoid", *other, errors)

    def _layers(self, model: _Model) -> Iterator[_Start]:
        """Yield the model with layers across the axis that explains most, if there are none yet."""
        fit, raw, starts = model.fit, self._raw(model), list[tuple[float, int, _Start]]()
        for axis in range(3) if not any(fit.field.layers) else ():
            layers = tuple(_LAYERS if k == axis else 0 for k in range(3))
            field, z = _varied(fit, layers=layers)
            jacobian = ShapesOnSites(field, self.sites).at(z).jacobian(raw)
            evidence = self._linearised(model, z, jacobian, model.errors).log_evidence(
                max(1.0, fit.chi2)
            )
            start = _Start(f"layers across {'xyz'[axis]}", field, z, model.errors)
            starts.append((evidence, axis, start))
        if starts:
            evidence, _, best = max(starts)
            if evidence > fit.log_evidence(max(1.0, fit.chi2)):
                yield best

    def _further(self, fit: ShapeFit, errors: Errors) -> Iterator[_Start]:
        field = replace(fit.field, distorted=(*fit.field.distorted, False))
        data = self._data(errors)
        for candidate in self.matched.best(fit.residuals, fit.jacobian, data, _STARTS):
            if candidate.gain < _MIN_CANDIDATE_GAIN:
                return
            size = np.clip(abs(candidate.log_contrast), *_START_CONTRAST)
            contrast = np.copysign(size, candidate.log_contrast)
            ball = [*candidate.center_mm, np.log(candidate.radius_mm), contrast]
            start = field.standard(np.concatenate([fit.field.physical(fit.z), ball]))
            what = f"ball at {np.round(candidate.center_mm, 1).tolist()} mm"
            yield _Start(what, field, start, errors)


def find_shapes(
    recording: Recording, settings: Settings | None = None, *, max_shapes: int = _MAX_SHAPES
) -> ShapeReconstruction:
    """Find the inclusions that the presses determine, with the number that the evidence supports.

    The truth and the reference that a recording may carry are never read.

    Args:
        recording: Presses on an object.
        settings: Noise, solver, bounds and equilibrium search are used. Elements are quadratic, and
            smaller than those of the recording at the rims of contacts, and predictions are
            corrected by finer meshes there and at inclusions, unless the provenance states that the
            presses were computed on the recording's mesh.
        max_shapes: Largest number of inclusions.

    Raises:
        ConfigError: a setting cannot be used.
        ConvergenceError: with no uniform modulus do all presses have an equilibrium, or linear
            elements have none where quadratic ones have.
    """
    settings = settings or Settings()
    if not _same_model(recording):
        recording = refine_recording(recording, contact_sizing(recording))
    search = _Search(recording, settings)
    model = search.uniform()
    history = [_record("uniform", model)]
    _log.info("uniform body: chi2 %.4g", model.fit.chi2)
    for _ in range(_MAX_MODELS):
        proposals = search.propose(model, max_shapes)
        accepted = _accept(search, model, proposals)
        if accepted is None:
            break
        proposal, model = accepted
        model = search.precise(model)
        history.append(_record(proposal.what, model))
    try:
        model = search.final(model)
    except ConvergenceError as error:
        _log.warning("The last fit fails, and the model is that of the search: %s", error)
    history.append(_record("final fit", model))
    _log.info("final fit: chi2 %.4g", model.fit.chi2)
    each, any_ = search.log_odds(model)
    fit = model.fit
    return ShapeReconstruction(
        fit.field, fit.z, search.posterior(model), fit.chi2, each, any_,
        *model.errors, search.unexplained(fit), tuple(history),
    )  # fmt: skip


def _same_model(recording: Recording) -> bool:
    """Whether the presses were computed on the recording's mesh, which then is the object."""
    return bool(recording.provenance.get("inverse_crime"))


def _n_contacts(recording: Recording) -> int:
    return len({(press.forces != 0).any(axis=1).tobytes() for press in recording.presses})


def _record(what: str, model: _Model) -> dict[str, Any]:
    evidence = model.fit.log_evidence(max(1.0, model.fit.chi2))
    return {"model": what, "chi2": model.fit.chi2, "log_evidence": evidence}


def _accept(
    search: _Search, model: _Model, proposals: list[_Proposal]
) -> tuple[_Proposal, _Model] | None:
    """Fit proposals with quadratic elements until one has more evidence than the model."""
    for proposal in proposals[:_MAX_FITS]:
        with suppress(ConvergenceError):
            trial = search.fit(proposal, model.evaluation.displacements)
            inflation = max(1.0, min(model.fit.chi2, trial.fit.chi2))
            gain = trial.fit.log_evidence(inflation) - model.fit.log_evidence(inflation)
            _log.info("%s: chi2 %.4g, log-evidence %+.4g", proposal.what, trial.fit.chi2, gain)
            if gain > _MIN_GAIN:
                return proposal, trial
    return None


def _varied(fit: ShapeFit, **background: Any) -> tuple[ShapeField, np.ndarray]:
    """Return the model with more modes of the background, which start at zero."""
    field = replace(fit.field, **background)
    old = fit.field.physical(fit.z)
    known = dict(zip(map(tuple, fit.field.waves), old[1 : fit.field.n_background], strict=True))
    modes = [known.get(tuple(wave), 0.0) for wave in field.waves]
    return field, field.standard(np.array([old[0], *modes, *old[fit.field.n_background :]]))


def _without(fit: ShapeFit, removed: Sequence[int]) -> tuple[ShapeField, np.ndarray]:
    """Return the model without some of its inclusions, and a start."""
    field, values = fit.field, fit.field.physical(fit.z)
    kept = [k for k in range(len(field.parts)) if k not in removed]
    fewer = replace(field, distorted=tuple(field.distorted[k] for k in kept))
    parts = [values[: field.n_background], *(values[field.parts[k]] for k in kept)]
    return fewer, fewer.standard(np.concatenate(parts))


def _distorted(
    field: ShapeField, z: Float[np.ndarray, " size"], inclusion: int
) -> tuple[ShapeField, np.ndarray]:
    """Return the model with an inclusion as an ellipsoid, at first of no distortion."""
    if field.distorted[inclusion]:
        return field, z
    distorted = tuple(d or i == inclusion for i, d in enumerate(field.distorted))
    values, end = field.physical(z), field.parts[inclusion].stop
    values = np.concatenate([values[:end], np.zeros(5), values[end:]])
    field = replace(field, distorted=distorted)
    return field, field.standard(values)


def _is_inside(start: _Start, proposal: _Proposal) -> bool:
    """Whether both are with a further ball, whose centres are near each other."""
    field = proposal.field
    if not (start.what.startswith("ball") and proposal.what.startswith("ball")):
        return False
    first, end = field.parts[-1].start, field.parts[-1].start + 3
    centers = (field.physical(z)[first:end] for z in (start.z, proposal.z))
    radius = np.exp(field.physical(proposal.z)[end])
    return bool(np.linalg.norm(np.subtract(*centers)) < _SAME * radius)


def _moderate(field: ShapeField, z: Float[np.ndarray, " size"]) -> Float[np.ndarray, " size"]:
    """Return the model with the last ball of moderate contrast and of the same far field.

    A ball in a uniform strain acts from afar by its volume times (c - 1) / (c + 3/2), with c its
    contrast (Eshelby, 1957, for nearly incompressible bodies). Where the contrast is large the
    data hardly depend on it, and the steps of a fit become small.
    """
    values = field.physical(z)
    radius, contrast = field.parts[-1].start + 3, field.parts[-1].start + 4
    log = np.clip(values[contrast], -_MAX_START_CONTRAST, _MAX_START_CONTRAST)
    old, new = ((np.exp(x) - 1.0) / (np.exp(x) + 1.5) for x in (values[contrast], log))
    if old != new:
        values[radius] += np.log(old / new) / 3.0
        values[contrast] = log
    return field.standard(values)
