"""Errors of the places of contacts, which press and observe the object beside where they report.

Where a contact is displaced by d along the surface, its traction t(x) becomes t(x - d), and the
displacement that it reports at x is that at x + d. The nodal forces are integrals of t times the
shape functions N, so that to first order

    f' = int (d . grad N) t dA,        u' = K^-1 f' + (d . grad) u,

with the tangent K. On a half-space of uniform modulus both terms cancel. What remains is due to the
edges and supports of the body and to inclusions.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from tactorch.fem.elements import Discretisation
from tactorch.inverse.problem import Evaluation
from tactorch.inverse.shapes.sizing import Rim
from tactorch.linalg import map_cases
from tactorch.mesh import TetMesh
from tactorch.mesh.tractions import LoadedSurface
from tactorch.recording import Recording

_MIDPOINTS = (1.0 - np.eye(3)) / 2.0  # quadrature points of a triangle, of equal weights
_MIN_COSINE = 0.8  # between the normals of a contact and of the triangles whose gradients count


def place_patterns(
    recording: Recording,
    evaluation: Evaluation,
    contacts: Sequence[tuple[Sequence[int], Rim]],
    smallest: float,
) -> Float[np.ndarray, "data k"]:
    """Return the changes of the data by errors of the places of contacts.

    Each contact has one along either of two directions in the surface, common to its presses. Their
    deviation is the radius of the contact. The unit is the standard deviation of the white noise;
    patterns of a norm below `smallest` are left out.

    Args:
        recording: The presses.
        evaluation: Their predictions, and derivatives.
        contacts: Presses of each contact, and its rim.
        smallest: Smallest norm of a pattern.
    """
    counts, observations = evaluation.data.counts, evaluation.data.observations

    def work(k: int) -> np.ndarray:
        numbers, rim = contacts[k]
        directions = _directions(recording.mesh, recording.presses[numbers[0]].forces)
        placed = [np.zeros((count, 2)) for count in counts]
        for i in numbers:
            changes = _changes(evaluation, i, recording.presses[i].forces, directions)
            placed[i] = rim.radius_mm * observations[i].scale[:, None] * changes
        return np.vstack(placed)

    columns = np.hstack([np.zeros((sum(counts), 0)), *map_cases(work, len(contacts))])
    return columns[:, np.linalg.norm(columns, axis=0) > smallest]


def _directions(mesh: TetMesh, forces: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "2 3"]:
    """Return two orthogonal unit vectors in the surface under a contact."""
    return np.linalg.svd(_normal(mesh, forces)[None])[2][1:]


def _normal(mesh: TetMesh, forces: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "3"]:
    """Return the mean unit normal of the surface under a contact."""
    loaded = (forces != 0.0).any(axis=1)[mesh.surface.triangles].all(axis=1)
    normal = mesh.surface.areas[loaded] @ mesh.surface.normals[loaded]
    return np.asarray(normal / np.linalg.norm(normal))


def _changes(
    evaluation: Evaluation,
    press: int,
    forces: Float[np.ndarray, "n 3"],
    directions: Float[np.ndarray, "2 3"],
) -> Float[np.ndarray, "p 2"]:
    """Return the changes of the data (mm) of a press by 1 mm along each direction."""
    case = evaluation.sensitivities[press]
    discretisation = evaluation.search(press).assembly.discretisation
    loads = np.array([moved_load(discretisation, forces, e) for e in directions])
    normal = _normal(discretisation.mesh, forces)
    fields = [
        response + along_surface(discretisation, evaluation.displacements[press], e, normal)
        for response, e in zip(case.linearization.force_response(loads), directions, strict=True)
    ]
    return np.column_stack([case.observe(field) for field in fields])


def moved_load(
    discretisation: Discretisation,
    forces: Float[np.ndarray, "n 3"],
    direction: Float[np.ndarray, "3"],
) -> Float[np.ndarray, "nodes 3"]:
    """Return the change of the nodal forces where their traction is displaced, N per mm.

    Args:
        discretisation: Mesh and element.
        forces: Nodal forces on the vertices, N.
        direction: Unit vector along the surface.
    """
    mesh = discretisation.mesh
    loaded = LoadedSurface.of(mesh.surface, forces)
    values = loaded.tractions(forces)[loaded.triangles]
    rates = _barycentric_rates(mesh.points[loaded.triangles], direction)
    out = np.zeros((discretisation.n_nodes, 3))
    nodes = discretisation.surface_nodes(loaded.triangles)
    for point in _MIDPOINTS:
        force = loaded.areas[:, None] / len(_MIDPOINTS) * np.einsum("c,tcd->td", point, values)
        derivatives = _derivatives(discretisation, point, rates)
        np.add.at(out, nodes, derivatives[:, :, None] * force[:, None, :])
    return out


def along_surface(
    discretisation: Discretisation,
    displacement: Float[np.ndarray, "nodes 3"],
    direction: Float[np.ndarray, "3"],
    normal: Float[np.ndarray, "3"],
) -> Float[np.ndarray, "nodes 3"]:
    """Return the derivative of a displacement along the surface at the vertices, zero elsewhere.

    It is the mean of those of the triangles around a vertex whose normals are near `normal`,
    weighted with their areas.

    Args:
        discretisation: Mesh and element.
        displacement: Displacement of the nodes, mm.
        direction: Unit vector along the surface.
        normal: Normal of the surface.
    """
    mesh = discretisation.mesh
    chosen = mesh.surface.normals @ normal > _MIN_COSINE
    triangles, areas = mesh.surface.triangles[chosen], mesh.surface.areas[chosen]
    rates = _barycentric_rates(mesh.points[triangles], direction)
    values = displacement[discretisation.surface_nodes(triangles)]
    total, weight = np.zeros((discretisation.n_nodes, 3)), np.zeros(discretisation.n_nodes)
    for corner, point in enumerate(np.eye(3)):
        slopes = np.einsum("tk,tkd->td", _derivatives(discretisation, point, rates), values)
        np.add.at(total, triangles[:, corner], areas[:, None] * slopes)
        np.add.at(weight, triangles[:, corner], areas)
    return total / np.where(weight > 0.0, weight, 1.0)[:, None]


def _barycentric_rates(
    corners: Float[np.ndarray, "t 3 3"], direction: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "t 3"]:
    """Return the derivatives of the barycentric coordinates of triangles along a direction."""
    sides = corners[:, 1:] - corners[:, :1]
    gram = np.einsum("tic,tjc->tij", sides, sides)
    others = np.linalg.solve(gram, (sides @ direction)[:, :, None])[:, :, 0]
    return np.column_stack([-others.sum(axis=1), others])


def _derivatives(
    discretisation: Discretisation,
    point: Float[np.ndarray, "3"],
    rates: Float[np.ndarray, "t 3"],
) -> Float[np.ndarray, "t k"]:
    """Return the derivatives of the shape functions at a point, given those of its coordinates.

    They are in the order of `Discretisation.surface_nodes`.
    """
    if not discretisation.element.quadratic:
        return rates
    pairs = [(a, (a + 1) % 3) for a in range(3)]
    mixed = [4.0 * (point[a] * rates[:, b] + point[b] * rates[:, a]) for a, b in pairs]
    return np.column_stack([(4.0 * point - 1.0) * rates, *mixed])
