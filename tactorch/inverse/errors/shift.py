"""Shifts of contacts: a sensor presses beside the place that is recorded.

The forces and the displacements of a contact are known relative to the sensor. If it is displaced
by d along the surface, the rest of the body is displaced by -d relative to the contact: inclusions,
other faces and supports. The data are those of a body of another rest shape, in which the nodes of
the contact are where they were, and the others are displaced.
"""

import logging

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from tactorch.inverse.errors.base import ErrorSource, MeasuredPresses
from tactorch.inverse.forward.problem import Columns
from tactorch.linalg import map_cases
from tactorch.mesh import TetMesh
from tactorch.mesh.tractions import loaded_triangles
from tactorch.recording import Press

_log = logging.getLogger(__name__)
_RTOL = 1e-2  # relative residual of the solves
_STEP = 1e-4  # of the central difference, over the contact's radius
# Components of a direction along the normals of faces: from the first one on they are displaced
# with the body, and a contact ends at an edge to one of the second.
_ACROSS, _BEYOND = 0.3, 0.7
# Part of the contact's outline at edges beyond which it is not shifted across them: a contact that
# fills a side has half of it there.
_MAX_AT_EDGE = 1 / 3


class ContactShift(ErrorSource):
    """Shifts of contacts along the surface, each common to its presses, over the contact's radius.

    The radius is that of a disc of the loaded area. A patch of 2 mm radius that is placed by hand
    is misplaced by a few tenths of a millimetre. A contact that fills a side of the body is not
    shifted.
    """

    name, elements, proposal = "shift", "quadratic", "contacts misplaced by {:.0%} of their radius"
    levels, is_nonlinear = (0.05, 0.1, 0.2), True
    note = (
        "The presses are misplaced by about {:.0%} of the radius of their contacts; the intervals "
        "of the lumps account for it. Check the poses of the presses."
    )

    def least(self, presses: MeasuredPresses) -> float | None:
        """Return zero, or None where no contact can be shifted."""
        firsts = (presses.problem.recording.presses[contact[0]] for contact in presses.contacts)
        mesh = presses.problem.recording.mesh
        return 0.0 if any(len(shifts(mesh, press)) for press in firsts) else None

    def patterns(self, presses: MeasuredPresses) -> Float[np.ndarray, "data k"]:
        along = _all_shifts(presses)

        def work(k: int) -> dict[int, np.ndarray]:
            return {i: _changes(presses, i, along[k]) for i in presses.contacts[k] if len(along[k])}

        return presses.joined(map_cases(work, len(along)))

    def nonlinear_changes(
        self, presses: MeasuredPresses, amplitudes: Float[np.ndarray, " k"]
    ) -> dict[int, Float[np.ndarray, " _"]]:
        along = _all_shifts(presses)
        parts = np.split(amplitudes, np.cumsum([len(each) for each in along])[:-1])
        contact_of = {i: k for k, contact in enumerate(presses.contacts) for i in contact}
        recording, evaluation = presses.problem.recording, presses.evaluation
        points = {
            i: _moved(recording.mesh, recording.presses[i], parts[k] @ along[k])
            for i, k in contact_of.items()
            if len(along[k])
        }
        moved = evaluation.at_rest_shapes(points)
        for i in points.keys() - moved.keys():
            _log.info("%s fails where it is shifted, and is linearised", recording.presses[i].label)
        return {i: data - evaluation.predicted[i] for i, data in moved.items()}


def shifts(mesh: TetMesh, press: Press) -> Float[np.ndarray, "k 3"]:
    """Return the shifts of a contact by its radius, mm, in at most two orthogonal directions."""
    surface = mesh.surface
    loaded = loaded_triangles(surface, press.forces)
    if not loaded.any():
        return np.zeros((0, 3))
    total = surface.areas[loaded] @ surface.normals[loaded]
    directions = np.linalg.svd(total[None])[2][1:]
    outline = np.intersect1d(surface.triangles[loaded], surface.triangles[~loaded])
    beside = np.isin(surface.triangles, outline).any(axis=1) & ~loaded
    across = np.abs(surface.normals @ directions.T) > _BEYOND
    at_edge = [len(np.intersect1d(outline, surface.triangles[beside & a])) for a in across.T]
    free = np.array(at_edge) <= _MAX_AT_EDGE * len(outline)
    return np.sqrt(surface.areas[loaded].sum() / np.pi) * directions[free]


def _all_shifts(presses: MeasuredPresses) -> list[Float[np.ndarray, "k 3"]]:
    recording = presses.problem.recording
    return [shifts(recording.mesh, recording.presses[contact[0]]) for contact in presses.contacts]


def _changes(presses: MeasuredPresses, number: int, along: Float[np.ndarray, "k 3"]) -> Columns:
    """Return the changes of the data of a press by shifts (mm), in standard deviations."""
    evaluation, recording = presses.evaluation, presses.problem.recording
    newton, u = evaluation.search(number), evaluation.displacements[number]

    def unbalanced(shift: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " unknowns"]:
        points = _moved(recording.mesh, recording.presses[number], shift)
        forces = newton.with_rest_shape(points).unbalanced(u)
        assert forces is not None  # the step is small
        return forces[0]

    loads = [(unbalanced(-_STEP * d) - unbalanced(_STEP * d)) / (2.0 * _STEP) for d in along]
    scale = presses.problem.data.observations[number].scale[:, None]
    fields = np.reshape(loads, (len(along), *u.shape))
    return evaluation.response_to_loads(number, fields, _RTOL) * scale


def _moved(mesh: TetMesh, press: Press, shift: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "n 3"]:
    """Return the rest shape relative to a contact that is displaced by a shift, mm.

    The displacement increases over one radius of the contact, or up to faces that are nearer.
    """
    surface, points = mesh.surface, mesh.points
    at_contact = (press.observed | (press.forces != 0.0)).any(axis=1)
    loaded = loaded_triangles(surface, press.forces)
    radius = np.sqrt(surface.areas[loaded].sum() / np.pi)
    across = np.abs(surface.normals @ shift) > _ACROSS * np.linalg.norm(shift)
    faces = np.setdiff1d(surface.triangles[across], np.flatnonzero(at_contact))
    near, far = cKDTree(points[at_contact]).query(points)[0], np.inf
    if len(faces):
        far = cKDTree(points[faces]).query(points)[0]
    share = near / np.minimum(near + far, np.maximum(near, radius))
    return points - share[:, None] * shift
