"""Errors of the traction at the rims of contacts, which nodal forces do not determine.

Nodal forces determine the integrals of the traction times the hat functions of the surface. Where a
contact ends within a triangle, the traction changes there in a way that no hat function resolves,
and so does that of a gel which does not slip, where it ends at an edge of the body. For each edge
of the loaded triangles at the rim, the error is a traction proportional to the shape function of
its midpoint, less the point forces at the ends that restore the integrals.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from tactorch.fem.elements import Discretisation
from tactorch.inverse.errors.base import (
    LEAST_CHANGE,
    ErrorSource,
    MeasuredPresses,
    press_key,
    principal,
)
from tactorch.inverse.forward.problem import Evaluation
from tactorch.linalg import map_cases
from tactorch.mesh.topology import triangle_edges
from tactorch.mesh.tractions import LoadedSurface

# That of a gel that does not slip at an edge of the body, where the traction is singular: by the
# nodal forces of a wider gel on a uniform cube, of edges of an eighth of its side, the most
# probable deviation is 0.2 to 0.5.
EDGE_DEVIATION = 0.3
_AT_ONCE = 100  # solves with one factorisation
# Of these solves: those with the factorisation of a similar tangent, right within a tenth, are good
# enough, as the size of the errors is known to a factor of two.
_RTOL = 1.0


class Rims(ErrorSource):
    """Errors of the traction at each edge of a contact's rim, over the mean traction of a press."""

    name, elements, proposal = "rims", "quadratic", "tractions at rims wrong by {:.0%}"
    levels = (0.1, 0.2, 0.5)
    smallest = LEAST_CHANGE / levels[-1]

    def least(self, presses: MeasuredPresses) -> float | None:
        """Return the deviation at an edge of the body, if a sensor's contact ends at one."""
        if not presses.rims:
            return None
        return EDGE_DEVIATION if presses.at_edge else 0.0

    def patterns(self, presses: MeasuredPresses) -> Float[np.ndarray, "data k"]:
        """Return orthogonal changes common to the presses of each contact."""
        evaluation, recording = presses.evaluation, presses.problem.recording
        known = presses.kept.responses

        def work(k: int) -> dict[int, np.ndarray]:
            numbers, rim = presses.rims[k]
            chosen = [recording.presses[i] for i in numbers]
            key = press_key(recording, chosen)
            if key not in known:
                known[key] = _responses(evaluation, numbers, [p.forces for p in chosen], rim)
            scales = [evaluation.data.observations[i].scale for i in numbers]
            blocks = [s[:, None] * block for s, block in zip(scales, known[key], strict=True)]
            columns = principal(np.vstack(blocks), self.smallest)
            parts = np.split(columns, np.cumsum([len(block) for block in blocks])[:-1])
            return dict(zip(numbers, parts, strict=True))

        return presses.joined(map_cases(work, len(presses.rims)))


def _responses(
    evaluation: Evaluation,
    presses: Sequence[int],
    forces: Sequence[Float[np.ndarray, "n 3"]],
    rim: Int[np.ndarray, " nodes"],
) -> list[Float[np.ndarray, "_ edges"]]:
    """Return the changes of the data (mm) of a contact's presses by the errors at each rim edge.

    They are those of the largest load in proportion to the loads.
    """
    sizes = [float(np.linalg.norm(force)) for force in forces]
    last = int(np.argmax(sizes))
    largest = forces[last]
    discretisation = evaluation.search(presses[last]).assembly.discretisation
    loaded = LoadedSurface.of(discretisation.mesh.surface, largest)
    ends, areas = rim_edges(loaded, rim)
    traction, columns = largest.sum(axis=0) / loaded.areas.sum(), []
    for part in np.array_split(np.arange(len(ends)), max(1, len(ends) // _AT_ONCE)):
        loads = _midside_loads(discretisation, ends[part], areas[part], traction)
        columns.append(evaluation.response_to_loads(presses[last], loads, _RTOL))
    changes = np.hstack(columns)
    return [size / sizes[last] * changes for size in sizes]


def rim_edges(
    loaded: LoadedSurface, rim: Int[np.ndarray, " nodes"]
) -> tuple[Int[np.ndarray, "edges 2"], Float[np.ndarray, " edges"]]:
    """Return the ends of the edges of loaded triangles with a node at the rim, and their areas.

    The area of an edge is the integral of the shape function of its midpoint over these triangles,
    a third of theirs, mm^2.
    """
    beside = np.isin(loaded.triangles, rim).any(axis=1)
    triangles, thirds = loaded.triangles[beside], loaded.areas[beside] / 3.0
    ends, index = np.unique(triangle_edges(triangles), axis=0, return_inverse=True)
    return ends, np.bincount(index.ravel(), np.repeat(thirds, 3), minlength=len(ends))


def _midside_loads(
    discretisation: Discretisation,
    ends: Int[np.ndarray, "k 2"],
    areas: Float[np.ndarray, " k"],
    traction: Float[np.ndarray, "3"],
) -> Float[np.ndarray, "k nodes 3"]:
    """Return the loads of a traction at each midpoint, with none on hat functions, N."""
    loads = np.zeros((len(ends), discretisation.n_nodes, 3))
    rows, force = np.arange(len(ends)), areas[:, None] * traction
    loads[rows, discretisation.midside(*ends.T)] = force
    for end in ends.T:
        loads[rows, end] -= 0.5 * force
    return loads
