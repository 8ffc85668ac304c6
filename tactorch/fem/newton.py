"""Newton-Raphson on the total energy (eq. 5, 6), with line search and adaptive load steps.

The line search decreases the energy and rejects inverted elements. Where the tangent is
indefinite, those of the elements are projected to positive semi-definite ones. The full load is
tried first; if it fails, the load is applied in steps that shrink and grow.
"""

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from tactorch.config import Options, option
from tactorch.errors import ConfigError, ConvergenceError
from tactorch.fem.assembly import Assembly, Response
from tactorch.fem.boundary import CaseSupports
from tactorch.fem.contact import Contact
from tactorch.fem.contact.pair import PairContact
from tactorch.fem.linearization import Linearization
from tactorch.linalg import SolverPool
from tactorch.linalg.dense import column_rank, dot
from tactorch.linalg.pool import Lease, SharedLease
from tactorch.linalg.solver import IndefiniteError, direct_solver

_ARMIJO = 1e-4  # smallest energy decrease of the line search, relative to the linear prediction
_MIN_STEP_RTOL, _MAX_STEP_RTOL = 1e-8, 0.01  # accuracy of an iterative solution for a step
_ENERGY_ROUND_OFF = 1e-11  # relative energy change below which energies are not compared
_SQUEEZED = 0.5  # volume ratio of an element under a load that is too large
# A factorisation costs ten to twenty-five solves, on small meshes as on large ones.
_MAX_CG_ITERATIONS = 10


@dataclass(frozen=True)
class NewtonOptions(Options):
    """Settings of the equilibrium search."""

    section: ClassVar[str] = "newton"

    rtol: float = option(
        1e-10, "Residual force at convergence, relative to applied and support forces", gt=0, lt=1
    )
    max_iterations: int = option(40, "Limit of iterations at the full load", ge=1)
    max_step_iterations: int = option(12, "Limit of iterations within one load step", ge=1)
    min_load_step: float = option(
        1.0 / 128.0, "Fraction of the load below which load stepping fails", gt=0, le=1
    )
    min_line_step: float = option(
        1.0 / 4096.0, "Fraction of a Newton step below which the line search fails", gt=0, le=1
    )


@dataclass(eq=False)
class EquilibriumResult:
    """Outcome of an equilibrium search.

    Attributes:
        displacement: Nodal displacements, mm.
        converged: Whether they are an equilibrium.
        reason: Reason for which the search ended.
        iterations: Number of Newton iterations over all load steps.
        load_steps: Number of load steps; one if the full load converged at once.
        residual: Largest unbalanced force, relative.
        energies: Total energy (N mm) before and after each iteration of the last load step.
        response: Element responses at an equilibrium.
    """

    displacement: Float[np.ndarray, "nodes 3"]
    converged: bool
    reason: str
    iterations: int = 0
    load_steps: int = 0
    residual: float = np.inf
    energies: list[float] = field(default_factory=list)
    response: Response | None = None

    def require(self) -> "EquilibriumResult":
        """Return self, or raise ConvergenceError with the reason and the remedy."""
        if not self.converged:
            raise ConvergenceError(self.reason)
        return self


