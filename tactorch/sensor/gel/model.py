"""Contact forces on a gel from the displacement of its outer face (Section III-B, last paragraph).

The gel's elasticity is known, so at equilibrium its deformation determines the forces on its face.
This amplifies noise of the displacements. `GelModel.smooth_forces` therefore finds the smooth
forces that explain the displacements, see `tactorch.sensor.gel.tractions`.
"""

from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float, Int

from tactorch.config import Options, option
from tactorch.errors import ConfigError
from tactorch.fem.equilibrium import SolvedCase
from tactorch.mesh import TetMesh, box_mesh, refine
from tactorch.mesh.geometry import vertex_areas
from tactorch.mesh.refine import Sizing
from tactorch.mesh.values import Real, positive
from tactorch.sensor.description import GelLayer
from tactorch.sensor.gel.body import GelBody, NodeVectors, rms
from tactorch.sensor.gel.tractions import SmoothFit, traction_basis

_MAX_CELLS = 200_000
_MAX_LINEARIZATIONS = 8
_FORCE_RTOL = 1e-3  # change of the forces at convergence
_NOISE_FRACTION = 0.1  # acceptable linearization error, relative to the noise
# The gel is linearized again if the linearization error exceeds this fraction of the displacement,
# or of the error in the previous iteration.
_DISPLACEMENT_FRACTION, _ERROR_DECREASE = 0.05, 0.3

FaceVectors = Float[np.ndarray, "k 3"]
FaceMask = Bool[np.ndarray, " k"]


@dataclass(frozen=True)
class GelOptions(Options):
    """Discretization of the gel."""

    edge_mm: float = option(1.0, "Edge length of the gel's cells on its face", unit="mm", gt=0)
    layers: int = option(4, "Number of cells through the gel", ge=1)
    element: Literal["tet10", "tet4"] = option(
        "tet10", "Element; tet10: free of locking; tet4: faster to prepare, but locks (too stiff)"
    )


class GelMesh:
    """Regular tetrahedra that become thinner toward the outer face near z = 0.

    `edge_mm` is the edge length of a cell on this face, `layers` the number of cells through the
    thickness. The nodes `window` at z = -thickness are bonded to the rigid window. `center` is the
    edge length of a cell at the center of the face over the mean one.
    """

    def __init__(self, gel: GelLayer, edge_mm: Real, layers: int, center: float = 1.0) -> None:
        self.layer = gel
        edge, half = positive("edge_mm", edge_mm), np.array(gel.half_size_mm)
        counts = np.maximum(np.round(2 * half / edge).astype(int), 1)
        if counts.min() < 4 or layers < 1:
            raise ConfigError(
                f"edge_mm={edge:g}, layers={layers}: a gel of {2 * half[0]:g} x {2 * half[1]:g} mm"
                " needs at least 4 cells across and 1 layer."
            )
        if counts.prod() * layers > _MAX_CELLS:
            raise ConfigError(
                f"edge_mm={edge:g} makes {counts.prod() * layers} cells; give a larger."
            )
        cube = box_mesh((2.0, 2.0, 1.0), (*counts.tolist(), layers), origin_mm=(-1.0, -1.0, -1.0))
        square = cube.points[:, :2]
        flat = square * half if gel.size_mm is not None else _square_to_disc(square) * half
        outward = (flat / half) ** 2
        if gel.size_mm is None:
            outward = outward.sum(axis=1, keepdims=True)
        flat = flat * (center + (1.0 - center) * outward)
        depth = -cube.points[:, 2]  # 0 at the outer face, 1 at the window
        graded = depth * (0.5 + 0.5 * depth)  # the outermost cells are about half as thick
        face_height = gel.height_mm(flat)
        height = face_height - graded * (gel.thickness_mm + face_height)
        mesh = TetMesh.create(np.column_stack([flat, height]), cube.tets)
        self._set(mesh, depth < 1e-9, depth > 1 - 1e-9)

    def refined(self, sizing: Sizing) -> "GelMesh":
        """Return the mesh bisected down to the longest edges (mm) that are given at points (mm)."""
        refinement, other = refine(self.mesh, sizing), copy(self)
        masks = self.on_face, self.on_window
        moved = (refinement.interpolate(mask.astype(float)) > 1.0 - 1e-9 for mask in masks)
        other._set(refinement.mesh, *moved)
        return other

    def _set(
        self, mesh: TetMesh, on_face: Bool[np.ndarray, " n"], on_window: Bool[np.ndarray, " n"]
    ) -> None:
        self.mesh, self.on_face, self.on_window = mesh, on_face, on_window
        self.face, self.window = np.flatnonzero(self.on_face), np.flatnonzero(self.on_window)
        self.face_points = self.mesh.points[self.face]  # at rest
        self.face_triangles = face_triangles(self.mesh, self.on_face)
        self.face_areas = vertex_areas(self.face_points, self.face_triangles)  # mm^2

    def edges(self, selected: Bool[np.ndarray, " k"]) -> Int[np.ndarray, "e 2"]:
        """Return pairs of neighbors among selected nodes of the face, as indices among these."""
        index = np.where(selected, np.cumsum(selected) - 1, -1)
        pairs = index[self.face_triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)]
        return np.unique(np.sort(pairs[(pairs >= 0).all(axis=1)], axis=1), axis=0)


