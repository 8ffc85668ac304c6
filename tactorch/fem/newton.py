"""Newton-Raphson on the total energy (eq. 5, 6), made to survive what touch does to soft bodies.

Line search on the energy; no step through an inverted element; the tangent projected to
positive semi-definite, element by element, only where the true one is indefinite; the full load
first, and steps that shrink and grow where that fails.
"""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConvergenceError
from tactorch.fem.assembly import Assembly, Response
from tactorch.fem.linearization import Linearization
from tactorch.fem.supports import HeldCase
from tactorch.linalg import (
    IndefiniteError,
    SolverPool,
    Status,
    column_rank,
    dot,
    lagged_solve,
)
from tactorch.linalg.pool import Lease

_ARMIJO = 1e-4
_LOOSE, _TIGHT = 0.01, 1e-8  # accuracy of a step solved with an older factorisation
_ROUND_OFF = 1e-11  # relative energy change below which energies no longer compare


@dataclass(frozen=True)
class NewtonOptions:
    """Settings of the equilibrium search.

    Attributes:
        rtol: Residual force at convergence, relative to the applied and support forces.
        max_iterations: Cap at the full load.
        max_step_iterations: Cap within one load step, once the full load at once has failed.
        min_load_step: Fraction of the load below which a step is given up.
        min_line_step: Fraction of a Newton step below which the line search is given up.
    """

    rtol: float = 1e-10
    max_iterations: int = 40
    max_step_iterations: int = 12
    min_load_step: float = 1.0 / 128.0
    min_line_step: float = 1.0 / 4096.0


@dataclass(eq=False)
class EquilibriumResult:
    """What the search found.

    Attributes:
        displacement: Nodal displacements, mm.
        converged: Whether they are an equilibrium.
        reason: Why the search ended, in words.
        iterations: Newton iterations over all load steps.
        load_steps: Load steps taken (one when the full load worked at once).
        energies: Total energy (N mm) before and after each iteration of the last load step.
        residual: Largest unbalanced force, relative.
        response: Element responses at `displacement`.
    """

    displacement: Float[np.ndarray, "nodes 3"]
    converged: bool
    reason: str
    iterations: int
    load_steps: int
    residual: float
    energies: list[float] = field(default_factory=list)
    response: Response | None = None

    def require(self) -> "EquilibriumResult":
        """Return self, or raise.

        Raises:
            ConvergenceError: no equilibrium was found; the message says why and what to try.
        """
        if not self.converged:
            raise ConvergenceError(self.reason)
        return self


