"""Shifts of contacts: the forces of a press act beside their recorded places.

A traction t that is displaced by d along the surface has the nodal forces ∫ t(x) phi_i(x + d) dA,
with the hat functions phi_i. Their derivative by d is the sum over the loaded triangles of the
force on a triangle times the gradient of the hat function in it.
"""

import numpy as np
from jaxtyping import Float

from tactorch.inverse.errors.base import ErrorSource, MeasuredPresses
from tactorch.linalg import map_cases
from tactorch.mesh import TetMesh
from tactorch.mesh.tractions import LoadedSurface


class ContactShift(ErrorSource):
    """Shifts of contacts along the surface, each common to its presses, over the contact's radius.

    The radius is that of a disc of the loaded area. A patch of 2 mm radius that is placed by hand
    is misplaced by a few tenths of a millimetre.
    """

    name, elements, proposal = "shift", "linear", "contacts misplaced by {:.0%} of their radius"
    levels, on_request = (0.05, 0.1, 0.2), True
    note = (
        "The presses are misplaced by about {:.0%} of the radius of their contacts; the intervals "
        "of the lumps account for it. Check the poses of the presses."
    )

    def least(self, presses: MeasuredPresses) -> float | None:
        """Return zero, or None where no forces are applied."""
        return 0.0 if any(p.forces.any() for p in presses.problem.recording.presses) else None

    def patterns(self, presses: MeasuredPresses) -> Float[np.ndarray, "data k"]:
        recording = presses.problem.recording

        def work(k: int) -> dict[int, np.ndarray]:
            forces = {i: recording.presses[i].forces for i in presses.contacts[k]}
            loads = {i: shifted_forces(recording.mesh, f) for i, f in forces.items() if f.any()}
            return {i: presses.evaluation.load_response(i, [*f]) for i, f in loads.items()}

        return presses.joined(map_cases(work, len(presses.contacts)))


def shifted_forces(mesh: TetMesh, forces: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "2 n 3"]:
    """Return the changes of nodal forces (N) by shifts of the traction by its radius.

    The shifts are along two orthogonal directions in the plane of the loaded surface. Point forces
    of nodes without a loaded triangle remain.
    """
    loaded = LoadedSurface.of(mesh.surface, forces)
    out = np.zeros((2, *forces.shape))
    if not len(loaded.triangles):
        return out
    corners = mesh.points[loaded.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    # Of the hat function of each corner, from the opposite edge.
    opposite = np.roll(corners, -2, axis=1) - np.roll(corners, -1, axis=1)
    squares = (normals**2).sum(axis=1)[:, None, None]
    gradients = np.cross(normals[:, None], opposite) / squares
    tractions = loaded.tractions(forces)[loaded.triangles].mean(axis=1)
    on_triangles = loaded.areas[:, None] * tractions
    directions = np.linalg.svd(normals.sum(axis=0)[None])[2][1:]
    radius = np.sqrt(loaded.areas.sum() / np.pi)
    for change, direction in zip(out, directions, strict=True):
        slopes = radius * gradients @ direction
        np.add.at(change, loaded.triangles, slopes[..., None] * on_triangles[:, None])
    return out
