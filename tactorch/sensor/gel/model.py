"""Contact forces on a gel from how its outer face moved (Section III-B, last paragraph).

The gel's own elasticity is known, so at equilibrium the forces on its face are those that its
deformation takes. Where displacements are noisy that amplifies the noise: forces are then those
that are smooth and explain the displacements no better than their noise allows.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import cho_factor, cho_solve

from tactorch.errors import ConfigError
from tactorch.fem import SoftBody, Supports, make_material
from tactorch.mesh.values import Real
from tactorch.sensor.description import GelLayer
from tactorch.sensor.gel.mesh import GelMesh, gel_mesh

_ROUNDS = 6  # of linearising anew
_SETTLED = 1e-3  # relative change of the forces


@dataclass(frozen=True, eq=False)
class Contact:
    """Forces on the outer face of a gel, in the sensor's frame.

    Attributes:
        points: Rest positions of the face's nodes, (k, 3), mm.
        displacement: How they moved, (k, 3), mm; the smoothed ones where noise was in mind.
        forces: On the gel at each node, (k, 3), N; what the gel does to the object is the opposite.
    """

    points: Float[np.ndarray, "k 3"]
    displacement: Float[np.ndarray, "k 3"]
    forces: Float[np.ndarray, "k 3"]

    @property
    def total(self) -> Float[np.ndarray, "3"]:
        """Sum of the forces, N."""
        return self.forces.sum(axis=0)


class GelModel:
    """A gel that can be asked for the forces behind a deformation.

    Args:
        gel: The soft layer.
        edge_mm: Of a cell on the outer face.
        layers: Of cells through the thickness.
        element: "tet10", which does not lock where the gel keeps its volume, or "tet4".

    Raises:
        ConfigError: A value cannot be used.
    """

    def __init__(
        self, gel: GelLayer, edge_mm: Real = 1.0, layers: int = 4, element: str = "tet10"
    ) -> None:
        self.gel = gel
        self.meshed: GelMesh = gel_mesh(gel, edge_mm, layers)
        law = make_material(gel.spec.name, gel.spec.poisson, **gel.spec.parameters)
        self.body = SoftBody(self.meshed.mesh, law, element=element)

    @property
    def points(self) -> Float[np.ndarray, "k 3"]:
        """Rest positions of the outer face's nodes, mm."""
        return self.meshed.face_points

    @property
    def youngs(self) -> Float[np.ndarray, " m"]:
        """Young's modulus of each element, MPa."""
        return np.full(self.meshed.mesh.n_tets, float(self.gel.youngs_mpa))

    def forces(self, displacement: Float[np.ndarray, "k 3"]) -> Contact:
        """Return the forces that hold the outer face displaced exactly so.

        Args:
            displacement: Of the face's nodes, mm; NaN where it is free.

        Raises:
            ConfigError: The shape is wrong, or nothing is known.
            ConvergenceError: The gel collapses.
        """
        known = self._known(displacement)
        supports = self._held(np.nan_to_num(displacement), known)
        nothing = np.zeros(self.meshed.mesh.points.shape)
        found = self.body.equilibrate(self.youngs, nothing, supports).require()
        assert found.response is not None
        inner = self.body.assembly.internal_force(found.response, self.youngs)
        return Contact(
            self.points, found.displacement[self.meshed.face], self._at_face(inner, known)
        )

    def smooth_forces(
        self,
        displacement: Float[np.ndarray, "k 3"],
        noise_mm: Real,
        touched: Bool[np.ndarray, " k"] | None = None,
        *,
        tilted: bool = False,
    ) -> Contact:
        """Return the smoothest forces that explain the displacements to within their noise.

        Args:
            displacement: Of the face's nodes, mm; NaN where it was not seen.
            noise_mm: Standard deviation of the displacements, mm.
            touched: Nodes that may bear a force; None for all.
            tilted: Whether displacements along z are known but for a constant and a tilt, as
                depth from slopes is. What the gel does around the contact then tells them.

        Raises:
            ConfigError: The shape is wrong, or nothing is known.
            ConvergenceError: The gel collapses.
        """
        seen = self._known(displacement)
        may = np.ones(len(self.points), dtype=bool) if touched is None else touched
        rough = self._roughness(may)
        plane = self._plane() if tilted else np.zeros((3 * len(self.points), 0))
        forces = np.zeros((len(self.points), 3))
        for _ in range(_ROUNDS):
            moved, compliance = self._moved(forces, may)
            wanted = (np.nan_to_num(displacement) - moved)[seen] + compliance[seen.ravel()] @ (
                forces[may].ravel()
            )
            known = compliance[seen.ravel()], plane[seen.ravel()]
            new = _least_rough(*known, wanted, rough, float(noise_mm))
            change = float(np.linalg.norm(new - forces[may].ravel()))
            size = float(np.linalg.norm(new))
            forces[may] = new.reshape(-1, 3)
            if change <= _SETTLED * size:
                break
        moved, _ = self._moved(forces, may)
        return Contact(self.points, moved, forces)

    def _moved(
        self, forces: Float[np.ndarray, "k 3"], may: Bool[np.ndarray, " k"]
    ) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, "k3 f"]]:
        """How the face moves under forces on it, and by how much more under unit forces."""
        mesh, face = self.meshed.mesh, self.meshed.face
        loads = np.zeros(mesh.points.shape)
        loads[face] = forces
        supports = self._held(np.zeros(forces.shape), np.zeros(forces.shape, dtype=bool))
        search = self.body.search(self.youngs, loads, supports)
        found = search.run().require()
        tangent = search.linearize(found)
        columns = []
        for node in face[may]:
            for axis in range(3):
                unit = np.zeros(mesh.points.shape)
                unit[node, axis] = 1.0
                columns.append(self.body.discretisation.spread(unit).ravel())
        solved = tangent.solve(np.stack(columns, axis=1))
        at_face = solved.reshape(self.body.n_nodes, 3, -1)[face].reshape(3 * len(face), -1)
        return found.displacement[face], at_face

    def _plane(self) -> Float[np.ndarray, "k3 3"]:
        """Displacements along z of a constant and of two tilts, over the face."""
        found = np.zeros((len(self.points), 3, 3))
        found[:, 2, 0] = 1.0
        found[:, 2, 1:] = self.points[:, :2] / np.abs(self.points[:, :2]).max(axis=0)
        return found.reshape(-1, 3)

    def _roughness(self, may: Bool[np.ndarray, " k"]) -> Float[np.ndarray, "f f"]:
        """Squared differences of forces between neighbours, and their squares beyond the edge."""
        from scipy.spatial import cKDTree

        points = self.points
        count = min(7, len(points))
        _, near = cKDTree(points).query(points, k=count)
        own = np.full(len(points), -1)
        own[may] = np.arange(int(may.sum()))
        rows = np.zeros((int(may.sum()), int(may.sum())))
        for i in np.flatnonzero(may):
            for j in near[i, 1:]:
                rows[own[i], own[i]] += 1.0
                if own[j] >= 0:
                    rows[own[i], own[j]] -= 1.0
        return np.kron(rows.T @ rows + 1e-6 * np.eye(len(rows)), np.eye(3))

    def _held(
        self, displacement: Float[np.ndarray, "k 3"], known: Bool[np.ndarray, "k 3"]
    ) -> Supports:
        shape = self.meshed.mesh.points.shape
        fixed, prescribed = np.zeros(shape, dtype=bool), np.zeros(shape)
        fixed[self.meshed.window] = True
        fixed[self.meshed.face] |= known
        prescribed[self.meshed.face] = np.where(known, displacement, 0.0)
        prescribed[self.meshed.window] = 0.0
        return Supports(fixed=fixed, prescribed=prescribed)

    def _at_face(
        self, inner: Float[np.ndarray, "nodes 3"], known: Bool[np.ndarray, "k 3"]
    ) -> Float[np.ndarray, "k 3"]:
        """Forces on the face's nodes; those of midsides go to their two ends in equal parts."""
        n = self.meshed.mesh.n_points
        at = inner[:n].copy()
        if len(inner) > n:
            edges = self.body.discretisation.edges
            on_face = np.zeros(n, dtype=bool)
            on_face[self.meshed.face] = True
            both = on_face[edges].all(axis=1)
            for end in (0, 1):
                np.add.at(at, edges[both, end], 0.5 * inner[n:][both])
        return np.where(known, at[self.meshed.face], 0.0)

    def _known(self, displacement: Float[np.ndarray, "k 3"]) -> Bool[np.ndarray, "k 3"]:
        if displacement.shape != self.points.shape:
            raise ConfigError(
                f"displacement has shape {displacement.shape}; expected {self.points.shape}, one"
                " row for each node of the gel's outer face."
            )
        known = np.asarray(np.isfinite(displacement))
        if not known.any():
            raise ConfigError("no displacement of the gel is known.")
        return known


def _least_rough(
    compliance: Float[np.ndarray, "d f"],
    plane: Float[np.ndarray, "d p"],
    wanted: Float[np.ndarray, " d"],
    rough: Float[np.ndarray, "f f"],
    noise_mm: float,
) -> Float[np.ndarray, " f"]:
    """Minimise roughness, with a misfit as large as the noise (Morozov's discrepancy principle).

    What a plane explains of the displacements is taken off first, of both sides alike.
    """
    if plane.shape[1]:
        basis, _ = np.linalg.qr(plane)
        compliance = compliance - basis @ (basis.T @ compliance)
        wanted = wanted - basis @ (basis.T @ wanted)
    normal, right = compliance.T @ compliance, compliance.T @ wanted
    scale = np.trace(normal) / np.trace(rough)
    target = len(wanted) * noise_mm**2
    best = None
    for weight in scale * 10.0 ** np.arange(2.0, -8.1, -0.5):
        found = cho_solve(cho_factor(normal + weight * rough), right)
        misfit = float(((compliance @ found - wanted) ** 2).sum())
        best = found
        if misfit <= target:
            break
    assert best is not None
    return best
