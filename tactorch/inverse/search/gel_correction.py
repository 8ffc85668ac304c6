"""Errors of the mesh in presses of a tactile sensor: a finer mesh, and what it leaves.

The data are the displacements of markers within the contacts, through the equilibrium of gel and
object.
"""

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from tactorch.fem import ELEMENTS
from tactorch.inverse.data.observations import DataModel
from tactorch.inverse.errors.discrepancy import smooth_patterns
from tactorch.inverse.fields import InclusionShape, ShapeField, Sites, Vector
from tactorch.inverse.fit.shapes import ShapesOnSites
from tactorch.inverse.forward.gel import GelEvaluation, GelProblem, Rim
from tactorch.inverse.search.sizing import inclusion_sizing, sharp_edge_sizing, smallest
from tactorch.linalg import map_cases
from tactorch.mesh import TetMesh
from tactorch.mesh.curved import onto_curved_surface
from tactorch.recording import Recording, refine_recording
from tactorch.touch.pairing import ELEMENT

# Edges of the finer mesh at the end of a contact, over its size; cells across and through its gel.
_SHORTEST, _CELLS, _LAYERS = 0.15, 14, 4
# Exponent of the depth with which the difference of both meshes grows: 1.19 for a cube under a gel,
# which leaves a twelfth of the difference at half of the depth.
_POWER = 1.2
_SAME_SIZE = 0.95  # of a contact, over that of the deepest press: on curved bodies it grows
_REMAINING = 0.1  # error of the finer mesh, over what it changes
# Smooth error of the finer mesh at a contact, over the displacements: meshes of the same cube under
# a gel, of 50,000 to 90,000 nodes each, differ by 0.2 to 0.4 um in displacements of 97 um.
_SMOOTH = 0.003
_RTOL = 1e-5  # of equilibria of the finer mesh


def with_gel_errors(
    problem: GelProblem, evaluation: GelEvaluation, offsets: list[Float[np.ndarray, " data"]]
) -> DataModel:
    """Return the data corrected by offsets (mm), with errors that they have in common."""
    data, contacts = problem.data, np.array(problem.contact_of)
    uncertain = evaluation.uncertain(problem.contact_of, problem.readings)
    owner, change = np.repeat(contacts, data.counts), _REMAINING * np.concatenate(offsets)
    remaining = np.where(owner[:, None] == np.arange(contacts.max() + 1), change[:, None], 0.0)
    patterns = np.hstack([remaining, *_smooth_errors(problem, owner, offsets)])
    common = np.hstack([uncertain, patterns * data.scale[:, None]])
    kept = (common != 0.0).any(axis=0)
    common = np.hstack([common[:, kept], problem.marker_errors.toarray()])
    return data.shifted([-offset for offset in offsets]).with_errors(common)


def _smooth_errors(
    problem: GelProblem, owner: Int[np.ndarray, " data"], offsets: list[Float[np.ndarray, " _"]]
) -> Iterator[Float[np.ndarray, "data k"]]:
    """Yield the smooth errors (mm) of each contact, by the contact of each datum."""
    for k in range(owner.max() + 1):
        own = [i for i, at in enumerate(problem.contact_of) if at == k]
        readings = [problem.readings[i] for i in own]
        smooth = smooth_patterns(np.concatenate([reading.markers_mm for reading in readings]))
        sizes = [
            np.hypot(_SMOOTH * _rms(reading.displacement_mm), _REMAINING * _rms(offsets[i]))
            for i, reading in zip(own, readings, strict=True)
        ]
        deviations = np.repeat(sizes, [len(reading.markers_mm) for reading in readings])
        errors = np.zeros((len(owner), 2 * smooth.shape[1]))
        errors[owner == k] = np.kron(deviations[:, None] * smooth, np.eye(2))
        yield errors


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def gel_sites(mesh: TetMesh) -> Sites:
    """Return the volumes of the quadrature points of elements under a gel."""
    return Sites.around(mesh, ELEMENTS[ELEMENT].points)


