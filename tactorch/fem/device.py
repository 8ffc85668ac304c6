"""All load cases at once on a device: elements and linear solves in torch, batched.

Newton's steps come from conjugate gradients without a matrix: the product with the tangent is one
backward pass through the elements' forces. What cases have to decide (line search, convergence) is
decided for each by itself, without leaving the device. It is meant for CUDA; on the CPU the
factorisations of `SoftBody` are far faster.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from tactorch.errors import ConfigError, ConvergenceError
from tactorch.fem import reference
from tactorch.fem.batched_cg import solve_batch
from tactorch.fem.body import SoftBody
from tactorch.fem.materials.base import lame
from tactorch.fem.supports import Supports

_HALVINGS, _ARMIJO = 14, 1e-4
_LOOSE, _ROUND_OFF = 0.1, 1e-11


@dataclass(frozen=True)
class DeviceOptions:
    """Settings of the search on a device.

    Attributes:
        rtol: Residual force at convergence, relative to the largest force of the case.
        max_iterations: Cap on Newton steps.
        max_cg: Cap on conjugate gradients in each.
    """

    rtol: float = 1e-9
    max_iterations: int = 40
    max_cg: int = 4000


class DeviceBody:
    """A soft body on a device, for batches of load cases.

    Args:
        body: The body; its mesh, element, material and Poisson's ratio are used.
        device: "cuda", "cuda:1", "cpu" and so on.
        options: Settings of the search.

    Raises:
        ConfigError: the device is not there.
    """

    def __init__(
        self, body: SoftBody, device: str = "cuda", options: DeviceOptions | None = None
    ) -> None:
        """Bring the mesh to the device."""
        if device.startswith("cuda") and not torch.cuda.is_available():
            raise ConfigError(f"device={device}: there is no CUDA device here; give device=cpu.")
        self.device = torch.device(device)
        self.options = options or DeviceOptions()
        self._body = body
        self._points = torch.tensor(body.mesh.points, device=self.device)
        self._poisson = torch.as_tensor(
            body.assembly.poisson, dtype=torch.float64, device=self.device
        )

    def equilibrate(
        self,
        youngs: Float[np.ndarray, " m"],
        forces: Float[np.ndarray, "cases n 3"],
        supports: Supports,
    ) -> Float[Tensor, "cases nodes 3"]:
        """Find the equilibria of all cases, mm, on the device.

        Args:
            youngs: Young's modulus of each element, MPa.
            forces: Nodal forces of each case, N.
            supports: What holds the body, the same for all cases or one each.

        Raises:
            ConvergenceError: some case has none within the iterations; names it.
        """
        self._set(youngs, forces, supports)
        u = torch.where(self._fixed, self._prescribed, torch.zeros_like(self._forces))
        for _ in range(self.options.max_iterations):
            with torch.enable_grad():
                moving = u.detach().requires_grad_()
                internal = self._internal(moving)
            residual = self._balance(internal.detach(), u)
            relative = self._size(residual) / self._scale(internal.detach())
            if bool((relative <= self.options.rtol).all()):
                return u
            accuracy = torch.clamp(relative.sqrt(), 0.1 * self.options.rtol, _LOOSE)
            step = solve_batch(
                self._tangent(internal, moving), -residual, self._jacobi, accuracy,
                self.options.max_cg,
            )  # fmt: skip
            done = relative <= self.options.rtol
            u = self._line_search(u, torch.where(done[:, None, None], 0.0, step), residual)
        internal = self._internal(u)
        relative = self._size(self._balance(internal, u)) / self._scale(internal)
        if bool((relative <= self.options.rtol).all()):
            return u
        bad = torch.nonzero(relative > self.options.rtol)[:, 0].tolist()
        raise ConvergenceError(
            f"Load cases {bad} have no equilibrium after {self.options.max_iterations} steps on "
            f"'{self.device}'. Solve them with SoftBody, which steps the load, or lower the load."
        )

    def adjoint(
        self, displacement: Float[Tensor, "cases nodes 3"], weights: Float[Tensor, "cases nodes 3"]
    ) -> Float[Tensor, " m"]:
        """Return the gradient of the sum of weights times displacements by the moduli (eq. 12).

        Args:
            displacement: What `equilibrate` found last, mm.
            weights: Derivative of a scalar by the displacements, 1/mm.
        """
        with torch.enable_grad():
            moving = displacement.detach().requires_grad_()
            internal = self._internal(moving)
        rhs = torch.where(self._fixed, 0.0, weights.to(self.device))
        accuracy = torch.full((len(rhs),), 1e-10, dtype=torch.float64, device=self.device)
        solution = solve_batch(
            self._tangent(internal, moving), rhs, self._jacobi, accuracy, self.options.max_cg
        )
        d, material = self._body.discretisation, self._body.material
        work = reference.element_work(
            d, material, displacement, solution, self._poisson, self._points
        )
        return -work.sum(0)

    def _set(self, youngs: np.ndarray, forces: np.ndarray, supports: Supports) -> None:
        d = self._body.discretisation
        supports.require_cases(len(forces))
        held = [supports.case(i, d) for i in range(len(forces))]

        def stacked(arrays: list[np.ndarray]) -> Tensor:
            return torch.from_numpy(np.stack(arrays)).to(self.device)

        self._youngs = torch.tensor(youngs, device=self.device)
        self._forces = stacked([d.consistent_loads(case) for case in forces])
        self._fixed: Bool[Tensor, "cases nodes 3"] = stacked([case.fixed for case in held])
        self._springs = stacked([case.springs for case in held])
        self._prescribed = stacked([case.prescribed for case in held])
        self._blocks = self._preconditioner()

    def _internal(self, u: Float[Tensor, "cases nodes 3"]) -> Float[Tensor, "cases nodes 3"]:
        d, material = self._body.discretisation, self._body.material
        return reference.internal_force(d, material, u, self._youngs, self._poisson, self._points)

    def _balance(self, internal: Tensor, u: Tensor) -> Tensor:
        return torch.where(self._fixed, 0.0, internal + self._springs * u - self._forces)

    def _scale(self, internal: Tensor) -> Float[Tensor, " cases"]:
        largest = torch.maximum(self._size(internal), self._size(self._forces))
        return torch.where(largest > 0, largest, 1.0)

    @staticmethod
    def _size(field: Tensor) -> Float[Tensor, " cases"]:
        return field.abs().flatten(1).amax(1)

    def _tangent(self, internal: Tensor, moving: Tensor) -> Callable[[Tensor], Tensor]:
        """The product with K: symmetric, so that pulling back is pushing forward."""

        def times(v: Tensor) -> Tensor:
            free = torch.where(self._fixed, 0.0, v)
            with torch.enable_grad():
                (pulled,) = torch.autograd.grad(internal, moving, free, retain_graph=True)
            return torch.where(self._fixed, v, pulled + self._springs * free)

        return times

    def _energy(self, u: Tensor) -> tuple[Float[Tensor, " cases"], Float[Tensor, " cases"]]:
        """Total energy of each case, infinite where an element is inverted; size of its terms."""
        d, material = self._body.discretisation, self._body.material
        gradients, _ = d.geometry(self._points)
        F = reference.deformation_gradient(d, u, gradients)
        sound = torch.linalg.det(F).flatten(1).amin(1) > 0
        safe = torch.where(sound[:, None, None], u, 0.0)
        elastic = reference.element_energy(d, material, safe, self._poisson, self._points)
        inner = (elastic * self._youngs).sum(1)
        springs = 0.5 * (self._springs * u * u).flatten(1).sum(1)
        work = (self._forces * u).flatten(1).sum(1)
        total = torch.where(sound, inner + springs - work, torch.inf)
        return total, inner.abs() + springs + work.abs()

    def _line_search(self, u: Tensor, step: Tensor, residual: Tensor) -> Tensor:
        """Halve each case's step until its energy falls enough."""
        before, size = self._energy(u)
        slope = (residual * step).flatten(1).sum(1)
        length = torch.ones_like(before)
        for _ in range(_HALVINGS):
            trial, _ = self._energy(u + length[:, None, None] * step)
            limit = before + _ARMIJO * length * slope + _ROUND_OFF * size
            poor = ~(trial <= limit)
            if not bool(poor.any()):
                break
            length = torch.where(poor, 0.5 * length, length)
        return u + length[:, None, None] * step

    def _preconditioner(self) -> Float[Tensor, "cases nodes 3 3"]:
        """Inverse of the nodes' own blocks of the tangent at rest, linear elasticity for all."""
        d = self._body.discretisation
        gradients, weights = d.geometry(self._points)
        one = torch.eye(3, dtype=torch.float64, device=self.device)
        ratio = self._poisson[:, None] if self._poisson.ndim else self._poisson
        first, second = lame(ratio)
        stiff = weights * self._youngs[:, None]
        outer = torch.einsum("mq,mqkI,mqkJ->mkIJ", stiff * (first + second), gradients, gradients)
        inner = torch.einsum("mq,mqkI,mqkI->mk", stiff * second, gradients, gradients)
        own = outer + inner[..., None, None] * one
        nodes = torch.from_numpy(d.nodes).to(self.device).reshape(-1)
        total = torch.zeros(d.n_nodes, 3, 3, dtype=torch.float64, device=self.device)
        total = total.index_add(0, nodes, own.flatten(0, 1))
        blocks = total + torch.diag_embed(self._springs)
        fixed = self._fixed[..., :, None] | self._fixed[..., None, :]
        return torch.linalg.inv(torch.where(fixed, one, blocks))

    def _jacobi(self, r: Float[Tensor, "cases nodes 3"]) -> Float[Tensor, "cases nodes 3"]:
        return torch.einsum("cnij,cnj->cni", self._blocks, r)
