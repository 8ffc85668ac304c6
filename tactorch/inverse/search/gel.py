"""Presses of sensors, and grasps, as problems of the search: gels and object in one equilibrium."""

import logging
from collections.abc import Callable, Sequence
from contextlib import suppress

import numpy as np
from jaxtyping import Float

from tactorch.errors import UNCOMPUTABLE, CancelledError, ConvergenceError
from tactorch.inverse.data.observations import DataModel
from tactorch.inverse.errors import ErrorModel, Levels, MeasuredPresses
from tactorch.inverse.fields import InclusionShape, ShapeField, ShapePrior, Sites, Vector
from tactorch.inverse.fit.settings import Settings
from tactorch.inverse.fit.shapes import ShapesOnSites
from tactorch.inverse.fit.starts import best_uniform
from tactorch.inverse.forward.gel import GelEvaluation, GelProblem, pressed, within_contacts
from tactorch.inverse.forward.predictions import Predictions
from tactorch.inverse.forward.problem import InverseProblem
from tactorch.inverse.forward.reduced import ReducedProblem
from tactorch.inverse.posterior.shapes import ShapePosterior
from tactorch.inverse.search.base import FORMS, SearchProblem
from tactorch.inverse.search.final_posterior import final_posterior
from tactorch.inverse.search.gel_correction import (
    GelCorrection,
    gel_sites,
    with_gel_errors,
)
from tactorch.inverse.search.matched import MatchedFilter
from tactorch.inverse.search.model import Model, Start
from tactorch.inverse.search.proposals import (
    backgrounds,
    changed,
    further,
    joined,
    removed,
    split,
)
from tactorch.inverse.search.slabs import inclusions_as_steps, simpler_background, slabs
from tactorch.recording import Recording

_log = logging.getLogger(__name__)
_STEPS, _LARGEST, _CLOSE = 12, 1.5, 0.05  # steps of the log of a uniform modulus
_ROUGH = 0.3  # of a modulus that is fitted further
# Modulus over that of the gels beyond which the object is rigid: another one changes the force of
# a grasp by less than its deviation.
_RIGID = 1e2
# Distance of an inclusion from another, over its smallest detail, at which elements at the boundary
# of one are hardly larger at that of the other.
_NEAR = 0.25
# Change of the log-modulus that a correction outlasts: it changes as much, by less than the error
# that remains of it.
_SAME_LOG = 0.1
_MARGIN = 0.08  # distance of markers from the end of the contact, over its size


