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
from tactorch.inverse.problem import Evaluation
from tactorch.inverse.shapes.kept import KeptRims, press_key
from tactorch.inverse.shapes.sizing import Rim
from tactorch.linalg import map_cases
from tactorch.mesh.tractions import LoadedSurface
from tactorch.recording import Recording

_AT_ONCE = 100  # solves with one factorisation


def rim_patterns(
    recording: Recording,
    evaluation: Evaluation,
    contacts: Sequence[tuple[Sequence[int], Rim]],
    smallest: float,
    kept: KeptRims | None = None,
) -> Float[np.ndarray, "data k"]:
    """Return the changes of the data by errors of the traction at the rims of contacts.

    The errors at the edges of a rim are independent, and each is common to the presses of its
    contact. Their deviation is the mean traction of the press. The products of the patterns with
    their transpose are those of all errors. Their unit is the standard deviation of the white
    noise; patterns of a norm below `smallest` are left out.

    Args:
        recording: The presses.
        evaluation: Their predictions with quadratic elements, and derivatives.
        contacts: Presses of each contact, and the nodes where its traction is uncertain.
        smallest: Smallest norm of a pattern.
        kept: Changes that are known, maybe of an earlier search; others are added.
    """
    known = {} if kept is None else kept.responses
    counts = evaluation.data.counts

    def work(k: int) -> np.ndarray:
        numbers, rim = contacts[k]
        presses = [recording.presses[i] for i in numbers]
        key = press_key(recording, presses)
        if key not in known:
            pairs = zip(numbers, presses, strict=True)
            known[key] = [_responses(evaluation, i, press.forces, rim) for i, press in pairs]
        scales = [evaluation.data.observations[i].scale for i in numbers]
        blocks = [s[:, None] * block for s, block in zip(scales, known[key], strict=True)]
        basis, sizes, _ = np.linalg.svd(np.vstack(blocks), full_matrices=False)
        columns = basis[:, sizes > smallest] * sizes[sizes > smallest]
        parts = np.split(columns, np.cumsum([len(block) for block in blocks])[:-1])
        placed = [np.zeros((count, columns.shape[1])) for count in counts]
        for i, part in zip(numbers, parts, strict=True):
            placed[i] = part
        return np.vstack(placed)

    found = map_cases(work, len(contacts))
    return np.hstack([np.zeros((sum(counts), 0)), *found])


def _responses(
    evaluation: Evaluation, press: int, forces: Float[np.ndarray, "n 3"], rim: Rim
) -> Float[np.ndarray, "p edges"]:
    """Return the changes of the data (mm) of a press by the errors at each edge of the rim."""
    case = evaluation.sensitivities[press]
    discretisation = evaluation.search(press).assembly.discretisation
    loaded = LoadedSurface.of(discretisation.mesh.surface, forces)
    ends, areas = rim_edges(loaded, rim.nodes)
    traction = forces.sum(axis=0) / loaded.areas.sum()
    columns = []
    for part in np.array_split(np.arange(len(ends)), max(1, len(ends) // _AT_ONCE)):
        loads = _midside_loads(discretisation, ends[part], areas[part], traction)
        moved = case.linearization.force_response(loads)
        columns += [case.observe(u) for u in moved]
    return np.column_stack(columns)


def rim_edges(
    loaded: LoadedSurface, rim: Int[np.ndarray, " nodes"]
) -> tuple[Int[np.ndarray, "edges 2"], Float[np.ndarray, " edges"]]:
    """Return the edges of the loaded triangles with a node at the rim.

    Args:
        loaded: Loaded triangles.
        rim: Nodes at the rim.

    Returns:
        End points of each edge, and the integral of the shape function of its midpoint over these
        triangles, a third of their area, mm^2.
    """
    beside = np.isin(loaded.triangles, rim).any(axis=1)
    triangles, thirds = loaded.triangles[beside], loaded.areas[beside] / 3.0
    edges = np.sort(np.concatenate([triangles[:, [a, (a + 1) % 3]] for a in range(3)]), axis=1)
    ends, index = np.unique(edges, axis=0, return_inverse=True)
    return ends, np.bincount(index.ravel(), np.tile(thirds, 3), minlength=len(ends))


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
