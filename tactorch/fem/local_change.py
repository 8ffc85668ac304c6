"""Changes of the stiffness of a small part of a linear body, without solving the whole again.

With the compliance G = K^-1 of the uniform body and a change D of its stiffness between few
unknowns S, displacements by forces f are u - G_S Y, with u = G f and (1 + D G_SS) Y = D u_S
(Sherman, Morrison and Woodbury). The columns of G are computed once for each unknown that a change
reaches.
"""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

from tactorch.budget import work_bytes
from tactorch.errors import ConvergenceError
from tactorch.fem.body import SoftBody
from tactorch.fem.boundary import Supports
from tactorch.fem.materials import lame
from tactorch.linalg import SharedLease, map_cases
from tactorch.linalg.pool import Lease

_MAX_COLUMNS = 96  # right-hand sides solved at once
_KEPT = 0.25  # columns that are kept, over the memory for a computation


class Stiffness:
    """The factored stiffness of a body at given moduli (MPa), in single precision.

    Solutions are as accurate as they are stored.
    """

    def __init__(self, body: SoftBody, supports: Supports, youngs: np.ndarray) -> None:
        search = body.search(youngs, np.zeros((body.n_nodes, 3)), supports)
        linearization = search.linearize(search.run().require())
        self.fixed, self._tangent = linearization.fixed, linearization.tangent
        # Each thread has a separate factorisation.
        self._lease = SharedLease(body.pool, single_precision=True)
        with self._factored():
            pass

    @contextmanager
    def _factored(self) -> Iterator[Lease]:
        with self._lease.hold() as lease:
            if lease.factored is None and not lease.factor(self._tangent):
                raise ConvergenceError(
                    "The stiffness matrix is not positive definite; hold the body."
                )
            yield lease

    def solve(self, loads: sp.csr_matrix) -> Float[np.ndarray, "unknowns k"]:
        """Return the displacements by loads (rows) in single precision, mm."""
        fields = np.empty(loads.shape[::-1], dtype=np.float32)

        def work(k: int) -> None:
            block = slice(k * _MAX_COLUMNS, (k + 1) * _MAX_COLUMNS)
            forces = loads[block].T.toarray(order="F")
            forces[self.fixed] = 0.0
            with self._factored() as lease:
                fields[:, block] = lease.solve(forces)

        map_cases(work, -(-fields.shape[1] // _MAX_COLUMNS))
        return fields


class GreenFunction:
    """Displacements of the uniform body of unit modulus by forces on single unknowns.

    Args:
        body: The body.
        stiffness: Its factored stiffness.
        loads: Loads whose displacements are needed.
    """

    def __init__(self, body: SoftBody, stiffness: Stiffness, loads: sp.csr_matrix) -> None:
        self.body, self.loads = body, loads
        self._stiffness = stiffness
        # Column of each unknown, and how the loads move it.
        self._known: dict[int, tuple[np.ndarray, np.ndarray]] = {}

    def unknowns(self, elements: Int[np.ndarray, " e"]) -> Int[np.ndarray, " u"]:
        """Return the unknowns at the nodes of some elements that are not fixed."""
        nodes = np.unique(self.body.discretisation.nodes[elements])
        unknowns = (3 * nodes[:, None] + np.arange(3)).ravel()
        return np.asarray(unknowns[~self._stiffness.fixed[unknowns]])

    def require(self, unknowns: Int[np.ndarray, " u"]) -> None:
        """Compute the columns of some unknowns that are not known; drop others if they are many."""
        size = self.loads.shape[1]
        if 4.0 * size * len(self._known) > _KEPT * work_bytes():
            self._known = {j: self._known[j] for j in unknowns.tolist() if j in self._known}
        missing = [j for j in unknowns.tolist() if j not in self._known]
        if not missing:
            return
        ones, rows = np.ones(len(missing)), np.arange(len(missing))
        unit = sp.csr_matrix((ones, (rows, missing)), shape=(len(missing), size))
        columns = self._stiffness.solve(unit)
        moved = self.loads.astype(np.float32) @ columns
        for k, j in enumerate(missing):
            self._known[j] = columns[:, k].copy(), moved[:, k].copy()

    def between(
        self, rows: Int[np.ndarray, " r"], columns: Int[np.ndarray, " c"]
    ) -> Float[np.ndarray, "r c"]:
        """Return the compliance between unknowns, mm/N, in double precision."""
        found = [self._known[j][0][rows] for j in columns.tolist()]
        return np.array(found, dtype=float).reshape(len(found), len(rows)).T

    def moved(self, unknowns: Int[np.ndarray, " u"]) -> Float[np.ndarray, "u loads"]:
        """Return the displacements of unknowns by the loads, mm."""
        moved = [self._known[j][1] for j in unknowns.tolist()]
        return np.array(moved, dtype=np.float32).reshape(len(moved), self.loads.shape[0])


class LocalChange:
    """The body of modulus `scale` with a change of it in some elements.

    Args:
        green: Displacements of the uniform body.
        scale: Its modulus, MPa.
        ratios: Relative change of each modulus.
        elements: Elements with a change.
    """

    def __init__(
        self,
        green: GreenFunction,
        scale: float,
        ratios: Float[np.ndarray, "m *q"],
        elements: Int[np.ndarray, " e"],
    ) -> None:
        self.scale, self._green = scale, green
        self._unknowns = unknowns = green.unknowns(elements)
        green.require(unknowns)
        moved = green.moved(unknowns)
        change = self._stiffness(ratios, elements)
        system = np.eye(len(unknowns)) + change @ green.between(unknowns, unknowns)
        self._forces = np.linalg.solve(system, change @ moved).astype(np.float32)
        self._moved = moved

    def less(self, profiles: int) -> Float[np.ndarray, "places k k"]:
        """Return what the change takes from the compliance between the profiles of each place.

        It is for a modulus of one, in mm/N.
        """
        parts = (
            x.reshape(len(x), profiles, x.shape[1] // profiles) for x in (self._moved, self._forces)
        )
        less = np.einsum("sap,sbp->pab", *parts, dtype=float)
        return 0.5 * (less + less.swapaxes(1, 2))

    def fields(
        self, elements: Int[np.ndarray, " e"]
    ) -> tuple[Float[np.ndarray, "rows loads"], Int[np.ndarray, "m _"]]:
        """Return displacements of the nodes of elements, and the rows for all elements.

        They are in mm/N, in single precision.
        """
        green, known = self._green, self._green.unknowns(elements)
        green.require(np.union1d(known, self._unknowns))
        moved = green.moved(known)
        if len(self._unknowns):
            moved -= green.between(known, self._unknowns).astype(np.float32) @ self._forces
        nodes = np.unique(green.body.discretisation.nodes[elements])
        all_nodes = np.zeros(green.body.n_nodes, dtype=green.body.discretisation.nodes.dtype)
        all_nodes[nodes] = np.arange(len(nodes))
        rows = 3 * all_nodes[known // 3] + known % 3
        fields = np.zeros((3 * len(nodes), moved.shape[1]), dtype=np.float32)
        fields[rows] = moved / np.float32(self.scale)
        return fields, all_nodes[green.body.discretisation.nodes]

    def _stiffness(
        self, ratios: Float[np.ndarray, "m *q"], elements: Int[np.ndarray, " e"]
    ) -> sp.csr_matrix:
        """Return the change of the stiffness between the unknowns, for a modulus of one, N/mm."""
        assembly, size = self._green.body.assembly, len(self._unknowns)
        poisson = np.broadcast_to(np.asarray(assembly.poisson), len(assembly.weights))
        first, second = (value[:, None] for value in lame(poisson[elements]))
        change = ratios.reshape(len(ratios), -1)[elements]
        weights, slopes = assembly.weights[elements] * change, assembly.gradients[elements]
        shears = np.einsum("eq,eqai,eqbj->eaibj", second * weights, slopes, slopes)
        blocks = np.einsum("eq,eqai,eqbj->eaibj", first * weights, slopes, slopes)
        blocks += shears.transpose(0, 1, 4, 3, 2)
        blocks += np.einsum("eakbk,ij->eaibj", shears, np.eye(3))
        numbers = np.full(3 * self._green.body.n_nodes, -1)
        numbers[self._unknowns] = np.arange(size)
        at = numbers[3 * self._green.body.discretisation.nodes[elements][..., None] + np.arange(3)]
        at = at.reshape(len(elements), 3 * at.shape[1])
        rows, cols = (np.broadcast_to(x, (*at.shape, at.shape[1])).ravel()
                      for x in (at[:, :, None], at[:, None, :]))  # fmt: skip
        free = (rows >= 0) & (cols >= 0)
        entries = blocks.ravel()[free], (rows[free], cols[free])
        return sp.csr_matrix(entries, shape=(size, size))
