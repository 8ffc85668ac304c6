"""Equilibrium as a differentiable function, with a custom adjoint (eq. 9 to 13).

With the residual R(u; e, nu, f, X) = 0 and its tangent K = dR/du:

- forward: Newton's method finds u;
- backward: one adjoint solve K l = dL/du, then dL/d(parameter) = -l . dR/d(parameter). For the
  moduli dR/de are the unit forces of the elements (eq. 11). (The paper's eq. 12 and 13 each carry
  a minus; one of them is redundant.)
- jvp: one solve with the change of R;
- contact with a rigid probe is a part of R that depends on the probe's parameters;
- backward of backward: the adjoint solve is itself a differentiable function, whose derivative
  is another solve and the derivative of v . K l, by `reference`.

Hyperelasticity has no memory: only the final state matters, whatever load steps led to it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from tactorch.fem import reference
from tactorch.fem.assembly import Assembly
from tactorch.fem.contact import Contact
from tactorch.fem.linearization import Linearization
from tactorch.fem.newton import EquilibriumResult, Newton
from tactorch.linalg import map_cases


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
    """Load cases, by the equilibrium search of each, and their equilibria.

    With contacts, there is one for each case, and `probes` has its parameters.
    """

    body: Assembly
    search: Callable[[int], Newton]
    start: Float[np.ndarray, "cases nodes 3"] | None
    contacts: Sequence[Contact] = ()
    solved: list[SolvedCase] = field(default_factory=list)

    def equilibrate(self, count: int, factor: bool) -> Tensor:
        """Find all equilibria; factor their tangents at once if derivatives are wanted."""

        def solve(i: int) -> SolvedCase:
            newton = self.search(i)
            start = None if self.start is None else self.start[i]
            case = SolvedCase(newton, newton.run(start).require())
            if factor:
                case.linearization.factor()
            return case

        self.solved = map_cases(solve, count)
        return torch.from_numpy(np.stack([case.result.displacement for case in self.solved]))

    def solve(self, rhs: Float[Tensor, "cases nodes 3"]) -> Float[Tensor, "cases nodes 3"]:
        """Solve K x = rhs in every case; x is zero at fixed unknowns."""
        b = rhs.detach().numpy()
        columns = map_cases(lambda i: self.solved[i].linearization.solve(b[i].ravel()), len(b))
        return torch.from_numpy(np.stack(columns).reshape(b.shape))

    def work(
        self, u: Tensor, v: Tensor, youngs: Tensor, poisson: Tensor, points: Tensor, probes: Tensor
    ) -> Float[Tensor, ""]:
        """Virtual work of the elastic and contact forces at `u` on `v`, over all cases."""
        work = reference.element_work(self.body, u, v, poisson, points, per_point=youngs.ndim == 2)
        total = (work * youngs).sum()
        for contact, *fields in zip(self.contacts, u, v, probes, strict=bool(self.contacts)):
            total = total + contact.work(*fields)
        return total


class Equilibrium(torch.autograd.Function):
    """u(youngs, poisson, forces, points, probes); use it through `SoftBody.solve`."""

    @staticmethod
    def forward(  # noqa: D102
        ctx: Any,
        youngs: Tensor,
        poisson: Tensor,
        forces: Tensor,
        points: Tensor,
        probes: Tensor,
        cases: LoadCases,
    ) -> Tensor:
        u = cases.equilibrate(len(forces), factor=any(ctx.needs_input_grad[:5]))
        ctx.cases = cases
        ctx.save_for_backward(u, youngs, poisson, points, probes)
        ctx.save_for_forward(u, youngs, poisson, points, probes)
        return u

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> Any:  # noqa: D102
        u, youngs, poisson, points, probes = ctx.saved_tensors
        need = ctx.needs_input_grad
        cases: LoadCases = ctx.cases
        adjoint = AdjointSolve.apply(grad, u, youngs, poisson, points, probes, cases)
        d_youngs = None
        if need[0] and torch.is_grad_enabled():
            d_youngs = -reference.element_work(
                cases.body, u, adjoint, poisson, points, per_point=youngs.ndim == 2
            ).sum(0)
        elif need[0]:
            fields = adjoint.detach().numpy().reshape(len(u), -1, 1)
            pairs = zip(cases.solved, fields, strict=True)
            works = [case.linearization.unit_work(v) for case, v in pairs]
            d_youngs = -torch.from_numpy(np.sum(works, axis=0)).reshape(youngs.shape)
        state = (u, adjoint, youngs, poisson, points, probes)
        d_poisson, d_points, d_probes = (
            -torch.func.grad(cases.work, argnums=argument)(*state) if needed else None
            for argument, needed in ((3, need[1]), (4, need[3]), (5, need[4]))
        )
        return d_youngs, d_poisson, adjoint if need[2] else None, d_points, d_probes, None

    @staticmethod
    def jvp(  # noqa: D102
        ctx: Any, d_youngs: Any, d_poisson: Any, d_forces: Any, d_points: Any, d_probes: Any, _: Any
    ) -> Tensor:
        u, *parameters = ctx.saved_tensors
        cases: LoadCases = ctx.cases
        changes = {2: d_youngs, 3: d_poisson, 4: d_points, 5: d_probes}
        changes = {argument: d for argument, d in changes.items() if d is not None}

        def work_change(v: Tensor) -> Tensor:
            """Change of the virtual work on v; by gradients, since forward mode cannot nest."""
            if not changes:
                return (0.0 * v).sum()
            slopes = torch.func.grad(cases.work, argnums=tuple(changes))(u, v, *parameters)
            pairs = zip(slopes, changes.values(), strict=True)
            return sum(((slope * d).sum() for slope, d in pairs), u.sum() * 0)

        change = torch.func.grad(work_change)(torch.zeros_like(u))
        return cases.solve(-change if d_forces is None else d_forces - change)


class AdjointSolve(torch.autograd.Function):
    """l = K(u, youngs, poisson, points, probes)^-1 g, differentiable in all of them."""

    @staticmethod
    def forward(ctx: Any, g: Tensor, *state: Any) -> Tensor:  # noqa: D102
        *tensors, cases = state
        solution = cases.solve(g)
        ctx.cases = cases
        ctx.save_for_backward(solution, *tensors)
        return solution

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> Any:  # noqa: D102
        solution, *state = ctx.saved_tensors
        cases: LoadCases = ctx.cases
        v = AdjointSolve.apply(grad, *state, cases)

        def stiffness_work(u: Tensor, *parameters: Tensor) -> Tensor:
            """Work v . K l, as the change of the virtual work on v along l."""
            return (torch.func.grad(cases.work)(u, v, *parameters) * solution).sum()

        slopes = torch.func.grad(stiffness_work, argnums=(0, 1, 2, 3, 4))(*state)
        return v, *(-slope for slope in slopes), None
