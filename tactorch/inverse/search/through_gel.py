"""The last fit of presses of a tactile sensor: through the equilibrium of its gel and the object.

The search takes the forces on the object from the gel's deformation alone, which does not determine
the traction where the contact ends. Here gel and object are one body, the data are the markers, and
what the mesh changes of them is corrected by a finer one.
"""

import logging
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from tactorch.errors import UNCOMPUTABLE, CancelledError
from tactorch.fem import ELEMENTS
from tactorch.inverse.data.observations import DataModel
from tactorch.inverse.fields import CENTER, ShapeField, Sites, Vector
from tactorch.inverse.fit.shapes import ShapeFit, ShapesOnSites, fit_shapes
from tactorch.inverse.forward.gel import GelEvaluation, GelProblem, pressed, within_contacts
from tactorch.inverse.posterior.shapes import ShapePosterior
from tactorch.inverse.result.shapes import ShapeReconstruction
from tactorch.inverse.search.model import Model, make_posterior, record
from tactorch.inverse.search.sizing import sharp_edge_sizing, smallest
from tactorch.mesh import TetMesh
from tactorch.mesh.refine import Sizing
from tactorch.recording import Recording, refine_recording
from tactorch.touch.pairing import ELEMENT

_log = logging.getLogger(__name__)
# Edges of the finer mesh at the end of a contact, over its size; cells across and through its gel.
_SHORTEST, _CELLS, _LAYERS = 0.15, 14, 4
_MARGIN = 0.08  # distance of markers from the end of the contact, over its size
# Exponent of the depth with which the difference of both meshes grows: 1.19 for a cube under a gel,
# which leaves a twelfth of the difference at half of the depth.
_POWER = 1.2
_REMAINING = 0.1  # error of the finer mesh, over what it changes
_TOLERANCE = 0.02  # of fits, see `fit_shapes`
_MAX_CHI2 = 3.0  # beyond which the equilibrium does not explain the markers


def through_gel(
    result: ShapeReconstruction, recording: Recording, check: Callable[[], bool] = lambda: False
) -> ShapeReconstruction:
    """Return a result with its shapes fitted through the equilibrium of gel and object.

    It is the same result, with a warning, where that is not possible.

    The posterior is normal about the best fit, without ridges. Alternatives remain those by the
    forces, and are not in intervals.

    Args:
        result: Result by the forces of the gel.
        recording: Presses of a sensor with markers.
        check: Called before each step of a fit; where it is true the fit is stopped.

    Raises:
        CancelledError: see `check`.
    """
    without = [press.label for press in recording.presses if press.gel is None]
    if without:
        if len(without) < len(recording.presses):
            _log.warning(
                "Forces are those of the gel alone: %s and %d others have no markers of a gel.",
                without[0], len(without) - 1,
            )  # fmt: skip
        return result
    try:
        fit, model, sites = _fitted(result, recording, check)
    except CancelledError:
        raise
    except UNCOMPUTABLE as error:
        _log.warning("Forces are those of the gel alone, as gel and object have no fit: %s", error)
        return result
    if fit.chi2 > _MAX_CHI2:
        _log.warning(
            "Forces are those of the gel alone: gel and object in one equilibrium leave a mean "
            "squared residual of %.2g. Check the sensor's pose, and modulus and size of its gel.",
            fit.chi2,
        )
        return result
    posterior = _with_place(make_posterior(model, sites), recording)
    history = (*result.history, record("gel and object", fit))
    return replace(
        result, z=fit.optimum, posterior=posterior, chi2=fit.chi2, history=history,
        at_medians=True, through_gel=True,
    )  # fmt: skip


def _with_place(posterior: ShapePosterior, recording: Recording) -> ShapePosterior:
    """Return the posterior with the error of the sensor's position across its axis.

    It shifts the object under the gel, and markers hardly show it.
    """
    position = max(float(press.gel.uncertain[1]) for press in recording.presses if press.gel)
    covariance = posterior.covariance.copy()
    for k in range(len(posterior.field.families)):
        center = posterior.field.index(k, *CENTER)
        covariance[center, center] += (position / posterior.field.deviation[center]) ** 2
    return replace(posterior, covariance=covariance)


