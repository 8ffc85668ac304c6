"""Contact forces on a gel whose mesh is refined at the edge of the contact.

At the edge of a contact without slip the traction is singular (Johnson, Contact Mechanics, 1985,
sec. 2.8): a mesh that does not resolve it, and a prior of smooth tractions, give up to 10 % too
much force. The displacement of the contact is smooth instead, since it is that of the surface of
the object. It is prescribed as a sum of smooth modes, the rest of the face is free, and the
amplitudes follow from the data, see `tactorch.sensor.gel.face_data`: markers measure the plane more
precisely than slopes the depth, and the motion of a nearly incompressible gel in the plane
determines the normal force as well.
"""

from functools import cached_property

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError
from tactorch.fem.equilibrium import SolvedCase
from tactorch.sensor.description import GelLayer
from tactorch.sensor.gel.body import GelBody, rms
from tactorch.sensor.gel.face import EdgeDistance, GelFace
from tactorch.sensor.gel.face_data import FaceData
from tactorch.sensor.gel.force_fit import require_push
from tactorch.sensor.gel.model import GelContact, GelErrors, GelModel
from tactorch.sensor.gel.tractions import SmoothFit

_MODES = 90  # smooth modes of the displacement of the contact along each axis
_MAX_ITERATIONS, _MAX_LINEARIZATIONS = 8, 3
_RTOL = 2e-3  # change of the displacements at convergence
# Edge length of elements over that of a square of the area of the contact, and the smallest, mm.
# A rigid flat punch has 0.5 to 1 % too much force with it, and up to 6 % with twice the length.
_EDGE_LENGTH, _SHORTEST_MM = 0.11, 0.15
_SAMPLE_MM = 0.1  # distance of the points that measure the area
# Error of the forces near the edge, which elements of this size leave, over the forces.
_EDGE_ERROR = 0.1
_NOISE_FRACTION = 0.1  # acceptable linearization error, relative to the deviations of the data

Vectors = Float[np.ndarray, "k 3"]
Modes = Float[np.ndarray, "c m"]
Fields = Float[np.ndarray, "unknowns m3"]


