"""The presses of a palpation as a problem of the search for inclusions.

Smooth errors of the forces are tried together with each further inclusion, so that they do not
replace one that explains as much. Places that no model explains count less, by their chi2: there
the contact is not modelled. The body is linear, so that predictions need no correction at the
contacts (see `tactorch.fem.indentation`).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from tactorch.inverse.data.observations import DataModel
from tactorch.inverse.errors import ERRORS, ErrorModel, Levels, MeasuredPresses
from tactorch.inverse.errors.smooth_forces import border_distances, correlation_length
from tactorch.inverse.fields import ShapePrior, Sites
from tactorch.inverse.fit.settings import Settings
from tactorch.inverse.fit.shapes import Evidence
from tactorch.inverse.forward.palpation import PALPATION_ELEMENT, PalpationProblem
from tactorch.inverse.forward.problem import Evaluation
from tactorch.inverse.forward.reduced import ReducedProblem
from tactorch.inverse.posterior.shapes import ShapePosterior
from tactorch.inverse.search.base import ROUGH, SearchProblem
from tactorch.inverse.search.matched import MatchedFilter
from tactorch.inverse.search.model import MIN_GAIN, Model, Start, less, make_posterior
from tactorch.inverse.search.proposals import backgrounds, changed, further, other_errors
from tactorch.recording import Recording

_SEARCHED = "tet4"  # elements of the search; the result is fitted with better ones
_TOLERANCE = 0.05  # of the last fit
# Of the log-evidence, over the presses of a place, for a model that is accepted: the errors of
# these presses are not independent.
_MIN_GAIN = 10.0
# The reduced model explains less of stiff inclusions than the full one, which shows most where each
# place counts by its chi2: of the second of two nodules it promises 37, where 1,572 are gained.
_SHARE = 0.25
_CERTAIN = 20.0  # log-odds beyond which they need not be known
_OUTSIDE_MM = 1.0  # standard deviation of the length of inclusions outside the object
_DEEPEST = 1.0  # centre of an inclusion, over the correlation length of smooth errors


class PalpationSearch(SearchProblem):
    """The presses of a palpation; see `SearchProblem`.

    Args:
        recording: The presses.
        settings: Noise, solver and equilibrium search are used.
        stop: See `SearchProblem`.
        max_shapes: Largest number of inclusions.
    """

    full: PalpationProblem
    proposals = (other_errors, further, backgrounds, changed)
    max_fits, trial_share = 5, _SHARE

    def __init__(
        self,
        recording: Recording,
        settings: Settings,
        stop: Callable[[], bool] = lambda: False,
        max_shapes: int = 0,
    ) -> None:
        super().__init__(stop, max_shapes)
        self._recording, self._settings = recording, settings
        self._use(_SEARCHED)
        self._reduced_sites = self.sites
        uniform = np.full(self.full.n_elements, self.full.contact_mpa)
        self._linearise_about(self.full.evaluate(uniform))
        prior = ShapePrior.of(recording.mesh, self.full.contact_mpa)
        self.prior = replace(prior, outside_mm=_OUTSIDE_MM)
        places = len(self.full.indentation.places)
        self.min_gain = _MIN_GAIN * len(recording.presses) / places
        self.tolerance = ROUGH * self.min_gain / MIN_GAIN

    def _use(self, element: str) -> None:
        """Judge models by elements of a type from now on."""
        settings = self._settings
        self.full = PalpationProblem(
            self._recording, element=element, solver=settings.solver, noise=settings.noise,
            newton=settings.newton,
        )  # fmt: skip
        self.sites = Sites.of(self.full.body.assembly)
        self.errors = ErrorModel(MeasuredPresses(self.full), ERRORS)

    def _linearise_about(self, evaluation: Evaluation) -> None:
        self.reduced = ReducedProblem(self.full, evaluation)
        self.matched = MatchedFilter.of(self.reduced, self._are_resolved)
        self._filters: dict[DataModel, MatchedFilter] = {}

    def precise(self, model: Model) -> Model:
        """Return an accepted model, about which the reduced model is linearised.

        A body with stiff inclusions hardly responds to what would stiffen them further.
        """
        self._linearise_about(model.evaluation)
        return model

    def final(self, model: Model) -> Model:
        """Return the model fitted closely with better elements."""
        before, fit = self.full.contact_mpa, model.fit
        self._use(PALPATION_ELEMENT)
        z, level = fit.z.copy(), fit.field.background.level
        # Linear elements are too stiff under the balls.
        z[level] += np.log(self.full.contact_mpa / before) / fit.field.deviation[level]
        return self.fit(Start("final fit", fit.field, z, model.errors), None, _TOLERANCE)

    def without(self, model: Model, removed: Sequence[int]) -> Evidence:
        """Return the evidence of a final model without some inclusions.

        It is that of a fit with `full`, as the reduced model is linearised about the inclusions,
        which ends where it is certain that the model has much more.
        """
        return self.challenge(less(model, removed), model, _CERTAIN).fit

    def posterior(self, model: Model) -> tuple[Model, ShapePosterior]:
        """Return the posterior of a model."""
        return model, make_posterior(model, self.sites)

    @cached_property
    def groups(self) -> Int[np.ndarray, " data"]:
        """Place of each datum."""
        return self.full.places[self.full.press_of]

    def error_levels(self, model: Model) -> Iterator[Levels]:
        """Yield the errors of the model, and others."""
        yield model.errors
        yield from (errors for _, errors in self.errors.others(model.errors))

    def filter(self, errors: Levels) -> MatchedFilter:
        """Return the matched filter for data with these errors, which is kept."""
        data = self.data(errors)
        if data not in self._filters:
            self._filters[data] = self.matched.whitened(data)
        return self._filters[data]

    def _are_resolved(self, points: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Return whether an inclusion at each point can be told from smooth errors.

        It cannot be where the place above it is at the border of the palpated area, nor deeper than
        the correlation length of the errors: its effect at the surface is as wide as it is deep.
        """
        places = self.full.indentation.places
        contacts = np.array([place.contact_mm for place in places])
        normal = np.mean([place.normal for place in places], axis=0)
        normal = normal / np.linalg.norm(normal)
        flat = np.eye(3) - np.outer(normal, normal)
        above = cKDTree(contacts @ flat).query(points @ flat)[1]
        depths = (contacts[above] - points) @ normal
        shallow = depths < _DEEPEST * correlation_length(contacts)
        resolved: np.ndarray = shallow & (border_distances(contacts)[above] > 0.0)
        return resolved
