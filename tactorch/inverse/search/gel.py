"""Presses of sensors and grasps as a problem of the search, through gels and object."""

from collections.abc import Callable

import numpy as np

from tactorch.errors import ConvergenceError
from tactorch.fem import ELEMENTS
from tactorch.inverse.data.observations import DataModel
from tactorch.inverse.errors import ErrorModel, Levels, MeasuredPresses
from tactorch.inverse.fields import ShapePrior, Sites, Vector
from tactorch.inverse.fit.settings import Settings
from tactorch.inverse.fit.shapes import ShapesOnSites
from tactorch.inverse.forward.gel import GelEvaluation, GelProblem
from tactorch.inverse.forward.reduced import ReducedProblem
from tactorch.inverse.posterior.shapes import ShapePosterior
from tactorch.inverse.search.base import SearchProblem
from tactorch.inverse.search.final_posterior import final_posterior
from tactorch.inverse.search.matched import MatchedFilter
from tactorch.inverse.search.model import Model
from tactorch.inverse.search.proposals import changed, further, removed
from tactorch.mesh import TetMesh
from tactorch.recording import Recording
from tactorch.touch.pairing import ELEMENT

_STEPS, _LARGEST, _CLOSE = 12, 1.5, 0.05  # steps of the log of a uniform modulus
# Modulus over that of the gels beyond which the object is rigid: another one changes the force of
# a grasp by less than its deviation.
_RIGID = 1e2


class GelSearch(SearchProblem):
    """Gel and object in one equilibrium, with data whose errors are known already."""

    full: GelProblem

    def __init__(
        self, full: GelProblem, sites: Sites, stop: Callable[[], bool], max_shapes: int = 0
    ) -> None:
        super().__init__(stop, max_shapes)
        self.full, self.sites = full, sites

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
        problem, sites = GelProblem(recording, _first_mpa(recording)), gel_sites(recording.mesh)
        super().__init__(problem, sites, stop, max_shapes)
        starts = self._uniform_evaluation(settings)
        # Points that do not slip are those that touch at this modulus.
        problem = GelProblem(recording, float(starts.youngs.flat[0]))
        evaluation = problem.evaluate(starts.youngs, starts=starts.displacements)
        common = evaluation.uncertain(problem.contact_of, problem.readings)
        common = common[:, (common != 0.0).any(axis=0)]
        self.full = problem.with_data(problem.data.with_errors(common))
        self._about = evaluation
        self._reduced_sites = Sites.around(recording.mesh)
        self.reduced = ReducedProblem(self.full, evaluation)
        self.errors = ErrorModel(MeasuredPresses(self.full), ())
        self.matched = MatchedFilter.of(self.reduced)
        self.prior = ShapePrior.of(recording.mesh, float(evaluation.youngs.flat[0]))

    def _uniform_evaluation(self, settings: Settings) -> GelEvaluation:
        """Return the presses at the uniform modulus that fits best.

        Raises:
            ConvergenceError: the forces are larger than those of a rigid object.
        """
        bounds, problem = settings.bounds, self.full
        gel_mpa = max(float(reading.layer[1]) for reading in problem.readings)
        highest = min(np.log(bounds.upper), np.log(_RIGID * gel_mpa))
        log, starts = float(np.log(_first_mpa(problem.recording))), None
        for _ in range(_STEPS):
            self._check()
            youngs = np.full(self.sites.shape, np.exp(log))
            evaluation = problem.evaluate(youngs, starts=starts)
            columns, _ = evaluation.linear_response(youngs.reshape(1, -1))
            column = columns[:, 0]
            step = -float(column @ evaluation.residuals) / max(float(column @ column), 1e-12)
            if abs(step) < _CLOSE:
                return evaluation
            if log >= highest and step > 0.0 and highest < np.log(bounds.upper):
                raise ConvergenceError(
                    f"With {np.exp(log):.3g} MPa the object is rigid beside the gels, and the "
                    "measured forces are larger still: the gripper is wider, or the gels are "
                    "stiffer, than stated. Check width and reference."
                )
            lowest, before = np.log(bounds.lower), log
            log = float(np.clip(log + np.clip(step, -_LARGEST, _LARGEST), lowest, highest))
            if log == before:
                raise ConvergenceError(
                    f"The best modulus is beyond {np.exp(log):.3g} MPa, a bound of the settings "
                    "(bounds.lower, bounds.upper). Check size, reference and units, or widen it."
                )
            starts = evaluation.displacements
        return evaluation

    def uniform(self) -> Model:
        """Fit the uniform body, from the one about which errors are linearised."""
        return self.fit(self._uniform, self._about.displacements)


def gel_sites(mesh: TetMesh) -> Sites:
    """Return the volumes of the quadrature points of elements under a gel."""
    return Sites.around(mesh, ELEMENTS[ELEMENT].points)


def _first_mpa(recording: Recording) -> float:
    """Return a first modulus: that of the gels."""
    return float(max(press.gel.layer[1] for press in recording.presses if press.gel is not None))