class RefinedGel(GelBody):
    """Finite element model of a gel with small elements at the edge of one contact.

    Args:
        model: Model of the gel with larger elements.
        distance: Distance from the edge of the contact.
        edge_mm: Longest edge of elements there, mm; less for a small contact.

    Attributes:
        edge_mm: Longest edge of elements at the edge of the contact, mm.
        face: Mesh with its outer face and the contact.

    Raises:
        ConfigError: No triangle of the face is in contact.
    """

    def __init__(self, model: GelModel, distance: EdgeDistance, edge_mm: float) -> None:
        self.edge_mm = min(edge_mm, _edge_length(distance, model.gel) or edge_mm)
        self.face = GelFace.refined(model.gel_mesh, distance, self.edge_mm)
        if not self.face.touching.any():
            raise ConfigError(
                "the contact is smaller than the elements of the gel; give less than"
                f" {self.edge_mm:g} mm for contact_edge_mm."
            )
        element = "tet10" if model.body.discretisation.element.quadratic else "tet4"
        super().__init__(self.face.mesh, model.gel, element)
        self._near = self.face.inside_mm < self.edge_mm

    def solve(self, data: FaceData, *, free_plane: bool = False) -> GelContact:
        """Return the most likely contact for displacements of the face, with its errors.

        The errors are those of the posterior of the displacement of the contact, which forces and
        displacements have in common, since the forces follow from the displacements, and those of
        the forces near the edge, where the mesh does not follow the singular traction. Deviations
        of the data are increased by a common factor where no smooth displacement of the contact
        explains the data within them. `free_plane` tells whether displacements along z are known up
        to a constant and a tilt.

        Raises:
            ConvergenceError: Newton's method does not converge, or the gel would be pulled.
        """
        rows = data.whiten(data.rows(self.face.points, self.face.triangles).toarray())
        plane = data.whiten(self._plane(data, free_plane))
        target, modes = data.whiten(data.displacement_mm), np.hstack(self._modes)
        n_linear, unit = 3 * self._modes[0].shape[1], np.eye(3 * modes.shape[1])
        basis = unit[:, :n_linear], unit[:, n_linear:]
        amplitudes, state = np.zeros(len(unit)), self._rest
        fields = self._fields(state, modes)
        for iteration in range(_MAX_ITERATIONS):
            on_face, before = self._on_face(fields), self._moved(state)
            compliance = rows @ on_face
            residual = target - rows @ before.ravel() + compliance @ amplitudes
            fit = SmoothFit(compliance, plane, basis)
            fitted, _, noise = fit.fit(residual, 1.0)
            change, amplitudes = fitted - amplitudes, fitted
            predicted = before + (on_face @ change).reshape(-1, 3)
            state = self._equilibrium(modes @ amplitudes.reshape(-1, 3), state)
            wrong = rows @ (self._moved(state) - predicted).ravel()
            small = rms(predicted - before) <= _RTOL * rms(predicted)
            if small or rms(wrong) <= _NOISE_FRACTION * noise:
                break
            if iteration < _MAX_LINEARIZATIONS - 1:
                fields = self._fields(state, modes)
        forces = self._forces(state)
        require_push(forces)
        errors = self._errors(state, modes, fit.errors()).joined(self._edge_errors(forces))
        return GelContact(
            self.face.points, self._moved(state), forces, errors.covariance, self.face.touching,
            errors, self.face.triangles,
        )  # fmt: skip

    @cached_property
    def _modes(self) -> tuple[Float[np.ndarray, "c u"], Float[np.ndarray, "c r"]]:
        return self.face.smooth_modes(_MODES)

    @cached_property
    def _rest(self) -> SolvedCase:
        return self._equilibrium(np.zeros((len(self.face.contact), 3)))

    def _moved(self, state: SolvedCase) -> Vectors:
        """Displacements of the nodes of the face, mm."""
        return state.result.displacement[self.face.nodes]

    def _equilibrium(
        self, displacement: Float[np.ndarray, "c 3"], previous: SolvedCase | None = None
    ) -> SolvedCase:
        """Equilibrium with prescribed displacements of the contact, mm."""
        prescribed = np.full(self.face.mesh.points.shape, np.nan)
        prescribed[self.face.window], prescribed[self.face.contact] = 0.0, displacement
        start = None if previous is None else previous.result.displacement
        return self.equilibrium(prescribed, start=start, previous=previous)

    def _fields(self, state: SolvedCase, modes: Modes) -> Fields:
        """Displacements of all nodes by unit modes along each axis, about an equilibrium, mm."""
        unit = np.kron(modes, np.eye(3)).T
        prescribed = np.zeros((len(unit), *self.face.mesh.points.shape))
        prescribed[:, self.face.contact] = unit.reshape(len(unit), -1, 3)
        return self.fields(state, prescribed)

    def _on_face(self, fields: Fields) -> Float[np.ndarray, "k3 m3"]:
        nodal = fields.reshape(self.body.n_nodes, 3, -1)
        return nodal[self.face.nodes].reshape(3 * len(self.face.nodes), -1)

    def _forces(self, state: SolvedCase) -> Vectors:
        """Reactions at the nodes of the contact, N; those of midside nodes go to both ends."""
        return self._gather(self.internal_forces(state))

    def _gather(self, forces: Float[np.ndarray, "nodes 3"]) -> Vectors:
        in_contact = np.zeros(self.face.mesh.n_points, dtype=bool)
        in_contact[self.face.contact] = True
        nodal = self.at_vertices(forces, in_contact)
        return np.where(in_contact[:, None], nodal, 0.0)[self.face.nodes]

    def _errors(
        self, state: SolvedCase, modes: Modes, amplitudes: Float[np.ndarray, "m3 q"]
    ) -> GelErrors:
        """Errors of forces and displacements by errors of the amplitudes of the modes."""
        fields = self._fields(state, modes) @ amplitudes
        changes = state.newton.tangent_times(state.result, fields)
        forces = [self._gather(change.reshape(-1, 3)) for change in changes.T]
        moved = self._on_face(fields).T.reshape(len(forces), -1, 3)
        return GelErrors(np.stack(forces), moved)

    def _edge_errors(self, forces: Vectors) -> GelErrors:
        """Errors of the forces near the edge, smooth along it."""
        along = np.zeros((self._modes[1].shape[1], len(forces)))
        along[:, self.face.touching] = self._modes[1].T
        changes = _EDGE_ERROR * (along * self._near)[:, :, None] * forces
        return GelErrors(changes, np.zeros_like(changes))

    def _plane(self, data: FaceData, free: bool) -> Float[np.ndarray, "d p"]:
        """Displacements along z that the data do not determine: a constant and two tilts."""
        if not free:
            return np.zeros((len(data.axes), 0))
        tilts = data.points_mm / np.abs(self.face.points[:, :2]).max(axis=0)
        return np.asarray(data.along_z[:, None] * np.column_stack([np.ones(len(tilts)), tilts]))


def _edge_length(distance: EdgeDistance, gel: GelLayer) -> float:
    """Edge length of elements for a contact by its area, mm; 0 for one that is too small."""
    axes = [np.arange(-half, half + _SAMPLE_MM, _SAMPLE_MM) for half in gel.half_size_mm]
    points = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    area = float((distance(points) >= 0.0).sum()) * _SAMPLE_MM**2
    return max(_EDGE_LENGTH * float(np.sqrt(area)), _SHORTEST_MM) if area > 0.0 else 0.0