def face_triangles(mesh: TetMesh, on_face: Bool[np.ndarray, " n"]) -> Int[np.ndarray, "t 3"]:
    """Return the triangles of the outer face, as indices among its nodes."""
    triangles = mesh.surface.triangles
    return (np.cumsum(on_face) - 1)[triangles[on_face[triangles].all(axis=1)]]


def _square_to_disc(square: Float[np.ndarray, "n 2"]) -> np.ndarray:
    """Map the square from -1 to 1 to a disc; cells near the center stay nearly square."""
    largest = np.abs(square).max(axis=1, keepdims=True)
    length = np.linalg.norm(square, axis=1, keepdims=True)
    ratio = np.divide(largest, length, out=np.ones_like(largest), where=length > 0)
    return square * (1 + largest * (ratio - 1))


@dataclass(frozen=True, eq=False)
class GelErrors:
    """Errors that forces and displacements of a gel's face have in common.

    They are independent patterns of unit standard deviation, in the sensor frame.

    Attributes:
        forces: Errors of the forces on the gel at each node, (q, k, 3), N.
        displacement: Errors of the displacements of the nodes, (q, k, 3), mm.
    """

    forces: Float[np.ndarray, "q k 3"]
    displacement: Float[np.ndarray, "q k 3"]

    def joined(self, others: "GelErrors") -> "GelErrors":
        """Return these errors and independent other ones."""
        return GelErrors(
            np.concatenate([self.forces, others.forces]),
            np.concatenate([self.displacement, others.displacement]),
        )

    @property
    def covariance(self) -> Float[np.ndarray, "3 3"]:
        """Covariance of the total force, N^2."""
        totals = self.forces.sum(axis=1)
        return totals.T @ totals


@dataclass(frozen=True, eq=False)
class GelContact:
    """Forces on the outer face of a gel, in the sensor frame.

    Attributes:
        points: Rest positions of the nodes of the face, (k, 3), mm.
        displacement: Displacements of the nodes, (k, 3), mm; smoothed if noise was given. NaN along
            x and y where only depth was measured.
        forces: Forces on the gel at each node, (k, 3), N; the object experiences the opposite.
            NaN along x and y in a contact of which only depth was measured.
        covariance: Covariance of the total force due to the noise of the displacements, (3, 3),
            N^2; None if no noise was given.
        in_contact: Nodes in contact, (k,); None for those that the force was computed with.
        errors: Errors of `forces` and `displacement`; None where they are not determined.
        triangles: Triangles of the face, (t, 3), where the forces stand for a traction that is
            linear on those in contact; None for forces that act at the nodes.
    """

    points: Float[np.ndarray, "k 3"]
    displacement: Float[np.ndarray, "k 3"]
    forces: Float[np.ndarray, "k 3"]
    covariance: Float[np.ndarray, "3 3"] | None = None
    in_contact: Bool[np.ndarray, " k"] | None = None
    errors: GelErrors | None = None
    triangles: Int[np.ndarray, "t 3"] | None = None

    @property
    def normal_only(self) -> bool:
        """Whether only displacements along z are known, so that tangential components are NaN."""
        return not bool(np.isfinite(self.displacement[:, :2]).any())

    def with_zeros(self) -> "GelContact":
        """Return the contact with zeros in place of unknown components."""
        moved, forces = np.nan_to_num(self.displacement), np.nan_to_num(self.forces)
        return replace(self, displacement=moved, forces=forces)

    @property
    def total(self) -> Float[np.ndarray, "3"]:
        """Sum of the forces, N."""
        return self.forces.sum(axis=0)


