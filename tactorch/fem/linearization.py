"""The tangent at an equilibrium, and the derivatives of displacements that follow from it.

At an equilibrium the residual R(u; e, ...) = 0 has the tangent K = dR/du. One factorisation of K
serves every derivative: the adjoint and the directional derivative take one solve, the matrix
S du/de one solve per observed degree of freedom (eq. 10 to 14 of the paper).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
import scipy.sparse as sp
import torch
from jaxtyping import Bool, Float, Int

from tactorch.errors import ConvergenceError
from tactorch.fem import kernels, reference
from tactorch.fem.assembly import Assembly, Response
from tactorch.linalg.pool import Lease, SharedLease
from tactorch.linalg.solver import IndefiniteError

_MAX_COLUMNS = 256  # right-hand sides solved at once; bounds the memory on large meshes
_MAX_ITERATIONS = 12  # of conjugate gradients
# Right-hand sides for which a factorisation in single precision costs less than the iterations that
# it saves.
_MIN_COLUMNS = 4
_UNSTABLE = (
    "The equilibrium is unstable (its tangent is not positive definite), so no derivative exists "
    "there; lower the load."
)


@dataclass(eq=False)
class Linearization:
    """An equilibrium with its tangent K, which is factored once, at the first solve."""

    assembly: Assembly
    youngs: Float[np.ndarray, "m *q"]  # MPa
    displacement: Float[np.ndarray, "nodes 3"]  # at equilibrium, mm
    response: Response  # at the displacement
    tangent: Float[np.ndarray, " nnz"]  # K, with the rows of fixed unknowns reduced to the diagonal
    fixed: Bool[np.ndarray, " size"]
    lease: Lease | SharedLease  # solver that factors K
    # Where positive: solutions are iterative, to this relative residual, preconditioned by the
    # factorisation of a nearby tangent that the lease has.
    rtol: float = 0.0
    # Gives a tangent near those of all load cases that share the lease, if there is one.
    common: Callable[[], Float[np.ndarray, " nnz"] | None] = lambda: None

    def factor(self) -> None:
        """Factor K, unless this is done; ConvergenceError if it is found not positive definite.

        Iterative solvers may find this only in `solve`, and multigrid may not find it at all.
        """
        with self.lease.hold() as lease:
            self._factor(lease)

    def _factor(self, lease: Lease) -> None:
        if lease.factored is not self.tangent and not lease.factor(self.tangent):
            raise ConvergenceError(_UNSTABLE)

    def solve(
        self, rhs: Float[np.ndarray, "size *k"], rtol: float | None = None
    ) -> Float[np.ndarray, "size *k"]:
        """Return the solution of K x = rhs, with x = 0 at fixed unknowns; see `factor`.

        A relative residual `rtol` replaces that of the attribute where solutions are iterative; one
        of 1 accepts those of the factorisation at hand, of a similar tangent.
        """
        rtol = rtol if rtol and self.rtol else self.rtol
        if self.fixed.any():
            rhs = rhs.copy(order="K")
            rhs[self.fixed] = 0.0
        with self.lease.hold() as lease:
            many = rhs.ndim == 2 and rhs.shape[1] >= _MIN_COLUMNS
            if rtol > 0.0 and many and lease.factored is not self.tangent:
                self._renew(lease)
            if rtol >= 1.0 and lease.factored is not None:
                return lease.solve(rhs)
            iterate = partial(lease.solve_similar, self.tangent, rhs, rtol, _MAX_ITERATIONS)
            if rtol > 0.0 and (solution := iterate()) is not None:
                return solution
            self._factor(lease)
            if lease.single_precision and (solution := iterate()) is not None:
                return solution
            try:
                return lease.solve(rhs)
            except IndefiniteError as error:
                raise ConvergenceError(_UNSTABLE) from error

    def _renew(self, lease: Lease) -> None:
        """Factor a tangent in single precision, once for all load cases at these moduli.

        It preconditions their solutions, and later searches at similar moduli.
        """
        if lease.single_precision and lease.direct and lease.about is not self.youngs:
            common = self.common()
            lease.factor(self.tangent if common is None else common, self.youngs)

    def unit_work(self, fields: Float[np.ndarray, "size k"]) -> Float[np.ndarray, "moduli k"]:
        """Return the transpose of dR/de (eq. 11) times nodal fields."""
        forces = self.response.forces
        out = np.empty((*forces.shape[:2], fields.shape[1]))
        columns = np.ascontiguousarray(fields).reshape(-1, 3, fields.shape[1])
        kernels.gather_dot(self.assembly.discretisation.nodes, forces, columns, out)
        return out.reshape(-1, fields.shape[1])

    def displacement_change(
        self, change: Float[np.ndarray, " moduli"]
    ) -> Float[np.ndarray, "nodes 3"]:
        """Return du/de times a change of the moduli (MPa), mm."""
        forces = self.assembly.internal_force(self.response, change)
        return -self.solve(forces.ravel()).reshape(-1, 3)

    def force_response(
        self, forces: Float[np.ndarray, "k nodes 3"], rtol: float | None = None
    ) -> list[np.ndarray]:
        """Return the displacement (nodes, 3) due to each of k changes of the forces (N), mm.

        See `solve` for `rtol`.
        """
        if not len(forces):
            return []
        rhs = np.asfortranarray(forces.reshape(len(forces), -1).T)
        return list(np.ascontiguousarray(self.solve(rhs, rtol).T).reshape(forces.shape))

    def parameter_forces(
        self, *, poisson: bool = False, stretch: bool = False
    ) -> list[Float[np.ndarray, "nodes 3"]]:
        """Return the derivatives of the elastic forces, N.

        They are by Poisson's ratio, and by the logarithm of the size along x, y and z.
        """
        body = self.assembly
        ratio = torch.tensor(body.poisson, dtype=torch.float64, requires_grad=True)
        points = torch.tensor(body.points, requires_grad=True)
        u, youngs = torch.from_numpy(self.displacement), torch.from_numpy(self.youngs)
        weights = torch.zeros_like(u, requires_grad=True)
        with torch.enable_grad():
            # The work of the forces is linear in the weights, so that the derivative of its
            # gradient by them is the forward derivative. Forward mode itself is not thread-safe.
            work = reference.element_work(
                body, u, weights, ratio, points, per_point=youngs.ndim == 2
            )
            work = (work * youngs).sum()
            by_ratio, by_points = torch.autograd.grad(work, (ratio, points), create_graph=True)
            slopes = [by_ratio.sum()] if poisson else []
            slopes += list((by_points * points).sum(0)) if stretch else []
            rates = [torch.autograd.grad(s, weights, retain_graph=True)[0] for s in slopes]
        return [rate.numpy() for rate in rates]

    def second_order(
        self, adjoint: Float[np.ndarray, "nodes 3"], change: Float[np.ndarray, " moduli"]
    ) -> Float[np.ndarray, " moduli"]:
        """Return the change of the adjoint gradient beyond that of Gauss-Newton.

        With K l = dL/du and the gradient g = -U^T l, U = dR/de, a change d of the moduli moves u
        by v = -K^-1 U d and, at constant dL/du, g by -(DU[v])^T l + U^T K^-1 DK[d, v] l.
        """
        moved = torch.from_numpy(self.displacement_change(change))
        u = torch.tensor(self.displacement, requires_grad=True)
        youngs = torch.tensor(self.youngs, requires_grad=True)
        with torch.enable_grad():
            work = reference.element_work(
                self.assembly, u, torch.from_numpy(adjoint), per_point=youngs.ndim == 2
            )
            (force,) = torch.autograd.grad((work * youngs).sum(), u, create_graph=True)
            along = (force * moved).sum() + (work.ravel() * torch.from_numpy(change).ravel()).sum()
            by_u, by_youngs = torch.autograd.grad(along, (u, youngs))
        back = self.solve(by_u.numpy().ravel())
        return self.unit_work(back[:, None])[:, 0] - by_youngs.numpy().ravel()


@dataclass(frozen=True, eq=False)
class ReadingRates:
    """Derivatives of k data that are not displacements of nodes, at an equilibrium.

    With the elastic forces f(u, e) of all nodes, d data / de is `by_displacement` du/de plus
    `by_forces` df/de.
    """

    by_displacement: sp.csr_matrix  # of all nodes, the total one where elastic forces enter
    by_forces: sp.csr_matrix  # of nodes whose displacement is prescribed

    @staticmethod
    def stack(rates: "Sequence[ReadingRates]") -> "ReadingRates":
        """Return the derivatives of several data."""
        first, second = zip(*((r.by_displacement, r.by_forces) for r in rates), strict=True)
        return ReadingRates(sp.vstack(first, format="csr"), sp.vstack(second, format="csr"))

    @staticmethod
    def of_displacements(rows: sp.csr_matrix) -> "ReadingRates":
        """Return the derivatives of data that are linear in the displacements."""
        return ReadingRates(rows, sp.csr_matrix(rows.shape))


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """The derivative of the data of a press by Young's moduli.

    There is one modulus for each element, or one for each quadrature point, in the order of the
    flattened array of moduli. The data are displacements, maybe followed by other readings.

    Attributes:
        linearization: The equilibrium.
        observed: Observed unknowns, 3 node + axis.
        frame: Rotation into the axes of the observation; None for those of the mesh.
        readings: Derivatives of further data.
    """

    linearization: Linearization
    observed: Int[np.ndarray, " p"]
    frame: Float[np.ndarray, "3 3"] | None = None
    readings: ReadingRates | None = None

    @cached_property
    def selection(self) -> sp.csr_matrix:
        """Matrix S of the derivatives by the displacements, (data, unknowns)."""
        size = self.linearization.fixed.size
        rows = sp.identity(size, format="csr")[self.observed]
        if self.frame is not None:
            rows = (rows @ sp.kron(sp.identity(size // 3), self.frame)).tocsr()
        if self.readings is None:
            return rows
        return sp.vstack([rows, self.readings.by_displacement], format="csr")

    @cached_property
    def _direct(self) -> sp.csr_matrix | None:
        """Derivatives by elastic forces, (data, unknowns); None where all are zero."""
        if self.readings is None or not self.readings.by_forces.nnz:
            return None
        above = sp.csr_matrix((len(self.observed), self.linearization.fixed.size))
        return sp.vstack([above, self.readings.by_forces], format="csr")

    def matrix(self) -> Float[np.ndarray, "data moduli"]:
        """Return the derivative, 1/MPa times the unit of each datum (eq. 13 and 14)."""
        count = self.selection.shape[0]
        out = np.empty((count, self.linearization.youngs.size))
        for begin in range(0, count, _MAX_COLUMNS):
            rows = slice(begin, begin + _MAX_COLUMNS)
            fields = self.linearization.solve(self.selection[rows].T.toarray(order="F"))
            if self._direct is not None:
                fields = fields - self._direct[rows].T.toarray()
            out[rows] = -self.linearization.unit_work(fields).T
        return out

    def times_each(
        self, changes: Float[np.ndarray, "k moduli"]
    ) -> tuple[Float[np.ndarray, "data k"], list[Float[np.ndarray, "nodes 3"]]]:
        """Return the changes of the data, and of the displacements, by changes of the moduli."""
        linear = self.linearization
        forces = [linear.assembly.internal_force(linear.response, change) for change in changes]
        fields = [-field for field in linear.force_response(np.array(forces))]
        data = [self.observe(*pair) for pair in zip(fields, forces, strict=True)]
        return np.reshape(data, (len(changes), self.selection.shape[0])).T, fields

    def load_response(
        self, loads: Float[np.ndarray, "k nodes 3"], rtol: float | None = None
    ) -> Float[np.ndarray, "data k"]:
        """Return the changes of the data by loads (N), by one solve per load or datum.

        See `Linearization.solve` for `rtol`.
        """
        if len(loads) <= self.selection.shape[0]:
            moved = self.linearization.force_response(loads, rtol)
            data = [self.observe(u) for u in moved]
            return np.reshape(data, (len(loads), self.selection.shape[0])).T
        fields = self.linearization.solve(self.selection.T.toarray(order="F"), rtol)
        return np.asarray(fields.T @ loads.reshape(len(loads), -1).T)

    def transpose_times(self, weights: Float[np.ndarray, " data"]) -> Float[np.ndarray, " moduli"]:
        """Return the transposed derivative times weights of the data: the gradient (eq. 12)."""
        field = self.adjoint(weights).reshape(-1, 1)
        return -self.linearization.unit_work(field)[:, 0]

    def adjoint(self, weights: Float[np.ndarray, " data"]) -> Float[np.ndarray, "nodes 3"]:
        """Return the displacement due to the weights of the data as forces."""
        field = self.linearization.solve(self.selection.T @ weights)
        if self._direct is not None:
            field = field - self._direct.T @ weights
        return field.reshape(-1, 3)

    def observed_components(self, report: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " data"]:
        """Return a change of the reported displacements as one of the data."""
        change = np.zeros(self.selection.shape[0])
        change[: len(self.observed)] = report.ravel()[self.observed]
        return change

    def observe(
        self,
        field: Float[np.ndarray, "nodes 3"],
        elastic: Float[np.ndarray, "nodes 3"] | None = None,
    ) -> Float[np.ndarray, " data"]:
        """Return the change of the data by changes of displacements and of elastic forces.

        Args:
            field: Change of the displacements, mm.
            elastic: Change of the elastic forces at constant displacements, less that of the
                applied ones, N; zero by default.
        """
        data: np.ndarray = self.selection @ field.ravel()
        if elastic is not None and self._direct is not None:
            data = data + self._direct @ elastic.ravel()
        return data
