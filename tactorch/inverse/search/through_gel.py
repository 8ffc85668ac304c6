"""The last fit of presses of a tactile sensor: through the equilibrium of its gel and the object.

The search takes the forces on the object from the gel's deformation alone, which does not determine
the traction where the contact ends. Here gel and object are one body, the data are the markers, and
what the mesh changes of them is corrected by a finer one.
"""

import logging
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from tactorch.errors import UNCOMPUTABLE, CancelledError
from tactorch.inverse.data.observations import DataModel
from tactorch.inverse.errors.discrepancy import smooth_patterns
from tactorch.inverse.fields import InclusionShape, ShapeField, Vector
from tactorch.inverse.fit.shapes import ShapesOnSites
from tactorch.inverse.forward.gel import GelEvaluation, GelProblem, pressed, within_contacts
from tactorch.inverse.forward.problem import Evaluation
from tactorch.inverse.result.shapes import ShapeReconstruction
from tactorch.inverse.search.base import FINE, ROUGH
from tactorch.inverse.search.gel import GelSearch, gel_sites
from tactorch.inverse.search.model import Model, Start, record
from tactorch.inverse.search.sizing import inclusion_sizing, sharp_edge_sizing, smallest
from tactorch.mesh.curved import onto_curved_surface
from tactorch.mesh.refine import Sizing
from tactorch.recording import Recording, refine_recording

_log = logging.getLogger(__name__)
# Edges of the finer mesh at the end of a contact, over its size; cells across and through its gel.
_SHORTEST, _CELLS, _LAYERS = 0.15, 14, 4
_MARGIN = 0.08  # distance of markers from the end of the contact, over its size
# Exponent of the depth with which the difference of both meshes grows: 1.19 for a cube under a gel,
# which leaves a twelfth of the difference at half of the depth.
_POWER = 1.2
_SAME_SIZE = 0.95  # of a contact, over that of the deepest press: on curved bodies it grows
_REMAINING = 0.1  # error of the finer mesh, over what it changes
# Smooth error of the finer mesh at a contact, over the displacements: meshes of the same cube under
# a gel, of 50,000 to 90,000 nodes each, differ by 0.2 to 0.4 um in displacements of 97 um.
_SMOOTH = 0.003
_MAX_CHI2 = 3.0  # beyond which the equilibrium does not explain the markers