def _fitted(
    result: ShapeReconstruction, recording: Recording, check: Callable[[], bool]
) -> tuple[ShapeFit, Model, Sites]:
    typical = result.background_mpa
    recording, sites = pressed(recording, typical), _sites(recording.mesh)
    problem, field, z = GelProblem(recording, typical), result.field, result.z

    def go_on() -> None:
        if check():
            raise CancelledError("The search is stopped in the fit of gel and object.")

    def give_up(fit: ShapeFit, fall: float) -> bool:
        go_on()
        return False

    family = ShapesOnSites(field, sites)
    evaluation = problem.evaluate(family.at(z).youngs)
    rims = problem.rims(evaluation)
    deepest = [rims[number] for number in problem.deepest_of_contacts]
    sizings = [rim.sizing(_SHORTEST) for rim in deepest]
    on_object = [rim.on_object(sizing) for rim, sizing in zip(deepest, sizings, strict=True)]
    recording = within_contacts(recording, rims, _MARGIN)
    go_on()
    problem = GelProblem(recording, typical)
    correction = _Correction(recording, typical, sizings, on_object)
    evaluation = problem.evaluate(family.at(z).youngs)
    go_on()
    data = _with_errors(problem, evaluation, correction.offsets(field, z, evaluation))
    starts = evaluation.displacements
    fit, evaluation = _fit(problem.with_data(data), field, z, sites, starts, give_up)
    _log.info("gel and object: chi2 %.4g", fit.chi2)
    return fit, Model(fit, evaluation, result.errors), sites


def _fit(
    problem: GelProblem,
    field: ShapeField,
    z: Vector,
    sites: Sites,
    starts: list[Float[np.ndarray, "nodes 3"]],
    give_up: Callable[[ShapeFit, float], bool],
) -> tuple[ShapeFit, GelEvaluation]:
    fit, evaluation = fit_shapes(
        problem, field, z, sites=sites, starts=starts, tolerance=_TOLERANCE, give_up=give_up
    )
    assert isinstance(evaluation, GelEvaluation)
    return fit, evaluation


def _sites(mesh: TetMesh) -> Sites:
    return Sites.around(mesh, ELEMENTS[ELEMENT].points)


def _with_errors(
    problem: GelProblem, evaluation: GelEvaluation, offsets: list[Float[np.ndarray, " data"]]
) -> DataModel:
    """Return the data corrected by offsets (mm), with errors that they have in common."""
    uncertain = evaluation.uncertain(problem.contact_of, problem.readings)
    remaining = np.zeros((len(uncertain), max(problem.contact_of) + 1))
    data = problem.data
    for i, (begin, offset) in enumerate(zip(data.begins, offsets, strict=True)):
        remaining[begin : begin + len(offset), problem.contact_of[i]] = _REMAINING * offset
    patterns = np.hstack([uncertain, remaining * data.scale[:, None]])
    kept = (patterns != 0.0).any(axis=0)
    return data.shifted([-offset for offset in offsets]).with_errors(patterns[:, kept])


class _Correction:
    """Predictions of a finer mesh, less those of the common one."""

    def __init__(
        self,
        recording: Recording,
        youngs_mpa: float,
        sizings: Sequence[Sizing],
        on_object: Sequence[Sizing],
    ) -> None:
        sharp = sharp_edge_sizing(recording.mesh)
        fine = refine_recording(recording, smallest(*on_object, sharp))
        self._sites = _sites(fine.mesh)
        self._problem = GelProblem(
            fine, youngs_mpa, cells=_CELLS, layers=_LAYERS, gel_sizing=sizings
        )

    def offsets(
        self, field: ShapeField, z: Vector, evaluation: GelEvaluation
    ) -> list[Float[np.ndarray, " data"]]:
        """Return them for the data of each press, mm.

        They are computed for the deepest press of each contact, and grow with a power of the depth.
        """
        youngs = ShapesOnSites(field, self._sites).at(z).youngs
        predicted = self._problem.deepest_predicted(youngs)
        changes = {
            i: (one - evaluation.predicted[i]).reshape(-1, 2) for i, one in predicted.items()
        }
        found, readings = [], self._problem.readings
        for reading, (number, share) in zip(readings, self._problem.deepest, strict=True):
            # Not all markers may be seen in both presses.
            _, nearest = cKDTree(readings[number].markers_mm).query(reading.markers_mm)
            found.append(share**_POWER * changes[number][nearest].ravel())
        return found