class GelSearch(SearchProblem):
    """Gels and object in one equilibrium; see `SearchProblem`.

    Errors of gels and poses, and of the mesh, are computed about a model, and have no levels.
    """

    full: GelProblem

    def _best_uniform(
        self, recording: Recording, settings: Settings, first_mpa: float, close: float
    ) -> GelEvaluation:
        """Return the presses, which are then `full`, at the uniform modulus that fits best.

        It is found from a first one, to a difference of its logarithm.

        Raises:
            ConvergenceError: a rigid object deforms the gels less than the data tell, or the
                modulus is beyond the bounds.
        """
        self.full = GelProblem(recording, first_mpa)
        found = self._uniform_evaluation(settings, first_mpa, close)
        best_mpa = float(found.youngs.flat[0])
        if best_mpa == first_mpa:
            return found
        # Points that do not slip are those that touch at this modulus.
        self.full = GelProblem(recording, best_mpa)
        return self.full.evaluate(found.youngs, starts=found.displacements)

    def _uniform_evaluation(
        self, settings: Settings, first_mpa: float, close: float
    ) -> GelEvaluation:
        bounds, problem = settings.bounds, self.full
        highest = min(np.log(bounds.upper), np.log(_RIGID * _gel_mpa(problem.recording)))
        youngs, starts = np.full(self.sites.shape, first_mpa), None
        for _ in range(_STEPS):
            self._check()
            evaluation = problem.evaluate(youngs, starts=starts)
            columns, _ = evaluation.linear_response(youngs.reshape(1, -1))
            column = columns[:, 0]
            step = -float(column @ evaluation.residuals) / max(float(column @ column), 1e-12)
            if abs(step) < close:
                return evaluation
            log = float(np.log(youngs.flat[0]))
            if log >= highest and step > 0.0 and highest < np.log(bounds.upper):
                raise ConvergenceError(
                    f"With {np.exp(log):.3g} MPa the object is rigid beside the gels, and a "
                    "stiffer one would fit better: a gripper is wider, a pose is deeper, or a gel "
                    "is stiffer, than stated. Check widths, poses and gels."
                )
            lowest, before = np.log(bounds.lower), log
            log = float(np.clip(log + np.clip(step, -_LARGEST, _LARGEST), lowest, highest))
            if log == before:
                raise ConvergenceError(
                    f"The best modulus is beyond {np.exp(log):.3g} MPa, a bound of the settings "
                    "(bounds.lower, bounds.upper). Check size, reference and units, or widen it."
                )
            youngs, starts = np.full_like(youngs, np.exp(log)), evaluation.displacements
        return evaluation

    def _linearise_about(self, evaluation: GelEvaluation) -> None:
        """Prepare the reduced model about a uniform body, whose equilibria are given."""
        mesh, self._first = self.full.recording.mesh, evaluation.displacements
        self._reduced_sites = Sites.around(mesh)
        self.reduced = ReducedProblem(self.full, evaluation)
        self.matched = MatchedFilter.of(self.reduced)
        self.prior = ShapePrior.of(mesh, float(evaluation.youngs.flat[0]))

    def _use(self, data: DataModel) -> None:
        """Fit to these data from now on."""
        self.full = self.full.with_data(data)
        self.errors = ErrorModel(MeasuredPresses(self.full), ())

    def first(self, start: Start) -> Model:
        """Fit the first model, from the equilibria about which errors are linearised."""
        return self.precise(self.fit(start, self._first))

    @property
    def contacts(self) -> Sequence[Sequence[int]]:
        """Numbers of the presses of each contact: those of the same first pose."""
        numbers = np.array(self.full.contact_of)
        return [np.flatnonzero(numbers == k).tolist() for k in range(int(numbers.max()) + 1)]

    def data(self, errors: Levels) -> DataModel:
        """Return the data, whose errors are those of gel and poses."""
        return self.full.data

    def posterior(self, model: Model) -> tuple[Model, ShapePosterior]:
        """Return the posterior, with the error of the sensor's position across its axis.

        It shifts the object under the gel, and markers hardly show it.
        """
        model, posterior = final_posterior(self, model)
        return model, posterior.misplaced(max(float(r.uncertain[1]) for r in self.full.readings))

    def misfit_rise(self, model: Model, z: Vector) -> float:
        """Return the rise of the sum of squares by the full model."""
        youngs = ShapesOnSites(model.fit.field, self.sites).at(z).youngs
        found = self.full.evaluate(youngs, starts=self.displacements(model, z))
        return float(np.sum(found.residuals**2)) - 2.0 * model.fit.misfit


