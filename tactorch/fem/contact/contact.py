"""Contact of the surface of a body with a rigid probe, without friction.

Points of the surface that are within the probe are pushed out along its normal by a pressure of the
stiffness times the distance (penalty method: P. Wriggers, Computational Contact Mechanics, 2nd ed.,
2006, sec. 5.3). The pressure derives from an energy, so that the equilibrium and its derivatives
are those of a body without contact whose tangent has a further part. The penetration is that of
the pressure over the stiffness.
"""

from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp
import torch
from jaxtyping import Float, Int
from torch import Tensor

from tactorch.errors import ConfigError
from tactorch.fem.assembly import positive_part
from tactorch.fem.contact.probes import Probe
from tactorch.fem.elements import Discretisation

#: Stiffness of the contact over that of the surface elements, E / h. The penetration is about a
#: hundredth of the depth to which a flat punch of the size of an element would be pressed.
RELATIVE_STIFFNESS = 200.0
_MIN_COSINE = 0.3  # between the approach and the normals at points within the probe
#: Six points and weights of the triangle, exact to degree four (Strang and Fix, 1973).
_A, _B = 0.445948490915965, 0.091576213509771
TRIANGLE_POINTS = np.array([
    [1 - 2 * c if i == k else c for i in range(3)] for c in (_A, _B) for k in range(3)
])  # fmt: skip
TRIANGLE_WEIGHTS = np.repeat([0.223381589678011, 0.109951743655322], 3)


@dataclass(frozen=True, eq=False)
class ContactResponse:
    """A contact at one displacement field.

    Attributes:
        energy: Energy of the contact, N mm.
        forces: Nodal forces that the body exerts against it, N: the derivative of the energy.
        rows: Triangles with points in contact.
        blocks: Second derivative of the energy by the displacements of their nodes, N/mm.
        force_n: Force on the probe, in the axes of the mesh, N.
    """

    energy: float
    forces: Float[np.ndarray, "nodes 3"]
    rows: Int[np.ndarray, " active"]
    blocks: Float[np.ndarray, "active k3 k3"]
    force_n: Float[np.ndarray, "3"]


