"""A soft body: mesh, material, element type and solver, with loads and equilibria."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from tactorch.errors import ConfigError
from tactorch.fem import boundary
from tactorch.fem.assembly import Assembly
from tactorch.fem.boundary import Forces, Points, Supports, Surface
from tactorch.fem.contact import Contact
from tactorch.fem.elements import ELEMENTS, ConsistentLoads, Discretisation
from tactorch.fem.equilibrium import Equilibrium, LoadCases
from tactorch.fem.materials import Material
from tactorch.fem.newton import EquilibriumResult, Newton, NewtonOptions
from tactorch.linalg import CoarseSpaces, SharedLease, SolverOptions, SolverPool
from tactorch.mesh import TetMesh

ArrayMap = Callable[[np.ndarray], np.ndarray]


class SoftBody:
    """A mesh of one hyperelastic material with a heterogeneous Young's modulus.

    The modulus is given for each element, or at the quadrature points: a boundary that crosses
    quadratic elements is resolved better by the latter.

    Args:
        mesh: Mesh of the rest shape, mm.
        material: Energy per unit modulus.
        element: Element type: "tet4" (the paper's) or "tet10" (free of locking).
        solver: Linear solver, by name or by its settings; see `tactorch.linalg.SOLVERS`.
        newton: Settings of the equilibrium search.

    Example:
        >>> body = SoftBody(mesh, NeoHookean(0.45))
        >>> push = body.pressure("z+", 0.01)
        >>> u = body.solve(youngs, push, Supports(fixed=bottom))
    """

    def __init__(
        self,
        mesh: TetMesh,
        material: Material,
        *,
        element: str = "tet4",
        solver: str | SolverOptions = "auto",
        newton: NewtonOptions | None = None,
    ) -> None:
        self.mesh = mesh
        self.material = material
        self.newton = newton or NewtonOptions()
        self.discretisation = Discretisation(mesh, ELEMENTS[element])
        self.solver = solver
        self._leases: dict[bytes, SharedLease] = {}
        self.assembly = Assembly(self.discretisation, material, material.poisson, mesh.points)

    @cached_property
    def pool(self) -> SolverPool:
        """Analysed solvers, shared by all load cases; made at first use."""
        d = self.discretisation
        return SolverPool(d.pattern, self.solver, CoarseSpaces(d.rigid_modes, d.from_linear))

    def shared_lease(self, supports: bytes) -> SharedLease:
        """Return the factorisations that load cases of the same supports share."""
        single = not self.material.allows_inversion
        return self._leases.setdefault(supports, SharedLease(self.pool, single))

    @property
    def n_nodes(self) -> int:
        """Number of nodes: the points of the mesh, and midside nodes (tet10)."""
        return self.discretisation.n_nodes

    def pressure(
        self, surface: Surface, pressure_mpa: float | Tensor, points: Points = None
    ) -> Forces:
        """Return the nodal forces (N) of a dead pressure against the outward rest normals.

        Args:
            surface: Name of a flat side, such as "z+", or indices into `mesh.surface.triangles`.
            pressure_mpa: Force per rest area, MPa.
            points: Rest positions, mm; those of the mesh by default.
        """
        return boundary.pressure_forces(self.discretisation, surface, pressure_mpa, points)

    def traction(
        self, surface: Surface, traction_mpa: Sequence[float] | Tensor, points: Points = None
    ) -> Forces:
        """Return the nodal forces (N) of a dead traction (3,); see `pressure`."""
        triangles, vectors = boundary.area_vectors(self.discretisation, surface, points)
        traction = torch.as_tensor(traction_mpa, dtype=torch.float64)
        return boundary.to_nodes(
            self.discretisation, triangles, vectors.norm(dim=1)[:, None] * traction
        )

    def gravity(
        self,
        density: float,
        gravity: Sequence[float] | Tensor = boundary.STANDARD_GRAVITY,
        points: Points = None,
    ) -> Forces:
        """Return the nodal weights (N), eq. (4).

        The density is in tonne/mm^3 (silicone: 1.07e-9), the acceleration in mm/s^2.
        """
        d, acceleration = self.discretisation, torch.as_tensor(gravity, dtype=torch.float64)
        _, weights = d.geometry(torch.tensor(self.mesh.points) if points is None else points)
        at_vertex, at_midside = d.element.volume_rule
        fractions = [at_vertex] * 4 + [at_midside] * (d.nodes.shape[1] - 4)
        shares = torch.tensor(fractions, dtype=torch.float64)[:, None] * acceleration
        forces = density * weights.sum(1)[:, None, None] * shares
        out = torch.zeros(self.n_nodes, 3, dtype=torch.float64)
        return out.index_add(0, torch.from_numpy(d.nodes).reshape(-1), forces.reshape(-1, 3))

    def search(
        self,
        youngs: Float[np.ndarray, "m *q"],
        forces: Float[np.ndarray, "loaded 3"],
        supports: Supports,
        case: int = 0,
        assembly: Assembly | None = None,
        after: Newton | None = None,
        lease: SharedLease | None = None,
        contact: Contact | None = None,
    ) -> Newton:
        """Return the equilibrium search of one load case, for use without autograd.

        Args:
            youngs: Young's modulus of each element, or quadrature point, MPa.
            forces: Nodal forces, N.
            supports: Supports.
            case: Load case of the supports.
            assembly: The body with other parameters; see `with_parameters`.
            after: Search with a similar tangent whose factorisation is reused, so that the first
                steps need no factorisation and large meshes memory for one only. The search
                `after` then has to factor again.
            lease: Factorisations that the search shares with others of similar tangents.
            contact: Contact with a rigid probe.
        """
        self._check(youngs, forces)
        return Newton(
            self.assembly if assembly is None else assembly,
            self.pool,
            np.ascontiguousarray(youngs, dtype=np.float64),
            np.ascontiguousarray(self.discretisation.consistent_loads(forces), dtype=np.float64),
            supports.case(case, self.discretisation),
            self.newton,
            after,
            lease,
            contact,
        )

    def with_parameters(
        self, poisson: float | Float[np.ndarray, " m"], points: Float[np.ndarray, "n 3"]
    ) -> Assembly:
        """Return the body's assembly with another Poisson's ratio and rest shape (mm)."""
        body, ratio = self.assembly, np.asarray(poisson)
        if np.array_equal(ratio, body.poisson) and np.array_equal(points, body.points):
            return body
        if ratio.shape not in ((), (self.mesh.n_tets,)):
            raise ConfigError(
                f"poisson has shape {ratio.shape}; expected one, or {self.mesh.n_tets}."
            )
        if not np.all((ratio > -1.0) & (ratio < 0.5)):
            raise ConfigError("poisson must be above -1 and below 0.5 in every element.")
        if points.shape != (self.mesh.n_points, 3):
            raise ConfigError(
                f"points have shape {points.shape}; expected ({self.mesh.n_points}, 3)."
            )
        changed = replace(body, poisson=poisson, points=points)
        if not np.all(changed.weights > 0):
            raise ConfigError("points invert an element, or are not finite.")
        return changed

    def _check(self, youngs: np.ndarray, forces: np.ndarray) -> None:
        check_youngs(youngs, self.assembly.weights.shape)
        if forces.shape[-2:] not in ((self.mesh.n_points, 3), (self.n_nodes, 3)):
            raise ConfigError(
                f"forces have shape {forces.shape}; expected ({self.mesh.n_points}, 3), one row "
                "per mesh node, in N, or a batch of those."
            )
        if not np.all(np.isfinite(forces)):
            raise ConfigError("forces contain NaN or infinity; give 0 N at nodes without load.")

    def _consistent_loads(self, forces: Tensor) -> Tensor:
        """Consistent loads at all nodes, differentiable."""
        if forces.shape[0] == self.n_nodes:
            return forces
        loads = ConsistentLoads.of(self.discretisation, forces.detach().numpy())
        return _LinearMap.apply(forces, loads.apply, loads.transpose)

    def equilibrate(
        self,
        youngs: Float[np.ndarray, "m *q"],
        forces: Float[np.ndarray, "loaded 3"],
        supports: Supports,
        *,
        start: Float[np.ndarray, "nodes 3"] | None = None,
        contact: Contact | None = None,
    ) -> EquilibriumResult:
        """Find one equilibrium, without autograd; a failure is returned with its reason."""
        return self.search(youngs, forces, supports, contact=contact).run(start)

    def solve(
        self,
        youngs: Float[Tensor, "m *q"],
        forces: Float[Tensor, "*cases loaded 3"],
        supports: Supports,
        *,
        poisson: Float[Tensor, "*m"] | None = None,
        points: Float[Tensor, "n 3"] | None = None,
        start: Float[np.ndarray, "*cases nodes 3"] | None = None,
        contacts: Contact | Sequence[Contact] = (),
        probes: Float[Tensor, "*cases parameters"] | None = None,
    ) -> Float[Tensor, "*cases nodes 3"]:
        """Displacement at equilibrium (eq. 5), differentiable to second order.

        Load cases are stacked along a leading axis of `forces` and solved in parallel.

        Args:
            youngs: Young's modulus of each element, or quadrature point, MPa.
            forces: Nodal forces, N.
            supports: Supports, the same for all cases or one each.
            poisson: Poisson's ratio, if differentiated or different from the material's.
            points: Rest positions, mm, if differentiated or different from the mesh's.
            start: Initial displacements, mm.
            contacts: Contact with a rigid probe, one for each case.
            probes: Parameters of the probes (`Contact.parameters`), if differentiated or different.

        Returns:
            Displacement of every node, mm.

        Raises:
            ConfigError: A shape, type or value cannot be used.
            ConvergenceError: The load collapses the object, or nothing holds it.
        """
        if poisson is None:
            poisson = torch.as_tensor(self.assembly.poisson, dtype=torch.float64)
        touching = (contacts,) if isinstance(contacts, Contact) else tuple(contacts)
        if touching and points is not None:
            raise ConfigError("points cannot be given with contacts; leave them out.")
        points = torch.tensor(self.mesh.points) if points is None else points
        values = {"youngs": youngs, "forces": forces, "poisson": poisson, "points": points}
        if probes is not None:
            values["probes"] = probes
        for name, value in values.items():
            if value.dtype != torch.float64:
                raise ConfigError(f"{name} is {value.dtype}; mechanics needs torch.float64.")
        if forces.ndim not in (2, 3):
            raise ConfigError(f"forces have {forces.ndim} dimensions; expected (cases,) n, 3.")
        e, nu, x = (value.detach().numpy() for value in (youngs, poisson, points))
        self._check(e, forces.detach().numpy())
        assembly = self.with_parameters(nu if nu.ndim else float(nu), x)
        single = forces.ndim == 2
        cases = forces[None] if single else forces
        batch = torch.stack([self._consistent_loads(case) for case in cases])
        supports.require_cases(len(batch))
        initial = None if start is None else (start[None] if single else start)
        if initial is not None and initial.shape != batch.shape:
            raise ConfigError(
                f"start has shape {initial.shape}; expected {tuple(batch.shape)}, all nodes."
            )
        f = batch.detach().numpy()
        placed, parameters = self._placed(touching, probes, len(batch))

        def search(i: int) -> Newton:
            contact = placed[i] if placed else None
            return self.search(e, f[i], supports, i, assembly, contact=contact)

        problem = LoadCases(self.assembly, search, initial, touching)
        u = Equilibrium.apply(youngs, poisson, batch, points, parameters, problem)
        return u[0] if single else u

    def _placed(
        self, contacts: tuple[Contact, ...], probes: Tensor | None, count: int
    ) -> tuple[tuple[Contact, ...], Tensor]:
        """Return the contacts with the given parameters of their probes, and these, one a case."""
        if len(contacts) not in (0, count):
            raise ConfigError(f"there are {len(contacts)} contacts for {count} load cases.")
        if probes is None:
            own = [torch.from_numpy(contact.parameters) for contact in contacts]
            return contacts, torch.stack(own) if own else torch.zeros(count, 0, dtype=torch.float64)
        rows = probes[None] if probes.ndim == 1 else probes
        expected = [len(contact.parameters) for contact in contacts]
        if [len(row) for row in rows] != expected:
            raise ConfigError(
                f"probes have shape {tuple(probes.shape)}; expected one row for each contact, of "
                f"{expected} parameters."
            )
        pairs = zip(contacts, rows.detach().numpy(), strict=True)
        return tuple(contact.with_parameters(row) for contact, row in pairs), rows


class _LinearMap(torch.autograd.Function):
    """A linear map of arrays, with its transpose."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, apply: ArrayMap, transpose: ArrayMap) -> Tensor:
        ctx.maps = apply, transpose
        return torch.from_numpy(apply(x.detach().numpy()))

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> Any:
        apply, transpose = ctx.maps
        return _LinearMap.apply(grad, transpose, apply), None, None

    @staticmethod
    def jvp(ctx: Any, change: Tensor, *_: Any) -> Tensor:
        return _LinearMap.apply(change, *ctx.maps)


def check_youngs(youngs: np.ndarray, shape: tuple[int, ...]) -> None:
    """Raise ConfigError unless there is a finite, positive modulus for each element or point.

    Args:
        youngs: Young's modulus of each element, or quadrature point, MPa.
        shape: Number of elements and of quadrature points of an element.
    """
    n_tets = shape[0]
    if youngs.shape not in ((n_tets,), shape):
        raise ConfigError(
            f"youngs has shape {youngs.shape}; the mesh has {n_tets} elements, so ({n_tets},) "
            f"is expected, or {shape} for a modulus at each quadrature point."
        )
    bad = ~(np.isfinite(youngs) & (youngs > 0))
    if bad.any():
        first = np.argwhere(bad)[0].tolist()
        raise ConfigError(
            f"youngs{first} = {youngs[*first]} MPa ({bad.sum()} such elements); Young's modulus "
            "must be finite and positive. Use the lower bound 0.001 MPa for a hole."
        )