class SensorSearch(GelSearch):
    """Presses of a sensor with markers: a search through gel and object; see `SearchProblem`.

    Markers within the contacts are used. What the mesh changes of them is corrected at each
    accepted model, by a mesh that is finer at the ends of contacts and at inclusions. Presses
    before first touch are left out.

    Raises:
        ConfigError: see `GelProblem`.
        ConvergenceError: a press has no equilibrium.
    """

    proposals = (
        further, backgrounds, slabs, simpler_background, removed, changed, joined, split,
        inclusions_as_steps,
    )  # fmt: skip
    forms = FORMS
    trial_steps = 20  # a form starts far from its best fit

    def __init__(
        self,
        recording: Recording,
        settings: Settings,
        stop: Callable[[], bool] = lambda: False,
        max_shapes: int = 0,
    ) -> None:
        super().__init__(stop, max_shapes)
        self.sites = gel_sites(recording.mesh)
        self._noise = settings.noise
        guess = gel_mpa = _gel_mpa(recording)
        some, touching = pressed(recording, gel_mpa)
        self._touching = touching
        by_forces = InverseProblem(recording, solver=settings.solver, noise=settings.noise)
        with suppress(ConvergenceError):
            guess = best_uniform(by_forces, settings.bounds)
        guess = float(np.clip(guess, gel_mpa / _RIGID, gel_mpa * _RIGID))
        first = self._best_uniform(some, settings, guess, _ROUGH)
        self._typical_mpa = typical = float(first.youngs.flat[0])
        rims = self.full.rims(first)
        within, numbers = within_contacts(some, rims, _MARGIN)
        self._rims = [rims[number] for number in numbers]
        self._numbers = [touching[number] for number in numbers]
        self._measured = self.full = GelProblem(within, typical)
        starts, youngs = self.full.take_over(first, numbers), first.youngs
        del first  # whose factorisations take gigabytes
        self._check()
        evaluation = self.full.evaluate(youngs, starts=starts)
        self._linearise_about(evaluation)
        self._fine_at: tuple[InclusionShape, ...] = ()
        self._correction = self._finer(())
        self._correct(ShapeField(self.prior), np.zeros(1), evaluation)

    def precise(self, model: Model) -> Model:
        """Return an accepted model, fitted to data that are corrected there."""
        return self._corrected(model) or model

    def final(self, model: Model) -> Model:
        """Return the model fitted closely to data that are corrected there."""
        return self._corrected(model, self.final_tolerance) or super().final(model)

    def _corrected(self, model: Model, tolerance: float | None = None) -> Model | None:
        """Return the model fitted to data that are corrected there; None where they are already."""
        shapes = tuple(model.fit.field.shapes(model.fit.z))
        change = np.log(model.evaluation.youngs / self._corrected_mpa)
        is_same = self._is_corrected(model) or np.abs(change).max() < _SAME_LOG
        is_fine = _are_near(shapes, self._fine_at)
        if is_fine and is_same:
            return None
        names = "full", "errors", "_correction", "_fine_at", "_corrected_mpa"
        before = {name: getattr(self, name) for name in names}
        self._check()
        try:
            if not is_fine:
                self._correction, self._fine_at = self._finer(shapes), shapes
            assert isinstance(model.evaluation, GelEvaluation)
            self._correct(model.fit.field, model.fit.z, model.evaluation)
            corrected = self._fit_further(model, "corrected", tolerance)
        except CancelledError:
            raise
        except UNCOMPUTABLE as error:
            vars(self).update(before)
            _log.warning("The error of the mesh is that of the model before: %s", error)
            return None
        self._corrected_at = model.fit, model.errors
        return corrected

    def _finer(self, shapes: Sequence[InclusionShape]) -> GelCorrection:
        return GelCorrection(self._measured, self._rims, self._typical_mpa, shapes)

    def _correct(self, field: ShapeField, z: Vector, evaluation: GelEvaluation) -> None:
        """Correct the data for the mesh, with errors about a model."""
        self._measured.forget()
        offsets = self._correction.offsets(field, z, evaluation, self._check)
        self._use(with_gel_errors(self._measured, evaluation, offsets))
        self._corrected_mpa = evaluation.youngs

    def predictions(self, model: Model, recording: Recording) -> Predictions | None:
        """Return the predictions of nodes of the object, which do not move before first touch."""
        n, youngs = recording.mesh.n_points, model.evaluation.youngs
        moved = np.zeros((len(recording.presses), n, 3))
        moved[self._numbers] = [u[:n] for u in model.evaluation.on_object]
        if left := sorted({*self._touching} - {*self._numbers}):
            problem = GelProblem(recording.select(left), self._typical_mpa)
            try:
                moved[left] = [u[:n] for u in problem.evaluate(youngs).on_object]
            except ConvergenceError as error:
                _log.warning("The presses of the result have no predictions: %s", error)
                return None
        return Predictions.of_nodes(moved, recording, self._noise)


class GraspSearch(GelSearch):
    """Grasps whose forces are measured: a search through gels and object; see `SearchProblem`.

    Errors of gels and widths are those at the best uniform body.
    """

    proposals = (further, removed, changed)

    def __init__(
        self,
        recording: Recording,
        settings: Settings,
        stop: Callable[[], bool] = lambda: False,
        max_shapes: int = 0,
    ) -> None:
        super().__init__(stop, max_shapes)
        self.sites = gel_sites(recording.mesh)
        evaluation = self._best_uniform(recording, settings, _gel_mpa(recording), _CLOSE)
        common = evaluation.uncertain(self.full.contact_of, self.full.readings)
        common = common[:, (common != 0.0).any(axis=0)]
        self._use(self.full.data.with_errors(common))
        self._linearise_about(evaluation)


def _are_near(shapes: Sequence[InclusionShape], others: Sequence[InclusionShape]) -> bool:
    """Whether inclusions are where others are, so that a mesh is fine at the boundaries of both."""
    if len(shapes) != len(others):
        return False
    for one, other in zip(shapes, others, strict=True):
        apart = np.linalg.norm(np.subtract(one.center_mm, other.center_mm))
        apart += np.linalg.norm(_lengths(one) - _lengths(other))
        if type(one) is not type(other) or apart > _NEAR * other.detail_mm:
            return False
    return True


def _lengths(shape: InclusionShape) -> Float[np.ndarray, "3 3"]:
    """Return a tensor of the lengths along the axes, mm."""
    axes = np.array(shape.axes)
    return np.asarray(axes.T @ (np.array(shape.semi_axes_mm)[:, None] * axes))


def _gel_mpa(recording: Recording) -> float:
    """Return the modulus of the stiffest gel, MPa."""
    return float(max(press.gel.layer[1] for press in recording.presses if press.gel is not None))