class _FineContact(NamedTuple):
    """A contact on a mesh that is fine there.

    Attributes:
        presses: Numbers of its presses.
        solved: Those that are solved, numbered within the contact.
        problem: The presses.
        sites: Quadrature points of the object.
    """

    presses: list[int]
    solved: list[int]
    problem: GelProblem
    sites: Sites

    @staticmethod
    def of(
        recording: Recording,
        presses: list[int],
        rim: Rim,
        solved: Collection[int],
        youngs_mpa: float,
        inclusions: Sequence[InclusionShape],
    ) -> "_FineContact":
        at_rim = rim.sizing(_SHORTEST)
        on_object = [rim.on_object(at_rim), sharp_edge_sizing(recording.mesh)]
        if inclusions:
            on_object.append(inclusion_sizing(inclusions))
        fine = refine_recording(recording.select(presses), smallest(*on_object))
        # Triangles of the coarse mesh are chords of a curved body: with nodes on them, markers on
        # a hemisphere of 30 mm were off by 1.2 um, and by 0.5 um with nodes on the curved surface.
        curved = onto_curved_surface(fine.mesh, recording.mesh)
        problem = GelProblem(
            replace(fine, mesh=curved, check_units=False),
            youngs_mpa,
            cells=_CELLS,
            layers=_LAYERS,
            gel_sizing=[at_rim],
            surface=recording.mesh,
            rtol=_RTOL,
        )
        own = [k for k, number in enumerate(presses) if number in solved]
        return _FineContact(presses, own, problem, gel_sites(curved))

    def predicted(
        self, field: ShapeField, z: Vector, check: Callable[[], None]
    ) -> dict[int, Float[np.ndarray, " data"]]:
        """Return the data (mm) by the number of the press."""
        youngs = ShapesOnSites(field, self.sites).at(z).youngs
        found = self.problem.predicted_alone(youngs, self.solved, check)
        return {self.presses[k]: data for k, data in found.items()}


class GelCorrection:
    """Predictions of finer meshes, one for each contact, less those of the common one.

    Args:
        problem: The presses, with markers within the contacts.
        rims: Where the contact of each ends.
        youngs_mpa: Typical modulus of the object, MPa.
        inclusions: Inclusions at whose boundaries the meshes are finer, too.
    """

    def __init__(
        self,
        problem: GelProblem,
        rims: Sequence[Rim],
        youngs_mpa: float,
        inclusions: Sequence[InclusionShape] = (),
    ) -> None:
        self._readings, self._deepest = problem.readings, problem.deepest
        sizes = np.array([rim.size_mm for rim in rims])
        owner = [number for number, _ in self._deepest]
        solved = {*owner, *np.flatnonzero(sizes < _SAME_SIZE * sizes[owner]).tolist()}
        last, contact_of = problem.deepest_of_contacts, np.array(problem.contact_of)

        def fine(k: int) -> _FineContact:
            presses = np.flatnonzero(contact_of == k).tolist()
            return _FineContact.of(
                problem.recording, presses, rims[last[k]], solved, youngs_mpa, inclusions
            )

        self._contacts = map_cases(fine, len(last))

    def offsets(
        self,
        field: ShapeField,
        z: Vector,
        evaluation: GelEvaluation,
        check: Callable[[], None],
    ) -> list[Float[np.ndarray, " data"]]:
        """Return them for the data of each press, mm.

        They are computed for the deepest press of each contact, and for those whose contact is
        smaller; they grow with a power of the depth in others. `check` is called before each
        equilibrium.
        """
        contacts = self._contacts
        parts = map_cases(lambda k: contacts[k].predicted(field, z, check), len(contacts))
        predicted = {i: data for part in parts for i, data in part.items()}
        changes = {
            i: (one - evaluation.predicted[i]).reshape(-1, 2) for i, one in predicted.items()
        }
        found = list[np.ndarray]()
        for i, (number, share) in enumerate(self._deepest):
            if i in changes:
                found.append(changes[i].ravel())
                continue
            # Not all markers may be seen in both presses.
            markers = self._readings[number].markers_mm, self._readings[i].markers_mm
            nearest = cKDTree(markers[0]).query(markers[1])[1]
            found.append(share**_POWER * changes[number][nearest].ravel())
        return found
