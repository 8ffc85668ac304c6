"""The presses of contacts with known forces: quadratic elements, corrected by finer meshes."""

import logging
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError, ConvergenceError
from tactorch.fem import NewtonOptions
from tactorch.inverse.data.observations import group_by_contact
from tactorch.inverse.errors import ERRORS, ErrorModel, MeasuredPresses
from tactorch.inverse.errors.base import KeptRims
from tactorch.inverse.fields import ShapePrior, Sites
from tactorch.inverse.fit.settings import Settings
from tactorch.inverse.fit.shapes import ShapesOnSites
from tactorch.inverse.fit.starts import uniform_fit
from tactorch.inverse.forward.problem import InverseProblem
from tactorch.inverse.forward.reduced import ReducedProblem
from tactorch.inverse.posterior.shapes import ShapePosterior
from tactorch.inverse.search.base import FINE, FORMS, SearchProblem
from tactorch.inverse.search.correction import Correction
from tactorch.inverse.search.final_posterior import final_posterior
from tactorch.inverse.search.matched import MatchedFilter
from tactorch.inverse.search.model import MAX_ROUGH_CHI2, Model, Start
from tactorch.inverse.search.proposals import (
    backgrounds,
    changed,
    further,
    joined,
    other_errors,
    removed,
    split,
)
from tactorch.inverse.search.slabs import inclusions_as_steps, simpler_background, slabs
from tactorch.recording import Recording

_log = logging.getLogger(__name__)
# Error of the discretisation that remains after its correction, over the displacements. It is the
# same in all presses of a contact.
_DISCRETISATION = 1e-3
_DERIVATIVE_RTOL = 2e-3  # of the solves for derivatives: far below the curvature of the objective
_RTOL = 1e-5  # of equilibria: errors of data below a thousandth of their deviation