class Newton:
    """The equilibrium search of one load case; made by `SoftBody.search`."""

    def __init__(
        self,
        assembly: Assembly,
        pool: SolverPool,
        youngs: Float[np.ndarray, "m *q"],
        forces: Float[np.ndarray, "nodes 3"],
        supports: CaseSupports,
        options: NewtonOptions,
        after: "Newton | None" = None,
        lease: Lease | SharedLease | None = None,
        contact: Contact | PairContact | None = None,
    ) -> None:
        self.assembly, self.pattern = assembly, pool.pattern
        self.youngs, self.forces, self.supports = youngs, forces, supports
        self.options, self.contact = options, contact
        self._fixed = supports.fixed.ravel()
        self._pool = pool
        # A linear problem converges in one step, if it is solved exactly.
        single = pool.has_single_precision and not assembly.material.allows_inversion
        self._allow_single_precision = single
        if lease is None:
            lease = after.lease.transfer_factorization() if after else pool.lease(single)
        self.lease: Lease | SharedLease = lease

    def run(self, start: Float[np.ndarray, "nodes 3"] | None = None) -> EquilibriumResult:
        """Find the equilibrium, from `start` (mm) if given. A failure is returned, not raised."""
        rest = np.zeros_like(self.forces)
        supported = self.supports.fixed | (self.supports.springs > 0)
        rigid_modes = self.assembly.discretisation.rigid_modes[supported.ravel()]
        if column_rank(rigid_modes, 1e-8) < 6:
            reason = (
                "Nothing holds the object: it can still move or turn as a whole. Fix a face (three "
                "nodes that are not in line), or give springs."
            )
            return EquilibriumResult(rest, False, reason)
        start = rest if start is None else start
        try:
            if self.contact is not None and not self.contact.pushes_ahead(start):
                return self._load_stepping(0)
            result = self._at_load(1.0, start, self.options.max_iterations)
            return result if result.converged else self._load_stepping(result.iterations)
        except ConvergenceError as error:  # of the linear solver: smaller steps do not help
            return EquilibriumResult(start, False, str(error))

    def with_rest_shape(self, points: Float[np.ndarray, "n 3"]) -> "Newton":
        """Return the search for a body of another rest shape (mm), which shares the solver.

        Raises:
            ConfigError: an element is inverted.
        """
        other = copy(self)
        other.assembly = replace(self.assembly, points=points)
        if not np.all(other.assembly.weights > 0):
            raise ConfigError("points invert an element, or are not finite.")
        return other

    def linearize(
        self,
        result: EquilibriumResult,
        rtol: float = 0.0,
        common: Callable[[], Float[np.ndarray, " nnz"] | None] = lambda: None,
    ) -> Linearization:
        """Return the linearisation at an equilibrium, which shares the search's solver.

        With a positive `rtol` its solutions have this relative residual, which is cheaper than a
        factorisation for a few of them. `common` gives a tangent that other load cases are near to
        as well, to be factored for all of them.
        """
        assert result.response is not None
        if not rtol:
            self._use_double_precision()
        tangent = self._tangent(result.response, result.displacement, 1.0)
        values = self.pattern.apply_dirichlet(tangent, self._fixed)
        state = (self.assembly, self.youngs, result.displacement, result.response)
        return Linearization(*state, values, self._fixed, self.lease, rtol, common)

    def unbalanced(
        self, u: Float[np.ndarray, "nodes 3"]
    ) -> tuple[Float[np.ndarray, " unknowns"], float] | None:
        """Return the unbalanced forces (N) at the full load, and the largest over that of all.

        None where an element is inverted.
        """
        if (response := self._respond(u)) is None:
            return None
        residual, scale = self._residual(response, u, 1.0)
        return residual, float(np.abs(residual).max()) / (scale or 1.0)

    def tangent_at(self, u: Float[np.ndarray, "nodes 3"]) -> Float[np.ndarray, " nnz"] | None:
        """Return the tangent that is factored at displacements; None where one inverts elements."""
        if (response := self._respond(u)) is None:
            return None
        return self.pattern.apply_dirichlet(self._tangent(response, u, 1.0), self._fixed)

    def support_forces(self, result: EquilibriumResult) -> Float[np.ndarray, "nodes 3"]:
        """Return the forces of the fixed supports on the body at an equilibrium, N."""
        assert result.response is not None
        forces = self.assembly.internal_force(result.response, self.youngs)
        forces += self.supports.springs * result.displacement - self.forces
        if self.contact is not None:
            forces += self.contact.at(result.displacement).forces
        return np.where(self.supports.fixed, forces, 0.0)

    def tangent_times(
        self, result: EquilibriumResult, fields: Float[np.ndarray, "unknowns k"]
    ) -> Float[np.ndarray, "unknowns k"]:
        """Return the tangent at an equilibrium, that of fixed unknowns included, times fields."""
        assert result.response is not None
        values = self._tangent(result.response, result.displacement, 1.0)
        return np.column_stack([self.pattern.product(values, field) for field in fields.T.copy()])

    def _load_stepping(self, iterations: int) -> EquilibriumResult:
        """Increase the load in steps: halved after a failure, doubled after fast convergence."""
        load, step, n_steps = 0.0, 0.25, 0
        u = np.zeros_like(self.forces)
        while load < 1.0:
            target = min(1.0, load + step)
            result = self._at_load(target, u, self.options.max_step_iterations)
            iterations += result.iterations
            if result.converged:
                n_steps, load, u = n_steps + 1, target, result.displacement
                if result.iterations <= 8:
                    step *= 2.0
            else:
                step *= 0.5
            if step < self.options.min_load_step:
                reason = f"{self._describe_collapse(result, load, target)} {result.reason}"
                return EquilibriumResult(u, False, reason, iterations, n_steps, result.residual)
        result.iterations, result.load_steps = iterations, n_steps
        return result

    def _describe_collapse(self, failed: EquilibriumResult, load: float, target: float) -> str:
        """Return how the object collapses, and the fraction of the load that is balanced."""
        response = self._respond(failed.displacement)
        if response is None:
            return "The start is already inverted."
        if response.smallest_volume_ratio[1] < _SQUEEZED:
            return self._describe_squeezed(response, load)
        if self._is_unstable(failed.displacement, response, target):
            return (
                f"The load collapses the object: no stable equilibrium is found beyond {load:.0%} "
                "of the load, where it buckles or leans over. Support it on more sides, lower or "
                "spread the forces, or check their unit (N) and that of the moduli (MPa)."
            )
        return (
            f"The load collapses the object: no balance is found beyond {load:.0%} of the load. "
            "Lower or spread the forces, or check their unit (N) and that of the moduli (MPa)."
        )

    def _describe_squeezed(self, response: Response, load: float) -> str:
        element, j = response.smallest_volume_ratio
        x, y, z = self.assembly.points[self.assembly.discretisation.mesh.tets[element]].mean(0)
        youngs = self.youngs[element].mean()
        return (
            f"The load collapses the object: element {element} near ({x:.3g}, {y:.3g}, {z:.3g}) mm "
            f"with {youngs:.3g} MPa is squeezed to {j:.2g} of its volume, with no "
            f"balance beyond {load:.0%} of the load. Lower the forces, check their unit (N) and "
            "that of the moduli (MPa), or spread the load."
        )

    def _is_unstable(self, u: np.ndarray, response: Response, load: float) -> bool:
        """Return whether the tangent is not positive definite, by a direct solver."""
        matrix = self.pattern.apply_dirichlet(self._tangent(response, u, load), self._fixed)
        return not direct_solver().analyse(self.pattern).factor(matrix)

    def _respond(self, u: np.ndarray) -> Response | None:
        return self.assembly.respond(u, per_point=self.youngs.ndim == 2)

    def _energy(self, response: Response, u: np.ndarray, load: float) -> tuple[float, float]:
        """Total energy, and the magnitude of its terms, to which round-off is relative."""
        elastic = dot(self.youngs.ravel(), response.energy.ravel())
        springs = 0.5 * float((self.supports.springs * u * u).sum())
        work = load * float((self.forces * u).sum())
        touching = 0.0 if self.contact is None else self.contact.moved(load).energy(u)
        total = elastic + springs + touching - work
        return total, abs(elastic) + springs + touching + abs(work)

    def _residual(self, response: Response, u: np.ndarray, load: float) -> tuple[np.ndarray, float]:
        """Unbalanced forces (flat, zero at fixed unknowns), and the largest force."""
        internal = self.assembly.internal_force(response, self.youngs) + self.supports.springs * u
        if self.contact is not None:
            internal += self.contact.moved(load).at(u).forces
        balance = (internal - load * self.forces).ravel()
        scale = max(np.abs(internal).max(), load * np.abs(self.forces).max())
        return np.where(self._fixed, 0.0, balance), float(scale)

    def _at_load(self, load: float, start: np.ndarray, max_iterations: int) -> EquilibriumResult:
        """Newton's method at one fraction of the load."""
        u = start.copy()
        response = self._respond(u)
        if response is None:
            return EquilibriumResult(u, False, "The start has inverted elements.")
        jump = np.where(self.supports.fixed, load * self.supports.prescribed - u, 0.0).ravel()
        energies: list[float] = []
        converged, reason = False, f"No convergence in {max_iterations} iterations."
        round_off = 1e-15 * float(self.youngs.max()) * self.assembly.discretisation.mesh.diagonal**2
        for iteration in range(max_iterations + 1):
            residual, scale = self._residual(response, u, load)
            size = float(np.abs(residual).max())
            relative = size / scale if scale > 0 else size
            if not jump.any():
                energies.append(self._energy(response, u, load)[0])
                if relative <= self.options.rtol or size <= round_off:
                    converged, reason = True, "forces in balance"
                    break
            if iteration == max_iterations:
                break
            # Accuracy of a step: that of Newton's quadratic convergence, or of the last step.
            rtol = max(relative, 0.3 * self.options.rtol / max(relative, self.options.rtol))
            rtol = min(max(rtol, _MIN_STEP_RTOL), _MAX_STEP_RTOL)
            step = self._step(response, u, load, residual, jump, rtol)
            if step is None:
                reason = (
                    "The tangent stays singular: a part of the object is not held, or moduli span "
                    "too many decades. Check fixed nodes, springs and the range of moduli."
                )
                break
            if jump.any():
                # Prescribed displacements are applied in one step, whose energies are not compared.
                trial = self._respond(u + step)
                if trial is None:
                    reason = "The prescribed displacements invert an element."
                    break
                u, response, jump = u + step, trial, np.zeros_like(jump)
                continue
            accepted = self._line_search(u, response, residual, step, load)
            if accepted is None:
                converged = relative <= 1e3 * self.options.rtol
                reason = (
                    "forces in balance" if converged else "The line search found no lower energy."
                )
                break
            u, response = accepted
        counts = (iteration, int(converged), relative, energies)
        return EquilibriumResult(u, converged, reason, *counts, response if converged else None)

    def _tangent(
        self, response: Response, u: np.ndarray, load: float, *, project: bool = False
    ) -> np.ndarray:
        """Values of the tangent; with `project` those of elements and contact are semi-definite."""
        springs = self.supports.springs
        values = self.assembly.tangent(response, self.youngs, springs, project=project)
        if self.contact is not None:
            contact = self.contact.moved(load)
            contact.add_tangent(values, contact.at(u), project=project)
        return values

    def _step(
        self,
        response: Response,
        u: np.ndarray,
        load: float,
        residual: np.ndarray,
        jump: np.ndarray,
        rtol: float,
    ) -> np.ndarray | None:
        """Newton step, in which fixed unknowns move by `jump`; None if the tangent is singular."""
        tangent = self._tangent(response, u, load)
        step = self._solve(tangent, residual, jump, rtol)
        if step is None or (not jump.any() and dot(residual, step) > 0.0):
            tangent = self._tangent(response, u, load, project=True)
            step = self._solve(tangent, residual, jump)
        if step is None:  # semi-definite and singular
            tangent[self.pattern.diagonal] *= 1.0 + 1e-6
            step = self._solve(tangent, residual, jump)
        return None if step is None else step.reshape(-1, 3)

    def _solve(
        self, values: np.ndarray, residual: np.ndarray, jump: np.ndarray, rtol: float = 0.0
    ) -> np.ndarray | None:
        """Solve for the step, to `rtol` if that is cheaper; None if not positive definite."""
        matrix = self.pattern.apply_dirichlet(values, self._fixed)
        rhs = -residual
        if jump.any():
            rhs = rhs - self.pattern.product(values, jump)
        rhs[self._fixed] = 0.0
        try:
            with self.lease.hold() as lease:
                step = self._iterate(lease, matrix, rhs, rtol)
            if step is None:
                self._use_double_precision()
                with self.lease.hold() as lease:
                    step = lease.solve(rhs, rtol) if lease.factor(matrix) else None
        except IndefiniteError:
            return None
        return None if step is None else step + jump

    def _iterate(
        self, lease: Lease, matrix: np.ndarray, rhs: np.ndarray, rtol: float
    ) -> np.ndarray | None:
        """Iterate with an earlier factorisation, or one in single precision.

        None where a factorisation in double precision is better: the matrix has changed too much.
        """
        step = None
        if rtol > 0.0:
            step = lease.solve_similar(matrix, rhs, rtol, _MAX_CG_ITERATIONS)
        if step is None and self._allow_single_precision and lease.single_precision:
            if lease.factor(matrix):
                goal = rtol or _MIN_STEP_RTOL
                step = lease.solve_similar(matrix, rhs, goal, _MAX_CG_ITERATIONS)
            self._allow_single_precision = step is not None
        return step

    def _use_double_precision(self) -> None:
        """Factor in double precision from here on."""
        if self.lease.single_precision:
            self.lease.close()
            self.lease = self._pool.lease()

    def _line_search(
        self, u: np.ndarray, response: Response, residual: np.ndarray, step: np.ndarray, load: float
    ) -> tuple[np.ndarray, Response] | None:
        """Shorten the step until no element is inverted and the energy decreases enough."""
        energy, size = self._energy(response, u, load)
        slope = dot(residual, step.ravel())
        noise = _ENERGY_ROUND_OFF * size
        fraction = 1.0
        while fraction >= self.options.min_line_step:
            trial_u = u + fraction * step
            trial = self._respond(trial_u)
            if trial is not None:
                change = self._energy(trial, trial_u, load)[0] - energy
                if change <= _ARMIJO * fraction * slope:
                    return trial_u, trial
                if abs(slope) <= noise and abs(change) <= noise:
                    # The change is round-off: accept what decreases the residual.
                    after = np.abs(self._residual(trial, trial_u, load)[0]).max()
                    return (trial_u, trial) if after < np.abs(residual).max() else None
            fraction *= 0.5
        return None