class GelModel(GelBody):
    """Finite element model of a gel that computes the forces behind a deformation.

    Attributes:
        points: Rest positions of the nodes of the outer face, (k, 3), mm.
        gel_mesh: Mesh and its outer face.
    """

    def __init__(self, gel: GelLayer, options: GelOptions | None = None) -> None:
        self.gel, options = gel, options or GelOptions()
        self.gel_mesh = GelMesh(gel, options.edge_mm, options.layers)
        self.points = self.gel_mesh.face_points
        super().__init__(self.gel_mesh.mesh, gel, options.element)
        self._rest_columns: dict[int, np.ndarray] = {}  # compliance at rest by node, mm/N

    def forces(self, displacement: FaceVectors, noise_mm: Real | None = None) -> GelContact:
        """Return the forces for exactly prescribed displacements of the outer face.

        Args:
            displacement: Displacements of the nodes of the face, mm; NaN where the face is free.
            noise_mm: Standard deviation of the displacements, mm, for the covariance of the total.

        Raises:
            ConvergenceError: Newton's method does not converge.
        """
        known = self.known(displacement)
        state = self._equilibrium(np.zeros(displacement.shape), displacement)
        reactions = self._gather(self.internal_forces(state))
        covariance = None
        if noise_mm is not None:
            sensitivity = self._total_force_sensitivity(state, known)
            covariance = float(noise_mm) ** 2 * sensitivity @ sensitivity.T
        moved = state.result.displacement[self.gel_mesh.face]
        return GelContact(self.points, moved, np.where(known, reactions, 0.0), covariance)

    def smooth_forces(
        self,
        displacement: FaceVectors,
        noise_mm: Real,
        contact: FaceMask | None = None,
        *,
        free_plane: bool = False,
    ) -> GelContact:
        """Return the most likely smooth forces for noisy displacements of the outer face.

        Args:
            displacement: Displacements of the nodes of the face, mm; NaN where unknown.
            noise_mm: Lower bound of the standard deviation of the displacements, mm; a larger one
                is estimated from the displacements.
            contact: Nodes that may carry a force; None for all. For a nearly incompressible gel,
                knowing them makes the total force far more accurate.
            free_plane: Whether displacements along z are known up to a constant and a tilt, as
                depth from slopes is. Both are then determined by the gel around the contact.

        Raises:
            ConvergenceError: Newton's method does not converge.
        """
        known, face = self.known(displacement), self.gel_mesh.face
        loaded = np.ones(len(self.points), dtype=bool) if contact is None else contact
        if not loaded.any():
            raise ConfigError("contact is false at every node; without contact there is no force.")
        basis = traction_basis(self.gel_mesh.edges(loaded), self.gel_mesh.face_areas[loaded])
        rows = known.ravel()
        plane = self.plane_modes()[rows] if free_plane else np.zeros((int(known.sum()), 0))
        forces, state = np.zeros((len(self.points), 3)), self.rest
        linearized, compliance, last_error = state, self.rest_compliance(loaded), np.inf
        for _ in range(_MAX_LINEARIZATIONS):
            residual = (np.nan_to_num(displacement) - state.result.displacement[face])[known]
            target = residual + compliance[rows] @ forces[loaded].ravel()
            fit = SmoothFit(compliance[rows], plane, basis)
            fitted, covariance, noise = fit.fit(target, float(noise_mm))
            change = np.zeros_like(forces)
            change[loaded] = fitted.reshape(-1, 3) - forces[loaded]
            forces = forces + change
            step = linearized.linearization.solve((self.load_matrix @ change).ravel())
            predicted = state.result.displacement + step.reshape(-1, 3)
            previous = None if state is linearized else state
            state = self._equilibrium(forces, start=predicted, previous=previous)
            error = rms((state.result.displacement - predicted)[face])
            if error <= _NOISE_FRACTION * noise or rms(change) <= _FORCE_RTOL * rms(forces):
                break
            size = rms(state.result.displacement[face])
            if error > min(_DISPLACEMENT_FRACTION * size, _ERROR_DECREASE * last_error):
                linearized, compliance = state, self._compliance(state, loaded)
            last_error = error
        return GelContact(self.points, state.result.displacement[face], forces, covariance)

    @cached_property
    def rest(self) -> SolvedCase:
        """The gel without loads."""
        return self._equilibrium(np.zeros((len(self.points), 3)))

    @cached_property
    def load_matrix(self) -> sp.csc_matrix:
        """Forces on all element nodes from those on the nodes of the face, (nodes, k)."""
        # On quadratic elements a nodal force is distributed as a traction around the node: a point
        # force would have an unbounded displacement as the mesh is refined.
        indicator = np.zeros(self.gel_mesh.mesh.points.shape)
        indicator[self.gel_mesh.face] = 1.0
        matrix = self.body.discretisation.distribution_matrix(indicator)
        return matrix.tocsc()[:, self.gel_mesh.face]

    def _gather(self, forces: NodeVectors) -> FaceVectors:
        """Forces on the face from those on all element nodes; midside nodes go to both ends."""
        return self.at_vertices(forces, self.gel_mesh.on_face)[self.gel_mesh.face]

    def _equilibrium(
        self,
        forces: FaceVectors,
        displacement: FaceVectors | float = np.nan,
        start: NodeVectors | None = None,
        previous: SolvedCase | None = None,
    ) -> SolvedCase:
        """Equilibrium under forces on the face and displacements of it; NaN where it is free."""
        prescribed = np.full(self.gel_mesh.mesh.points.shape, np.nan)
        prescribed[self.gel_mesh.window] = 0.0
        prescribed[self.gel_mesh.face] = displacement
        return self.equilibrium(prescribed, self.load_matrix @ forces, start, previous)

    def rest_compliance(self, loaded: FaceMask) -> Float[np.ndarray, "k3 f"]:
        """Compliance at rest; columns are cached, since presses load similar nodes."""
        nodes = np.flatnonzero(loaded).tolist()
        missing = [i for i in nodes if i not in self._rest_columns]
        if missing:
            selected = np.zeros(len(loaded), dtype=bool)
            selected[missing] = True
            columns = np.split(self._compliance(self.rest, selected), len(missing), axis=1)
            self._rest_columns.update(zip(missing, columns, strict=True))
        return np.hstack([self._rest_columns[i] for i in nodes])

    def _compliance(self, state: SolvedCase, loaded: FaceMask) -> Float[np.ndarray, "k3 f"]:
        """Displacement of the face under unit forces on the loaded nodes."""
        loads = np.asfortranarray(np.kron(self.load_matrix[:, loaded].toarray(), np.eye(3)))
        solution = state.linearization.solve(loads).reshape(self.body.n_nodes, 3, -1)
        return solution[self.gel_mesh.face].reshape(3 * len(self.points), -1)

    def _total_force_sensitivity(
        self, state: SolvedCase, known: Bool[np.ndarray, "k 3"]
    ) -> np.ndarray:
        """Derivative of the total force (rows) with respect to the prescribed displacements."""
        # The tangent is symmetric: these are the forces on the face when all its known components
        # move along an axis.
        moved = np.zeros((3, *self.gel_mesh.mesh.points.shape))
        for axis in range(3):
            moved[axis, self.gel_mesh.face, axis] = known[:, axis]
        reactions = state.newton.tangent_times(state.result, self.fields(state, moved))
        return np.stack([self._gather(force.reshape(-1, 3))[known] for force in reactions.T])

    def plane_modes(self) -> Float[np.ndarray, "k3 3"]:
        """Displacements of the face along z: a constant and two tilts."""
        modes = np.zeros((len(self.points), 3, 3))
        modes[:, 2, 0] = 1.0
        modes[:, 2, 1:] = self.points[:, :2] / np.abs(self.points[:, :2]).max(axis=0)
        return modes.reshape(-1, 3)

    def known(self, displacement: FaceVectors) -> Bool[np.ndarray, "k 3"]:
        """Return which components are known; ConfigError for another shape, or if none is."""
        if displacement.shape != self.points.shape:
            raise ConfigError(
                f"displacement has shape {displacement.shape}; expected {self.points.shape}, one"
                " row for each node of the gel's outer face."
            )
        known = np.asarray(np.isfinite(displacement))
        if not known.any():
            raise ConfigError("no displacement of the gel is known; give the shape of its face.")
        return known