class ShapeProblem(SearchProblem):
    """The presses with quadratic elements and with linear ones; see `SearchProblem`.

    Noise, solver, bounds and equilibrium search of the settings are used. Errors at rims are added
    to those `kept` of an earlier search on fewer presses.

    Attributes:
        linear: The presses with linear elements.
    """

    proposals = (
        other_errors, further, backgrounds, slabs, simpler_background, removed, changed, joined,
        split, inclusions_as_steps,
    )  # fmt: skip
    forms = FORMS
    trial_steps = 20  # a form starts far from its best fit

    def __init__(
        self,
        recording: Recording,
        settings: Settings,
        stop: Callable[[], bool] = lambda: False,
        kept: KeptRims | None = None,
        max_shapes: int = 0,
    ) -> None:
        super().__init__(stop, max_shapes)
        same, element = is_same_model(recording), "tet10"
        if same:
            element = str(recording.provenance.get("element", settings.element))
        newton = NewtonOptions(rtol=max(settings.newton.rtol, _RTOL))
        contacts, noise = group_by_contact(recording.presses), settings.noise
        if not same:
            floor = _DISCRETISATION * np.sqrt(len(recording.presses) / len(contacts))
            noise = replace(noise, relative=max(noise.relative, float(floor)))
        options: dict[str, Any] = {"solver": settings.solver, "noise": noise}

        def problem(element: str, **more: Any) -> InverseProblem:
            return InverseProblem(recording, element=element, newton=newton, **options, **more)

        self.linear = problem("tet4")
        if recording.has_probes:
            options["contact_mpa"] = self.linear.contact_mpa
        self.full = problem(element, derivative_rtol=_DERIVATIVE_RTOL)
        self.sites = Sites.of(self.full.body.assembly)
        self._reduced_sites = Sites.of(self.linear.body.assembly)
        youngs = uniform_fit(self.linear, settings.bounds).youngs_mpa
        self.reduced = ReducedProblem.about_uniform(self.linear, youngs)
        presses = MeasuredPresses(self.full, contacts, log_rates=self.reduced.rates)
        # Where the presses were computed on this mesh, it is the object.
        self._correction = None
        if not same:
            correction = Correction.of(self.full, kept)
            self._correction, presses = correction, replace(
                presses,
                corrections_mm=[np.zeros(count) for count in self.full.data.counts],
                rims=correction.uncertain,
                at_edge=correction.has_singular_ends,
                kept=correction.kept,
            )  # fmt: skip
        self.errors = ErrorModel(presses, ERRORS)
        self.matched = MatchedFilter.of(self.reduced)
        self.prior = ShapePrior.of(recording.mesh, youngs)
        self._floored = noise.floored(recording)

    def first(self, start: Start) -> Model:
        model = self.fit(start, self._linearise(start))
        contacts = () if self._correction is None else self._correction.contacts
        ends_within_faces = any(rim is not None for _, rim in contacts)
        return self.corrected(model) if ends_within_faces else self._linearised(model)

    def _linearise(self, start: Start) -> list[Float[np.ndarray, "nodes 3"]]:
        """Compute the effects of the errors about a model, and return its displacements (mm)."""
        extend = self.full.body.discretisation.extend
        youngs = ShapesOnSites(start.field, self._reduced_sites).at(start.z).youngs
        coarse = self.linear.evaluate(youngs)
        self.errors.linearise(coarse, "linear")
        displacements = [extend(u) for u in coarse.displacements]
        if not self.errors.lacks(start.errors):
            return displacements
        youngs = ShapesOnSites(start.field, self.sites).at(start.z).youngs
        evaluation = self.full.evaluate(youngs, starts=displacements)
        self.errors.linearise(evaluation, "quadratic")
        return evaluation.displacements

    def precise(self, model: Model) -> Model:
        """Return a model of the search corrected for the discretisation.

        Otherwise the search would explain the error of the discretisation by more inclusions, or by
        a background that varies. A model that leaves much more than the noise unexplained is not
        corrected yet, unless the noise may be less than the error of the discretisation.
        """
        if self._is_corrected(model):
            return model
        is_rough = model.fit.chi2 > MAX_ROUGH_CHI2 and not self._floored
        if self._correction is None or is_rough:
            return self._linearised(model)
        return self.corrected(model)

    def _linearised(self, model: Model) -> Model:
        """Return the model with effects of the errors that are computed about it."""
        changing = [error.name for error in self.errors.errors if error.elements == "quadratic"]
        if changing:
            self.errors.linearise(model.evaluation, "quadratic")
        if any(model.errors.get(name) for name in changing):
            return self._fit_further(model, "linearised", None)
        return model

    def final(self, model: Model) -> Model:
        """Return the model fitted closely, with predictions corrected for the discretisation."""
        if self._correction is not None and not self._is_corrected(model):
            corrected = self.corrected(model, FINE)
            if corrected is not model:
                return corrected
        return super().final(model)

    def posterior(self, model: Model) -> tuple[Model, ShapePosterior]:
        """Return the posterior, of balls that may be ellipsoids; see `final_posterior`."""
        return final_posterior(self, model)

    def corrected(self, model: Model, tolerance: float | None = None) -> Model:
        """Return the model fitted to data that are shifted by the error of the discretisation.

        The model remains, with a warning, where a finer mesh fails.
        """
        self._check()
        assert self._correction is not None
        before = self.full, self.errors
        try:
            offsets = self._correction.offsets(model.fit, model.evaluation, self._check)
            self.errors.linearise(model.evaluation, "quadratic")
            further = self.errors.remainders(model.errors, model.evaluation)
            pairs = zip(offsets, further, strict=True)
            self.errors = self.errors.corrected([one + other for one, other in pairs])
            self.full = self.errors.presses.problem
            corrected = self._fit_further(model, "corrected", tolerance)
            self._corrected_at = model.fit, model.errors  # without the equilibria: large arrays
            return corrected
        except (ConfigError, ConvergenceError) as error:
            self.full, self.errors = before
            _log.warning("The error of the discretisation is not corrected: %s", error)
            return model


def is_same_model(recording: Recording) -> bool:
    """Return whether the recording's mesh, on which the presses were computed, is the object."""
    return bool(recording.provenance.get("inverse_crime"))
