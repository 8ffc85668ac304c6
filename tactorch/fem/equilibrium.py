"""Equilibrium as a differentiable function, with a custom adjoint (eq. 9 to 13).

Writing R(u; e, nu, f, X) = 0 for the balance of forces and K = dR/du:

- forward: Newton finds u;
- backward: one adjoint solve K l = dL/du, then dL/d(parameter) = -l . dR/d(parameter). For the
  moduli dR/de are the elements' unit forces (eq. 11). (The paper's eq. 12 and 13 each carry a
  minus; one of them is too many.)
- jvp: one solve with the change of R;
- backward of backward: the adjoint solve is itself a differentiable function, whose derivative
  is another solve and the derivative of v . K l. These come from `reference`.

Hyperelasticity has no memory, so only the final state matters, whatever steps led there.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from tactorch.fem import kernels, reference
from tactorch.fem.assembly import Assembly
from tactorch.fem.linearization import Linearization
from tactorch.fem.newton import EquilibriumResult, Newton, NewtonOptions
from tactorch.fem.parallel import map_cases
from tactorch.fem.supports import Supports
from tactorch.linalg import SolverPool


@dataclass(eq=False)
class Problem:
    """Everything about a batch of load cases that is not differentiated."""

    assembly: Assembly
    pool: SolverPool
    options: NewtonOptions
    supports: Supports
    start: Float[np.ndarray, "cases nodes 3"] | None
    found: list[EquilibriumResult] = field(default_factory=list)
    tangents: list[Callable[[], Linearization]] = field(default_factory=list)

    def solve_forward(
        self, youngs: Tensor, poisson: Tensor, forces: Tensor, points: Tensor, eager: bool
    ) -> Tensor:
        """Find all equilibria; factor the tangents there if derivatives are sure to follow."""
        assembly = self._assembly_at(poisson.detach().numpy(), points.detach().numpy())
        e, f = youngs.detach().numpy(), forces.detach().numpy()

        def work(i: int) -> tuple[EquilibriumResult, Callable[[], Linearization]]:
            held = self.supports.case(i, assembly.discretisation)
            newton = Newton(assembly, self.pool, e, f[i], held, self.options)
            found = newton.run(None if self.start is None else self.start[i]).require()
            tangent = _once(lambda: newton.linearize(found))
            if eager:
                tangent().factor()
            return found, tangent

        results = map_cases(work, len(f))
        self.found, self.tangents = map(list, zip(*results, strict=True))
        return torch.from_numpy(np.stack([found.displacement for found in self.found]))

    def _assembly_at(self, poisson: np.ndarray, points: np.ndarray) -> Assembly:
        """The given assembly, or another where Poisson's ratio or the rest shape differ."""
        own = self.assembly
        if np.array_equal(poisson, own.poisson) and np.array_equal(points, own.points):
            return own
        return replace(own, poisson=poisson if poisson.ndim else float(poisson), points=points)

    def solve_adjoint(self, rhs: Float[Tensor, "cases nodes 3"]) -> Float[Tensor, "cases nodes 3"]:
        """Solve K x = rhs in every case; x is zero at fixed unknowns."""
        b = rhs.detach().numpy()
        columns = map_cases(lambda i: self.tangents[i]().solve(b[i].ravel()), len(b))
        return torch.from_numpy(np.stack(columns).reshape(b.shape))

    def unit_work(self, v: Float[Tensor, "cases nodes 3"]) -> Float[Tensor, " m"]:
        """Sum over cases of each element's unit force (eq. 11) times `v`, by the kernels."""
        total = torch.zeros(len(self.assembly.weights), dtype=torch.float64)
        nodes = self.assembly.discretisation.nodes
        out = np.empty((len(nodes), 1))
        for found, field_ in zip(self.found, v.detach().numpy(), strict=True):
            assert found.response is not None
            kernels.gather_dot(nodes, found.response.forces, field_[:, :, None], out)
            total += torch.from_numpy(out[:, 0])
        return total

    def work(
        self, u: Tensor, v: Tensor, youngs: Tensor, poisson: Tensor, points: Tensor
    ) -> Float[Tensor, ""]:
        """Virtual work of the elastic forces at `u` on `v`, over all cases."""
        d, material = self.assembly.discretisation, self.assembly.material
        per_element = reference.element_work(d, material, u, v, poisson, points)
        return (per_element * youngs).sum()


