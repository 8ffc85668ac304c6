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
from tactorch.inverse.fit.shapes import ShapeFit
from tactorch.inverse.forward.palpation import PALPATION_ELEMENT, PalpationProblem, group_places
from tactorch.inverse.forward.problem import Evaluation
from tactorch.inverse.forward.reduced import ReducedProblem
from tactorch.inverse.search.base import ROUGH, SearchProblem
from tactorch.inverse.search.matched import MatchedFilter
from tactorch.inverse.search.model import MIN_GAIN, Model, rivals
from tactorch.inverse.search.proposals import backgrounds, changed, further, other_errors
from tactorch.inverse.search.slabs import simpler_background, slabs
from tactorch.mesh.geometry import farthest_point_order
from tactorch.recording import Recording

_TOLERANCE = 0.5  # of the last fit, from which the posterior is one step further
# Of the log-evidence, over the presses of a place, for a model that is accepted: the errors of
# these presses are not independent.
_MIN_GAIN = 10.0
# The reduced model explains less of stiff inclusions than the full one, which shows most where each
# place counts by its chi2: of the second of two nodules it promises 33, where 1,742 are gained and
# 40 needed. Of four models beside the two nodules it promises 17 to 26, where 18 to 30 are gained.
_SHARE = 0.5
_CERTAIN = 20.0  # log-odds beyond which they need not be known
_OUTSIDE_MM = 1.0  # standard deviation of the length of inclusions outside the object
_DEEPEST = 1.0  # centre of an inclusion, over the correlation length of smooth errors


def at_some_places(recording: Recording, count: int) -> Recording | None:
    """Return the presses at some places, far from each other; None of less than twice as many."""
    poses = [press.probe for press in recording.presses if press.probe is not None]
    places, first = group_places(poses)
    if len(first) < 2 * count:
        return None
    kept = farthest_point_order(np.array([poses[i].position_mm for i in first]), count, 0)
    return recording.select(np.flatnonzero(np.isin(places, kept)).tolist())


class PalpationSearch(SearchProblem):
    """The presses of a palpation; see `SearchProblem`.

    Noise, solver and equilibrium search of the settings are used.
    """

    full: PalpationProblem
    proposals = (other_errors, further, backgrounds, slabs, simpler_background, changed)
    max_fits, rival_share, trial_share, final_tolerance = 5, 1.0, _SHARE, _TOLERANCE

    def __init__(
        self,
        recording: Recording,
        settings: Settings,
        stop: Callable[[], bool] = lambda: False,
        max_shapes: int = 0,
        element: str = PALPATION_ELEMENT,
    ) -> None:
        super().__init__(stop, max_shapes)
        self.full = PalpationProblem(
            recording, element=element, solver=settings.solver, noise=settings.noise,
            newton=settings.newton,
        )  # fmt: skip
        self.sites = Sites.of(self.full.body.assembly)
        self._reduced_sites = Sites.around(recording.mesh)
        self.errors = ErrorModel(MeasuredPresses(self.full), ERRORS)
        self._linearise_about(self.full.evaluate(np.full(self.sites.shape, self.full.contact_mpa)))
        normal = np.mean([place.normal for place in self.full.indentation.places], axis=0)
        axis = int(np.argmax(np.abs(normal)))
        self.step_sides = ("xyz"[axis] + ("-" if normal[axis] > 0.0 else "+"),)  # the base
        prior = ShapePrior.of(recording.mesh, self.full.contact_mpa)
        self.prior = replace(prior, outside_mm=_OUTSIDE_MM)
        self.min_gain = _MIN_GAIN * len(recording.presses) / len(self.full.indentation.places)
        self.tolerance = ROUGH * self.min_gain / MIN_GAIN

    def _linearise_about(self, evaluation: Evaluation) -> None:
        """Linearise about an evaluation where this is needed next."""
        self._about, self._filters = evaluation, dict[DataModel, MatchedFilter]()
        for known in ("reduced", "matched"):
            vars(self).pop(known, None)

    @cached_property
    def reduced(self) -> ReducedProblem:  # type: ignore[override]
        """The presses linearised about a uniform body, or the last accepted model."""
        return ReducedProblem(self.full, self._about)

    @cached_property
    def matched(self) -> MatchedFilter:  # type: ignore[override]
        """Matched filter of these."""
        return MatchedFilter.of(self.reduced, self._are_resolved)

    def precise(self, model: Model) -> Model:
        """Return an accepted model, about which the reduced model is linearised.

        A body with stiff inclusions hardly responds to what would stiffen them further.
        """
        self._linearise_about(model.evaluation)
        return model

    def without(self, model: Model, removed: Sequence[int]) -> Iterator[tuple[Levels, ShapeFit]]:
        """Yield the errors and the fit of `rivals` of a final model.

        They are fitted with `full`, as the reduced model is linearised about the inclusions, as far
        as it is not certain that the model has much more evidence.
        """
        for rival in rivals(model, removed):
            yield rival.errors, self.challenge(rival, model, _CERTAIN).fit

    @cached_property
    def groups(self) -> Int[np.ndarray, " data"]:
        return self.full.places[self.full.press_of]

    def error_levels(self, model: Model) -> Iterator[Levels]:
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
