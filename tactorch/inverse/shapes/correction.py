"""Discretisation error of presses whose contact ends within a face.

Near the rim of a contact the strain changes within a fraction of the contact's radius, for which
the mesh of all presses would have to be fine at each contact. Instead each contact has a mesh of
its own, refined there. The difference of its prediction at a model is added to those of the common
mesh, as it changes little with the model (deferred correction: Pereyra, 1966).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from tactorch.fem import NewtonOptions
from tactorch.inverse.problem import Evaluation, InverseProblem
from tactorch.inverse.shapes.field import Sites
from tactorch.inverse.shapes.fit import ShapeFit, ShapesOnSites
from tactorch.inverse.shapes.sizing import Rim
from tactorch.mesh import Refinement, refine
from tactorch.recording import Recording, prolong_recording

_PER_CONTACT = 0.2  # longest edge at the rim on the contact's own mesh, over the contact's radius
_GROWTH = 1.0  # of the longest edge with the distance from the rim


@dataclass(frozen=True, eq=False)
class ContactMeshes:
    """Meshes that are refined at the rim of one contact each.

    Attributes:
        recording: All presses on the common mesh.
        refinements: For each contact the numbers of its presses, and its mesh.
    """

    recording: Recording
    refinements: tuple[tuple[Int[np.ndarray, " k"], Refinement], ...]

    @staticmethod
    def of(recording: Recording) -> "ContactMeshes":
        """Refine at the rims of the contacts of a recording; contacts without one are left out."""
        contacts: dict[bytes, list[int]] = {}
        for i, press in enumerate(recording.presses):
            contacts.setdefault((press.forces != 0).any(axis=1).tobytes(), []).append(i)
        refinements = []
        for loaded, numbers in contacts.items():
            rim = Rim.of(recording.mesh, np.frombuffer(loaded, dtype=bool))
            if rim is not None:
                refinement = refine(recording.mesh, rim.sizing(_PER_CONTACT, _GROWTH))
                if len(refinement.ends):
                    refinements.append((np.array(numbers), refinement))
        return ContactMeshes(recording, tuple(refinements))

    def offsets(
        self, fit: ShapeFit, evaluation: Evaluation, *, element: str, newton: NewtonOptions
    ) -> list[Float[np.ndarray, " p"]]:
        """Return the predictions of the refined meshes less those of the common one, each press.

        Args:
            fit: Model.
            evaluation: Its predictions on the common mesh.
            element: Element type.
            newton: Settings of the equilibrium search.

        Raises:
            ConvergenceError: a press has no equilibrium on its own mesh.
        """
        observations = evaluation.data.observations
        offsets = [np.zeros(len(o.index)) for o in observations]
        for numbers, refinement in self.refinements:
            presses = tuple(self.recording.presses[i] for i in numbers)
            fine = prolong_recording(replace(self.recording, presses=presses), refinement)
            predicted = _predict(
                fine, fit, [evaluation.displacements[i] for i in numbers], refinement,
                element=element, newton=newton,
            )  # fmt: skip
            n = self.recording.mesh.n_points
            for i, reported in zip(numbers, predicted, strict=True):
                before = evaluation.reported[i][:n]
                offsets[i] = (reported[:n] - before).ravel()[observations[i].index]
        return offsets


def _predict(
    recording: Recording,
    fit: ShapeFit,
    displacements: Sequence[Float[np.ndarray, "nodes 3"]],
    refinement: Refinement,
    *,
    element: str,
    newton: NewtonOptions,
) -> list[Float[np.ndarray, "fine 3"]]:
    """Return the displacements of a model on a refined mesh."""
    problem = InverseProblem(recording, element=element, newton=newton)
    sites = Sites.of(problem.body.assembly)
    youngs = ShapesOnSites(fit.field, sites).at(fit.z).youngs
    extend, n = problem.body.discretisation.extend, refinement.coarse.n_points
    starts = [extend(refinement.interpolate(u[:n])) for u in displacements]
    return problem.evaluate(youngs, starts=starts).reported
