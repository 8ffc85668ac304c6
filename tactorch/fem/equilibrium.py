"""Equilibrium as a differentiable function, with a custom adjoint (eq. 9 to 13).

With the residual R(u; e, nu, f, X) = 0 and its tangent K = dR/du:

- forward: Newton's method finds u;
- backward: one adjoint solve K l = dL/du, then dL/d(parameter) = -l . dR/d(parameter). For the
  moduli dR/de are the unit forces of the elements (eq. 11). (The paper's eq. 12 and 13 each carry
  a minus; one of them is redundant.)
- jvp: one solve with the change of R;
- backward of backward: the adjoint solve is itself a differentiable function, whose derivative
  is another solve and the derivative of v . K l, by `reference`.

Hyperelasticity has no memory: only the final state matters, whatever load steps led to it.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from tactorch.fem import reference
from tactorch.fem.assembly import Assembly
from tactorch.fem.linearization import Linearization
from tactorch.fem.newton import EquilibriumResult, Newton, NewtonOptions
from tactorch.fem.supports import Supports
from tactorch.linalg import SolverPool, map_cases


@dataclass(frozen=True, eq=False)
class SolvedCase:
    """One load case at its equilibrium."""

    newton: Newton
    result: EquilibriumResult

    @cached_property
    def linearization(self) -> Linearization:
        """The tangent and its derivatives; assembled at first use."""
        return self.newton.linearize(self.result)


@dataclass(eq=False)
class LoadCases:
    """The inputs of a batch of load cases that are not differentiated, and its equilibria."""

    assembly: Assembly
    pool: SolverPool
    options: NewtonOptions
    supports: Supports
    start: Float[np.ndarray, "cases nodes 3"] | None
    solved: list[SolvedCase] = field(default_factory=list)

    def equilibrate(
        self, youngs: Tensor, poisson: Tensor, forces: Tensor, points: Tensor, factor: bool
    ) -> Tensor:
        """Find all equilibria; factor their tangents at once if derivatives are wanted."""
        body, nu, x = self.assembly, poisson.detach().numpy(), points.detach().numpy()
        if not (np.array_equal(nu, body.poisson) and np.array_equal(x, body.points)):
            body = replace(body, poisson=nu if nu.ndim else float(nu), points=x)
        e, f = youngs.detach().numpy(), forces.detach().numpy()

        def solve(i: int) -> SolvedCase:
            supports = self.supports.case(i, body.discretisation)
            newton = Newton(body, self.pool, e, f[i], supports, self.options)
            start = None if self.start is None else self.start[i]
            case = SolvedCase(newton, newton.run(start).require())
            if factor:
                case.linearization.factor()
            return case

        self.solved = map_cases(solve, len(f))
        return torch.from_numpy(np.stack([case.result.displacement for case in self.solved]))

    def solve(self, rhs: Float[Tensor, "cases nodes 3"]) -> Float[Tensor, "cases nodes 3"]:
        """Solve K x = rhs in every case; x is zero at fixed unknowns."""
        b = rhs.detach().numpy()
        columns = map_cases(lambda i: self.solved[i].linearization.solve(b[i].ravel()), len(b))
        return torch.from_numpy(np.stack(columns).reshape(b.shape))

    def element_work(self, u: Tensor, v: Tensor, poisson: Tensor, points: Tensor) -> Tensor:
        """Virtual work of the unit forces at `u` on `v`, per case and element."""
        body = self.assembly
        return reference.element_work(body.discretisation, body.material, u, v, poisson, points)

    def work(
        self, u: Tensor, v: Tensor, youngs: Tensor, poisson: Tensor, points: Tensor
    ) -> Float[Tensor, ""]:
        """Virtual work of the elastic forces at `u` on `v`, over all cases."""
        return (self.element_work(u, v, poisson, points) * youngs).sum()


class Equilibrium(torch.autograd.Function):
    """u(youngs, poisson, forces, points); use it through `SoftBody.solve`."""

    @staticmethod
    def forward(  # noqa: D102
        ctx: Any, youngs: Tensor, poisson: Tensor, forces: Tensor, points: Tensor, cases: LoadCases
    ) -> Tensor:
        factor = any(ctx.needs_input_grad[:4])
        u = cases.equilibrate(youngs, poisson, forces, points, factor)
        ctx.cases = cases
        ctx.save_for_backward(u, youngs, poisson, points)
        ctx.save_for_forward(u, youngs, poisson, points)
        return u

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> Any:  # noqa: D102
        u, youngs, poisson, points = ctx.saved_tensors
        need = ctx.needs_input_grad
        cases: LoadCases = ctx.cases
        adjoint = AdjointSolve.apply(grad, u, youngs, poisson, points, cases)
        d_youngs = d_poisson = d_points = None
        if need[0] and torch.is_grad_enabled():
            d_youngs = -cases.element_work(u, adjoint, poisson, points).sum(0)
        elif need[0]:
            fields = adjoint.detach().numpy().reshape(len(u), -1, 1)
            works = [
                case.linearization.unit_work(v)
                for case, v in zip(cases.solved, fields, strict=True)
            ]
            d_youngs = -torch.from_numpy(np.sum(works, axis=0)[:, 0])
        if need[1]:
            slope = torch.func.grad(cases.work, argnums=3)
            d_poisson = -slope(u, adjoint, youngs, poisson, points)
        if need[3]:
            slope = torch.func.grad(cases.work, argnums=4)
            d_points = -slope(u, adjoint, youngs, poisson, points)
        return d_youngs, d_poisson, adjoint if need[2] else None, d_points, None

    @staticmethod
    def jvp(  # noqa: D102
        ctx: Any, d_youngs: Any, d_poisson: Any, d_forces: Any, d_points: Any, _: Any
    ) -> Tensor:
        u, youngs, poisson, points = ctx.saved_tensors
        cases: LoadCases = ctx.cases
        changes = {2: d_youngs, 3: d_poisson, 4: d_points}
        changes = {argument: d for argument, d in changes.items() if d is not None}

        def work_change(v: Tensor) -> Tensor:
            """Change of the virtual work on v; by gradients, since forward mode cannot nest."""
            if not changes:
                return (0.0 * v).sum()
            slopes = torch.func.grad(cases.work, argnums=tuple(changes))(
                u, v, youngs, poisson, points
            )
            pairs = zip(slopes, changes.values(), strict=True)
            return sum(((slope * d).sum() for slope, d in pairs), u.sum() * 0)

        change = torch.func.grad(work_change)(torch.zeros_like(u))
        rhs = -change if d_forces is None else d_forces - change
        return cases.solve(rhs)


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
        cases: LoadCases,
    ) -> Tensor:
        solution = cases.solve(g)
        ctx.cases = cases
        ctx.save_for_backward(solution, u, youngs, poisson, points)
        return solution

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> Any:  # noqa: D102
        solution, u, youngs, poisson, points = ctx.saved_tensors
        cases: LoadCases = ctx.cases
        v = AdjointSolve.apply(grad, u, youngs, poisson, points, cases)

        def stiffness_work(u: Tensor, e: Tensor, nu: Tensor, x: Tensor) -> Tensor:
            """Work v . K l, as the change of the virtual work on v along l."""
            forces = torch.func.grad(cases.work, argnums=0)(u, v, e, nu, x)
            return (forces * solution).sum()

        slopes = torch.func.grad(stiffness_work, argnums=(0, 1, 2, 3))(u, youngs, poisson, points)
        return v, *(-slope for slope in slopes), None