@dataclass(frozen=True, eq=False)
class Contact:
    """A probe at a pose, and the part of the surface that it may touch.

    Attributes:
        discretisation: The body.
        probe: The probe.
        position_mm: Position of the probe, mm.
        rotation: Rotation from the probe's axes to those of the mesh.
        approach_mm: Motion of the probe from where it does not touch yet, mm. Where the full press
            fails, it is applied in steps along this motion.
        stiffness: Pressure per penetration, MPa/mm.
        surface: Indices of the triangles that may be touched, into `mesh.surface.triangles`.
    """

    discretisation: Discretisation
    probe: Probe
    position_mm: Float[np.ndarray, "3"]
    rotation: Float[np.ndarray, "3 3"]
    approach_mm: Float[np.ndarray, "3"]
    stiffness: float
    surface: Int[np.ndarray, " triangles"]

    @staticmethod
    def of(
        discretisation: Discretisation,
        probe: Probe,
        position_mm: Float[np.ndarray, "3"],
        youngs: float | Float[np.ndarray, "m *q"],
        *,
        rotation: Float[np.ndarray, "3 3"] | None = None,
        relative_stiffness: float = RELATIVE_STIFFNESS,
    ) -> "Contact":
        """Return the contact with a probe at a pose.

        The probe approaches along its -z axis, from where it does not touch the body at rest.

        Args:
            discretisation: The body.
            probe: The probe.
            position_mm: Its position, mm; see the probe.
            youngs: Young's modulus of the body, MPa, for the stiffness: a mean suffices.
            rotation: Rotation from the probe's axes to those of the mesh; none by default.
            relative_stiffness: Stiffness over that of the surface elements, E / h.

        Raises:
            ConfigError: the pose is not finite or no rotation, or the probe does not touch
                the body.
        """
        position = np.asarray(position_mm, dtype=np.float64)
        turn = np.eye(3) if rotation is None else np.asarray(rotation, dtype=np.float64)
        if not np.isfinite(position).all() or not np.isfinite(turn).all():
            raise ConfigError("The pose of the probe is not finite; give a position in mm.")
        if not np.allclose(turn @ turn.T, np.eye(3), atol=1e-6) or np.linalg.det(turn) < 0.0:
            raise ConfigError("rotation is not a rotation; give an orthonormal matrix.")
        mesh = discretisation.mesh
        areas, modulus = mesh.surface.areas, float(np.mean(youngs))
        stiffness = relative_stiffness * modulus / float(np.sqrt(np.median(areas)))
        every = np.arange(len(areas))
        contact = Contact(discretisation, probe, position, turn, np.zeros(3), stiffness, every)
        return contact._approached()

    def _approached(self) -> "Contact":
        """Return the contact with its approach and the triangles that may be touched."""
        rest, towards = np.zeros((self.discretisation.n_nodes, 3)), -self.rotation[:, 2]
        depth = -float(self._distances(rest).min())
        if depth <= 0.0:
            raise ConfigError(
                f"The probe at {np.round(self.position_mm, 3).tolist()} mm does not touch the "
                f"body: it is {-depth:.3g} mm away. Check the position (mm) and the axes."
            )
        size, step = self.discretisation.mesh.diagonal, depth
        while step < 2.0 * size:
            back = replace(self, position_mm=self.position_mm - step * towards)
            if back._distances(rest).min() >= 0.0:
                break
            step *= 1.5
        # The surface may move towards the probe by a fraction of the depth.
        near = np.flatnonzero(self._distances(rest).min(axis=1) < 2.0 * depth)
        return replace(self, approach_mm=step * towards, surface=near)

    @cached_property
    def nodes(self) -> Int[np.ndarray, "triangles k"]:
        """Nodes of each triangle: vertices, then midsides of its edges."""
        triangles = self.discretisation.mesh.surface.triangles[self.surface]
        return self.discretisation.surface_nodes(triangles)

    @cached_property
    def shape(self) -> Float[np.ndarray, "points k"]:
        """Values of the shape functions at the points of a triangle."""
        return self.discretisation.surface_values(TRIANGLE_POINTS)

    @cached_property
    def weights(self) -> Float[np.ndarray, "triangles points"]:
        """Rest area of each point, mm^2."""
        return self.discretisation.mesh.surface.areas[self.surface][:, None] * TRIANGLE_WEIGHTS

    @cached_property
    def _rest(self) -> Float[np.ndarray, "triangles k 3"]:
        return self.discretisation.positions[self.nodes]

    @cached_property
    def _local(self) -> Int[np.ndarray, "triangles k"]:
        """Place of each triangle's nodes among those of its element."""
        owners = self.discretisation.mesh.surface.owners[self.surface]
        elements = self.discretisation.nodes[owners]
        return np.asarray((elements[:, None, :] == self.nodes[:, :, None]).argmax(axis=2))

    def with_parameters(self, parameters: Float[np.ndarray, " parameters"]) -> "Contact":
        """Return the contact with other `parameters`."""
        turn = _turn(torch.from_numpy(parameters[3:6])).numpy()
        sizes = zip(fields(self.probe), parameters[6:].tolist(), strict=True)  # type: ignore[arg-type]
        probe = replace(self.probe, **{field.name: size for field, size in sizes})  # type: ignore[type-var]
        position = np.array(parameters[:3])
        return replace(self, probe=probe, position_mm=position, rotation=turn @ self.rotation)

    @property
    def parameters(self) -> Float[np.ndarray, " parameters"]:
        """Position (mm), turn about the axes of the mesh (zero, rad), and sizes (mm)."""
        return np.concatenate([self.position_mm, np.zeros(3), self.probe.sizes])

    def moved(self, load: float) -> "Contact":
        """Return the contact at a fraction of the approach."""
        if load == 1.0:
            return self
        return replace(self, position_mm=self.position_mm - (1.0 - load) * self.approach_mm)

    def distances(
        self, points: Float[Tensor, "k 3"], parameters: Float[Tensor, " parameters"]
    ) -> Float[Tensor, " k"]:
        """Return signed distances of points (mm) from the probe, differentiable by `parameters`."""
        turn = _turn(parameters[3:6]) @ torch.from_numpy(self.rotation)
        return self.probe.distance((points - parameters[:3]) @ turn, parameters[6:])

    def reaction(
        self, u: Float[Tensor, "nodes 3"], parameters: Float[Tensor, " parameters"]
    ) -> Float[Tensor, " parameters"]:
        """Return force (N) and moment about the position (N mm) on the probe, differentiable.

        The remaining values are the derivatives of the energy by the sizes, with a minus.
        """
        found: Tensor = -torch.func.grad(self._energy, argnums=1)(u, parameters)
        return found

    def _positions(
        self, u: Float[np.ndarray, "nodes 3"]
    ) -> Float[np.ndarray, "triangles points 3"]:
        return np.asarray(self.shape @ (self._rest + u[self.nodes]))

    def _distances(self, u: Float[np.ndarray, "nodes 3"]) -> Float[np.ndarray, "triangles points"]:
        points = self._positions(u)
        parameters = torch.from_numpy(self.parameters)
        found = self.distances(torch.from_numpy(points.reshape(-1, 3)), parameters)
        return found.numpy().reshape(points.shape[:2])

    def pushes_ahead(self, u: Float[np.ndarray, "nodes 3"]) -> bool:
        """Whether all points within the probe leave it the way that it approaches.

        Those deep within would be pushed out at its side or behind it.
        """
        positions, inside = self._positions(u), self._distances(u) < 0.0
        if not inside.any():
            return True
        normals, _ = self._derivatives(positions[inside])
        ahead = self.approach_mm / np.linalg.norm(self.approach_mm)
        return bool((normals @ ahead).min() > _MIN_COSINE)

    def energy(self, u: Float[np.ndarray, "nodes 3"]) -> float:
        """Return the energy at displacements (mm), N mm."""
        inside = np.minimum(self._distances(u), 0.0)
        return 0.5 * self.stiffness * float((self.weights * inside**2).sum())

    def at(self, u: Float[np.ndarray, "nodes 3"]) -> ContactResponse:
        """Return energy, forces and tangent at displacements (mm)."""
        positions, distances = self._positions(u), self._distances(u)
        rows = np.flatnonzero((distances < 0.0).any(axis=1))
        inside = np.minimum(distances[rows], 0.0)
        weights = self.stiffness * self.weights[rows]
        energy = 0.5 * float((weights * inside**2).sum())
        normals, curvatures = self._derivatives(positions[rows].reshape(-1, 3))
        shape = (*inside.shape, 3)
        pressures = (weights * inside)[..., None] * normals.reshape(shape)
        forces = np.zeros_like(u)
        np.add.at(forces, self.nodes[rows], np.einsum("qk,tqi->tki", self.shape, pressures))
        touching = np.where(inside < 0.0, weights, 0.0)[..., None, None]
        outer = normals[:, :, None] * normals[:, None, :]
        stiff = touching * outer.reshape(*shape, 3)
        stiff += (weights * inside)[..., None, None] * curvatures.reshape(*shape, 3)
        blocks = np.einsum("qk,ql,tqij->tkilj", self.shape, self.shape, stiff)
        size = 3 * self.nodes.shape[1]
        total = pressures.sum(axis=(0, 1))
        return ContactResponse(energy, forces, rows, blocks.reshape(-1, size, size), total)

    def _derivatives(
        self, points: Float[np.ndarray, "k 3"]
    ) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, "k 3 3"]]:
        """Return the normals of the probe at points, and the second derivatives of the distance."""
        x = torch.tensor(points, requires_grad=True)
        with torch.enable_grad():
            distances = self.distances(x, torch.from_numpy(self.parameters))
            (normals,) = torch.autograd.grad(distances.sum(), x, create_graph=True)
            columns = [
                torch.autograd.grad(normals[:, i].sum(), x, retain_graph=True)[0] for i in range(3)
            ]
        return normals.detach().numpy(), torch.stack(columns, dim=1).numpy()

    def add_tangent(
        self, values: Float[np.ndarray, " nnz"], response: ContactResponse, *, project: bool = False
    ) -> None:
        """Add the tangent of the contact to that of the body, in place.

        Args:
            values: Values of the pattern of the discretisation, N/mm.
            response: The contact.
            project: Whether negative eigenvalues are set to zero.
        """
        if not len(response.rows):
            return
        d, blocks = self.discretisation, response.blocks
        if project:
            blocks = positive_part(blocks)
        local = (3 * self._local[response.rows][:, :, None] + np.arange(3)).reshape(len(blocks), -1)
        size = d.unknowns.shape[1]
        whole = np.zeros((len(blocks), size, size))
        whole[np.arange(len(blocks))[:, None, None], local[:, :, None], local[:, None, :]] = blocks
        rows, cols = d.entry_rows_cols
        owners = d.mesh.surface.owners[self.surface[response.rows]]
        np.add.at(values, d.slots[owners].ravel(), whole[:, rows, cols].ravel())

    def tangent(self, response: ContactResponse) -> sp.csr_matrix:
        """Return the second derivative of the energy by all displacements, N/mm."""
        count = 3 * self.discretisation.n_nodes
        unknowns = 3 * self.nodes[response.rows][:, :, None] + np.arange(3)
        unknowns = unknowns.reshape(len(response.rows), -1)
        rows, cols = np.broadcast_arrays(unknowns[:, :, None], unknowns[:, None, :])
        entries = (response.blocks.ravel(), (rows.ravel(), cols.ravel()))
        return sp.csr_matrix(entries, shape=(count, count))

    def work(
        self,
        u: Float[Tensor, "nodes 3"],
        v: Float[Tensor, "nodes 3"],
        parameters: Float[Tensor, " parameters"],
    ) -> Float[Tensor, ""]:
        """Return the virtual work of the contact on `v`, N mm; differentiable to any order."""
        return (torch.func.grad(self._energy)(u, parameters) * v).sum()

    def _energy(
        self, u: Float[Tensor, "nodes 3"], parameters: Float[Tensor, " parameters"]
    ) -> Float[Tensor, ""]:
        moved = torch.from_numpy(self._rest) + u[torch.from_numpy(self.nodes)]
        positions = torch.from_numpy(self.shape) @ moved
        distances = self.distances(positions.reshape(-1, 3), parameters)
        weights = self.stiffness * torch.from_numpy(self.weights).reshape(-1)
        return 0.5 * (weights * distances.clamp(max=0.0) ** 2).sum()


def _turn(vector: Float[Tensor, "3"]) -> Float[Tensor, "3 3"]:
    """Return the rotation by a small vector, rad: the exponential of its cross product."""
    x, y, z = vector
    zero = torch.zeros_like(x)
    cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero]).reshape(3, 3)
    return torch.linalg.matrix_exp(cross)