def _once(make: Callable[[], Linearization]) -> Callable[[], Linearization]:
    """Make the linearisation at first use and keep it."""
    kept: list[Linearization] = []

    def get() -> Linearization:
        if not kept:
            kept.append(make())
        return kept[0]

    return get


class Equilibrium(torch.autograd.Function):
    """u(youngs, poisson, forces, points); use it through `SoftBody.solve`."""

    @staticmethod
    def forward(  # noqa: D102
        ctx: Any, youngs: Tensor, poisson: Tensor, forces: Tensor, points: Tensor, problem: Problem
    ) -> Tensor:
        eager = any(ctx.needs_input_grad[:4])
        u = problem.solve_forward(youngs, poisson, forces, points, eager)
        ctx.problem = problem
        ctx.save_for_backward(u, youngs, poisson, points)
        ctx.save_for_forward(u, youngs, poisson, points)
        return u

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> Any:  # noqa: D102
        u, youngs, poisson, points = ctx.saved_tensors
        need = ctx.needs_input_grad
        problem: Problem = ctx.problem
        differentiable = torch.is_grad_enabled()
        adjoint = AdjointSolve.apply(grad, u, youngs, poisson, points, problem)
        d_youngs = d_poisson = d_points = None
        if need[0] and differentiable:
            d, material = problem.assembly.discretisation, problem.assembly.material
            work = reference.element_work(d, material, u, adjoint, poisson, points)
            d_youngs = -work.sum(0)
        elif need[0]:
            d_youngs = -problem.unit_work(adjoint)
        if need[1]:
            slope = torch.func.grad(problem.work, argnums=3)
            d_poisson = -slope(u, adjoint, youngs, poisson, points)
        if need[3]:
            slope = torch.func.grad(problem.work, argnums=4)
            d_points = -slope(u, adjoint, youngs, poisson, points)
        return d_youngs, d_poisson, adjoint if need[2] else None, d_points, None

    @staticmethod
    def jvp(  # noqa: D102
        ctx: Any, d_youngs: Any, d_poisson: Any, d_forces: Any, d_points: Any, _: Any
    ) -> Tensor:
        u, youngs, poisson, points = ctx.saved_tensors
        problem: Problem = ctx.problem

        given = [(k, d) for k, d in ((2, d_youngs), (3, d_poisson), (4, d_points)) if d is not None]

        def work_change(v: Tensor) -> Tensor:
            """Change of the elastic forces' work on v; forward mode cannot nest: by gradients."""
            if not given:
                return (0.0 * v).sum()
            slopes = torch.func.grad(problem.work, argnums=tuple(k for k, _ in given))(
                u, v, youngs, poisson, points
            )
            return sum(
                ((s * d).sum() for s, (_, d) in zip(slopes, given, strict=True)), u.sum() * 0
            )

        change = torch.func.grad(work_change)(torch.zeros_like(u))
        rhs = -change if d_forces is None else d_forces - change
        return problem.solve_adjoint(rhs)


class AdjointSolve(torch.autograd.Function):
    """l = K(u, youngs, poisson, points)^-1 g, differentiable in all of them."""

    @staticmethod
    def forward(  # noqa: D102
        ctx: Any,
        g: Tensor,
        u: Tensor,
        youngs: Tensor,
        poisson: Tensor,
        points: Tensor,
        problem: Problem,
    ) -> Tensor:
        solution = problem.solve_adjoint(g)
        ctx.problem = problem
        ctx.save_for_backward(solution, u, youngs, poisson, points)
        return solution

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> Any:  # noqa: D102
        solution, u, youngs, poisson, points = ctx.saved_tensors
        problem: Problem = ctx.problem
        v = AdjointSolve.apply(grad, u, youngs, poisson, points, problem)

        def stiffness_work(u: Tensor, e: Tensor, nu: Tensor, x: Tensor) -> Tensor:
            """Work v . K l, as the change of the virtual work on v along l."""
            forces = torch.func.grad(problem.work, argnums=0)(u, v, e, nu, x)
            return (forces * solution).sum()

        slopes = torch.func.grad(stiffness_work, argnums=(0, 1, 2, 3))(u, youngs, poisson, points)
        return v, *(-slope for slope in slopes), None