class Newton:
    """One load case: a body, its moduli, its supports and its forces."""

    def __init__(
        self,
        assembly: Assembly,
        pool: SolverPool,
        youngs: Float[np.ndarray, " m"],
        forces: Float[np.ndarray, "nodes 3"],
        held: HeldCase,
        options: NewtonOptions | None = None,
        after: "Newton | None" = None,
    ) -> None:
        """Take the problem; nothing is computed yet.

        A search `after` another of a similar tangent takes over the factorisation that the other
        has made, which must then factor anew. So a mesh whose factors fill the memory needs them
        once only, and the first steps need none.
        """
        self.assembly = assembly
        self.pattern = pool.pattern
        self.youngs = youngs
        self.forces = forces
        self.held = held
        self.options = options or NewtonOptions()
        self._fixed = held.fixed.ravel()
        self._pool = pool
        # What is linear is solved at once, if exactly.
        self._allow_single_precision = pool.has_single_precision and assembly.barrier
        self._lease: Lease = (
            pool.lease(self._allow_single_precision)
            if after is None
            else after._lease.transfer_factorization()
        )
        self._factored = self._lease.factored
        if after is not None:
            after._factored = False

    def run(self, start: Float[np.ndarray, "nodes 3"] | None = None) -> EquilibriumResult:
        """Find the equilibrium, warm from `start` if given."""
        rest = np.zeros_like(self.forces)
        if not self._is_held():
            reason = (
                "Nothing holds the object: it can still move or turn as a whole. Fix a face (three "
                "nodes that are not in line), or give springs."
            )
            return EquilibriumResult(rest, False, reason, 0, 0, np.inf)
        found = self._at_load(1.0, rest if start is None else start, self.options.max_iterations)
        if not found.converged:
            found = self._in_steps(found.iterations)
        return found

    def _is_held(self) -> bool:
        """Whether the supports resist all six rigid motions."""
        modes = self.assembly.discretisation.rigid_modes[self.held.held.ravel()]
        return len(modes) >= 6 and column_rank(modes, 1e-8) == 6

    def linearize(self, found: EquilibriumResult) -> Linearization:
        """Return the tangent at an equilibrium."""
        assert found.response is not None
        self._turn_exact()
        values = self.pattern.apply_dirichlet(self._tangent(found.response), self._fixed)
        self._factored = False  # the solver is the linearisation's from now on
        return Linearization(self.pattern, values, self._lease, self._fixed)

    def _in_steps(self, spent: int) -> EquilibriumResult:
        """Walk up from the unloaded state; shrink the step on failure, grow it on ease."""
        load, step, taken = 0.0, 0.25, 0
        u = np.zeros_like(self.forces)
        while load < 1.0:
            target = min(1.0, load + step)
            found = self._at_load(target, u, self.options.max_step_iterations)
            spent += found.iterations
            if found.converged:
                taken, load, u = taken + 1, target, found.displacement
                if found.iterations <= 8:
                    step *= 2.0
            else:
                step *= 0.5
            if step < self.options.min_load_step:
                reason = f"{self._collapse(found, load)} {found.reason}"
                return EquilibriumResult(u, False, reason, spent, taken, found.residual)
        found.iterations, found.load_steps = spent, taken
        return found

    def _collapse(self, failed: EquilibriumResult, load: float) -> str:
        """Say where the body gives way, and under which share of the load."""
        response = self.assembly.respond(failed.displacement)
        if response is None:
            return "The start is already inverted."
        element, j = response.worst
        x, y, z = self.assembly.points[self.assembly.discretisation.mesh.tets[element]].mean(0)
        return (
            f"The load collapses the object: element {element} near ({x:.3g}, {y:.3g}, {z:.3g}) mm "
            f"with {self.youngs[element]:.3g} MPa is squeezed to {j:.2g} of its volume, with no "
            f"balance beyond {load:.0%} of the load. Lower the forces, check their unit (N) and "
            "that of the moduli (MPa), or spread the load."
        )

    def _tangent(self, response: Response) -> np.ndarray:
        values = self.assembly.tangent(response, self.youngs)
        values[self.pattern.diagonal] += self.held.springs.ravel()
        return values

    def _definite_tangent(self, response: Response) -> np.ndarray:
        values = self.assembly.definite_tangent(response, self.youngs)
        values[self.pattern.diagonal] += self.held.springs.ravel()
        return values

    def _energy(self, response: Response, u: np.ndarray, load: float) -> tuple[float, float]:
        """Total energy, and the size of its terms (for judging round-off)."""
        elastic = dot(self.youngs, response.energy)
        springs = 0.5 * float((self.held.springs * u * u).sum())
        work = load * float((self.forces * u).sum())
        return elastic + springs - work, abs(elastic) + springs + abs(work)

    def _residual(self, response: Response, u: np.ndarray, load: float) -> tuple[np.ndarray, float]:
        """Unbalanced forces (flat, zero at fixed unknowns), and the scale to judge them by."""
        internal = self.assembly.internal_force(response, self.youngs) + self.held.springs * u
        balance = (internal - load * self.forces).ravel()
        scale = max(np.abs(internal).max(), load * np.abs(self.forces).max())
        return np.where(self._fixed, 0.0, balance), float(scale)

    def _at_load(self, load: float, start: np.ndarray, cap: int) -> EquilibriumResult:
        """Newton at one load factor, `cap` iterations at most."""
        u = start.copy()
        response = self.assembly.respond(u)
        if response is None:
            return EquilibriumResult(u, False, "The start has inverted elements.", 0, 0, np.inf)
        jump = np.where(self.held.fixed, load * self.held.prescribed - u, 0.0).ravel()
        energies: list[float] = []
        reason, relative = f"No convergence in {cap} iterations.", np.inf
        for iteration in range(cap + 1):
            residual, scale = self._residual(response, u, load)
            size = float(np.abs(residual).max())
            relative = size / scale if scale > 0 else size
            if not jump.any():
                energies.append(self._energy(response, u, load)[0])
                if relative <= self.options.rtol or size <= self._floor():
                    return self._found(u, iteration, energies, relative, response)
            if iteration == cap:
                break
            step = self._step(response, residual, jump, self._accuracy(relative))
            if step is None:
                reason = (
                    "The tangent stays singular: a part of the object is not held, or moduli span "
                    "too many decades. Check fixed nodes, springs and the range of moduli."
                )
                break
            if jump.any():
                # Prescribed displacements are entered at once; energies do not compare here.
                trial = self.assembly.respond(u + step)
                if trial is None:
                    reason = "The prescribed displacements invert an element."
                    break
                u, response, jump = u + step, trial, np.zeros_like(jump)
                continue
            moved = self._search(u, response, residual, step, load)
            if moved is None:
                if relative <= 1e3 * self.options.rtol:
                    return self._found(u, iteration, energies, relative, response)
                reason = "The line search found no lower energy."
                break
            u, response = moved
        return EquilibriumResult(u, False, reason, iteration, 0, relative, energies)

    def _found(
        self, u: np.ndarray, iteration: int, energies: list[float], relative: float, at: Response
    ) -> EquilibriumResult:
        return EquilibriumResult(u, True, "forces in balance", iteration, 1, relative, energies, at)

    def _accuracy(self, relative: float) -> float:
        """How exactly to solve for a step: as well as Newton's own error, or to the end."""
        wanted = max(relative, 0.3 * self.options.rtol / max(relative, self.options.rtol))
        return min(max(wanted, _TIGHT), _LOOSE)

    def _floor(self) -> float:
        """Force that round-off alone makes (N)."""
        return 1e-15 * float(self.youngs.max()) * self.assembly.discretisation.mesh.diagonal**2

    def _step(
        self, response: Response, residual: np.ndarray, jump: np.ndarray, rtol: float
    ) -> np.ndarray | None:
        """Newton step, where fixed unknowns move by `jump`; None if the tangent stays singular."""
        step = self._solve(self._tangent(response), residual, jump, rtol)
        if step is None or (not jump.any() and dot(residual, step) > 0.0):
            step = self._solve(self._definite_tangent(response), residual, jump)
        if step is None:  # semi-definite and singular: shift it
            values = self._definite_tangent(response)
            values[self.pattern.diagonal] *= 1.0 + 1e-6
            step = self._solve(values, residual, jump)
        return None if step is None else step.reshape(-1, 3)

    def _solve(
        self, values: np.ndarray, residual: np.ndarray, jump: np.ndarray, rtol: float = 0.0
    ) -> np.ndarray | None:
        """Solve for the step, to `rtol` if that is cheaper; None if not positive definite."""
        held = self.pattern.apply_dirichlet(values, self._fixed)
        rhs = -residual
        if jump.any():
            rhs = rhs - self.pattern.product(values, jump)
        rhs[self._fixed] = 0.0
        try:
            if self._factored and self._lease.direct and rtol > 0.0:
                step = lagged_solve(self.pattern, held, self._lease, rhs, rtol)
                if step is not None:
                    return step + jump
            if self._allow_single_precision and self._lease.single_precision:
                if self._lease.factor(held) is Status.OK:
                    step = lagged_solve(self.pattern, held, self._lease, rhs, rtol or _TIGHT)
                    if step is not None:
                        self._factored = True
                        return step + jump
                self._allow_single_precision = False
            self._turn_exact()
            self._factored = self._lease.factor(held) is Status.OK
            return self._lease.solve(rhs) + jump if self._factored else None
        except IndefiniteError:
            self._factored = False
            return None

    def _turn_exact(self) -> None:
        """Factor exactly from here on."""
        if self._lease.single_precision:
            self._lease.close()
            self._lease = self._pool.lease()

    def _search(
        self, u: np.ndarray, response: Response, residual: np.ndarray, step: np.ndarray, load: float
    ) -> tuple[np.ndarray, Response] | None:
        """Shorten the step until no element inverts and the energy falls enough."""
        energy, size = self._energy(response, u, load)
        slope = dot(residual, step.ravel())
        noise = _ROUND_OFF * size
        fraction = 1.0
        while fraction >= self.options.min_line_step:
            trial_u = u + fraction * step
            trial = self.assembly.respond(trial_u)
            if trial is not None:
                change = self._energy(trial, trial_u, load)[0] - energy
                if change <= _ARMIJO * fraction * slope:
                    return trial_u, trial
                if abs(slope) <= noise and abs(change) <= noise:
                    # Energies no longer compare: accept what lowers the residual.
                    after = np.abs(self._residual(trial, trial_u, load)[0]).max()
                    return (trial_u, trial) if after < np.abs(residual).max() else None
            fraction *= 0.5
        return None