def through_gel(
    result: ShapeReconstruction, recording: Recording, check: Callable[[], bool] = lambda: False
) -> ShapeReconstruction:
    """Return a result with its shapes fitted through the equilibrium of gel and object.

    It is the same result, with a warning, where that is not possible.

    The posterior is that of the last model of a search. Alternatives remain those by the forces,
    and are not in intervals.

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
        problem, model = _fitted(result, recording, check)
        if model.fit.chi2 > _MAX_CHI2:
            _log.warning(
                "Forces are those of the gel alone: gel and object in one equilibrium leave a mean "
                "squared residual of %.2g. Check the sensor's pose, and modulus and size of its "
                "gel.", model.fit.chi2,
            )  # fmt: skip
            return result
        model, posterior = problem.posterior(model)
        found = replace(result, field=model.fit.field, z=model.fit.optimum, posterior=posterior)
        at_medians = problem.belong_together(model, found.estimate)
    except CancelledError:
        raise
    except UNCOMPUTABLE as error:
        _log.warning("Forces are those of the gel alone, as gel and object have no fit: %s", error)
        return result
    history = (*result.history, record("gel and object", model.fit))
    return replace(
        found, chi2=model.fit.chi2, history=history, at_medians=at_medians, through_gel=True
    )


def _fitted(
    result: ShapeReconstruction, recording: Recording, check: Callable[[], bool]
) -> tuple[GelSearch, Model]:
    typical = result.background_mpa
    recording, sites = pressed(recording, typical), gel_sites(recording.mesh)
    field, z = result.field, result.z

    def go_on() -> None:
        if check():
            raise CancelledError("The search is stopped in the fit of gel and object.")

    problem, youngs = GelProblem(recording, typical), ShapesOnSites(field, sites).at(z).youngs
    first = problem.evaluate(youngs)
    rims = problem.rims(first)
    deepest = [rims[number] for number in problem.deepest_of_contacts]
    sizings = [rim.sizing(_SHORTEST) for rim in deepest]
    on_object = [rim.on_object(sizing) for rim, sizing in zip(deepest, sizings, strict=True)]
    recording, numbers = within_contacts(recording, rims, _MARGIN)
    go_on()
    sizes = np.array([rims[number].size_mm for number in numbers])
    problem = GelProblem(recording, typical)
    starts = problem.take_over(first, numbers)
    del first  # whose factorisations take gigabytes
    correction = _Correction(recording, typical, sizes, sizings, on_object, tuple(field.shapes(z)))
    evaluation: Evaluation = problem.evaluate(youngs, starts=starts)
    search = GelSearch(problem, sites, check)
    for tolerance in (ROUGH, FINE):
        go_on()
        data = _with_errors(problem, evaluation, correction.offsets(field, z, evaluation))
        search.full = problem.with_data(data)
        start = Start("gel and object", field, z, result.errors)
        model = search.fit(start, None, tolerance, evaluation=evaluation)
        _log.info("gel and object: chi2 %.4g", model.fit.chi2)
        z, evaluation = model.fit.z, model.evaluation
    return search, model


def _with_errors(
    problem: GelProblem, evaluation: Evaluation, offsets: list[Float[np.ndarray, " data"]]
) -> DataModel:
    """Return the data corrected by offsets (mm), with errors that they have in common."""
    assert isinstance(evaluation, GelEvaluation)
    data, contacts = problem.data, np.array(problem.contact_of)
    uncertain = evaluation.uncertain(problem.contact_of, problem.readings)
    owner, change = np.repeat(contacts, data.counts), _REMAINING * np.concatenate(offsets)
    remaining = np.where(owner[:, None] == np.arange(contacts.max() + 1), change[:, None], 0.0)
    patterns = np.hstack([remaining, *_smooth_errors(problem, owner)])
    common = np.hstack([uncertain, patterns * data.scale[:, None]])
    kept = (common != 0.0).any(axis=0)
    common = np.hstack([common[:, kept], problem.marker_errors.toarray()])
    return data.shifted([-offset for offset in offsets]).with_errors(common)


def _smooth_errors(
    problem: GelProblem, owner: Int[np.ndarray, " data"]
) -> Iterator[Float[np.ndarray, "data k"]]:
    """Yield the smooth errors (mm) of each contact, by the contact of each datum."""
    for k in range(owner.max() + 1):
        own = [r for r, at in zip(problem.readings, problem.contact_of, strict=True) if at == k]
        smooth = smooth_patterns(np.concatenate([reading.markers_mm for reading in own]))
        sizes = [np.sqrt(np.mean(reading.displacement_mm**2)) for reading in own]
        deviations = _SMOOTH * np.repeat(sizes, [len(reading.markers_mm) for reading in own])
        errors = np.zeros((len(owner), 2 * smooth.shape[1]))
        errors[owner == k] = np.kron(deviations[:, None] * smooth, np.eye(2))
        yield errors


class _Correction:
    """Predictions of a finer mesh, less those of the common one."""

    def __init__(
        self,
        recording: Recording,
        youngs_mpa: float,
        sizes_mm: Float[np.ndarray, " presses"],
        sizings: Sequence[Sizing],
        on_object: Sequence[Sizing],
        shapes: Sequence[InclusionShape],
    ) -> None:
        on_object = *on_object, sharp_edge_sizing(recording.mesh), inclusion_sizing(shapes)
        fine = refine_recording(recording, smallest(*on_object))
        # Triangles of the coarse mesh are chords of a curved body: with nodes on them, markers on
        # a hemisphere of 30 mm were off by 1.2 um, and by 0.5 um with nodes on the curved surface.
        curved = onto_curved_surface(fine.mesh, recording.mesh)
        fine = replace(fine, mesh=curved, check_units=False)
        self._sites = gel_sites(fine.mesh)
        self._problem = GelProblem(
            fine,
            youngs_mpa,
            cells=_CELLS,
            layers=_LAYERS,
            gel_sizing=sizings,
            surface=recording.mesh,
        )
        last = [number for number, _ in self._problem.deepest]
        is_smaller = sizes_mm < _SAME_SIZE * sizes_mm[last]
        self._solved = sorted({*last, *np.flatnonzero(is_smaller).tolist()})

    def offsets(
        self, field: ShapeField, z: Vector, evaluation: Evaluation
    ) -> list[Float[np.ndarray, " data"]]:
        """Return them for the data of each press, mm.

        They are computed for the deepest press of each contact, and for those whose contact is
        smaller; they grow with a power of the depth in others.
        """
        youngs = ShapesOnSites(field, self._sites).at(z).youngs
        predicted = self._problem.predicted_alone(youngs, self._solved)
        changes = {
            i: (one - evaluation.predicted[i]).reshape(-1, 2) for i, one in predicted.items()
        }
        found, readings = [], self._problem.readings
        for i, (reading, (number, share)) in enumerate(
            zip(readings, self._problem.deepest, strict=True)
        ):
            if i in changes:
                found.append(changes[i].ravel())
                continue
            # Not all markers may be seen in both presses.
            _, nearest = cKDTree(readings[number].markers_mm).query(reading.markers_mm)
            found.append(share**_POWER * changes[number][nearest].ravel())
        return found
