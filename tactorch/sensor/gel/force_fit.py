"""Smooth forces that explain displacements of a gel by its compliance at rest.

Contact pushes and does not pull: nodes whose force would pull on the object are released.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float

from tactorch.errors import ConfigError, ConvergenceError
from tactorch.sensor.gel.model import GelContact, GelModel
from tactorch.sensor.gel.tractions import SmoothFit, traction_basis

_MAX_PULL = 0.3  # of the pushing forces; less is noise at the rim of the contact region
_MAX_RELEASES = 8

Vectors = Float[np.ndarray, "k 3"]
Mask = Bool[np.ndarray, " k"]
Covariance = Float[np.ndarray, "3 3"]


class ForceFit:
    """Fit of the forces on the nodes in contact to the displacements of a frame.

    Arguments are those of `GelModel.smooth_forces`; `columns` returns the compliance at rest by
    forces on some nodes, (3k, f).

    Attributes:
        normal_only: Whether only displacements along z are known: forces then are along z.
        loaded: Nodes that carry a force; without those that were released.

    Raises:
        ConfigError: `contact` is false at every node, or no displacement is known.
    """

    def __init__(
        self,
        model: GelModel,
        columns: Callable[[Mask], Float[np.ndarray, "k3 f"]],
        displacement: Vectors,
        noise_mm: float,
        contact: Mask,
        *,
        free_plane: bool,
    ) -> None:
        if not contact.any():
            raise ConfigError("contact is false at every node; without contact there is no force.")
        self.model, self.noise_mm = model, noise_mm
        self.displacement, self.known = displacement, model.known(displacement)
        self.normal_only = not self.known[:, :2].any()
        self._columns, rows = columns, self.known.ravel()
        count = int(rows.sum())
        self._plane = model.plane_modes()[rows] if free_plane else np.zeros((count, 0))
        self._load(contact)

    def _load(self, loaded: Mask) -> None:
        """Prepare the fit for forces on some nodes."""
        mesh, axes = self.model.gel_mesh, (2,) if self.normal_only else (0, 1, 2)
        basis = traction_basis(mesh.edges(loaded), mesh.face_areas[loaded], axes)
        self.loaded, self._compliance = loaded, self._columns(loaded)
        self._fit = SmoothFit(self._compliance[self.known.ravel()], self._plane, basis)

    def face_displacement(self, forces: Vectors) -> Vectors:
        """Return the displacements of the face by forces at rest, mm."""
        return (self._compliance @ forces[self.loaded].ravel()).reshape(-1, 3)

    def fit_pushing(self) -> tuple[Vectors, Covariance]:
        """Fit the forces of the linear gel; nodes that pull by more than noise does are released.

        Returns:
            Forces on the nodes of the face, N, and covariance of their sum, N^2.

        Raises:
            ConvergenceError: The gel would be pulled.
        """
        for _ in range(_MAX_RELEASES):
            target = self.displacement[self.known]
            fitted, covariance, _ = self._fit.fit(target, self.noise_mm)
            forces = self._spread(fitted)
            normal = forces[:, 2]
            if normal.clip(min=0.0).sum() <= _MAX_PULL * -normal.clip(max=0.0).sum():
                break
            kept = self.loaded & (normal < 0.0)
            if not kept.any():
                break
            self._load(kept)
        require_push(forces)
        return forces, covariance

    def refit(self, displacement: Vectors) -> Vectors:
        """Return forces for other displacements of the face, with the prior of the last fit, N."""
        return self._spread(self._fit.refit(displacement[self.known]))

    def _spread(self, fitted: Float[np.ndarray, " f"]) -> Vectors:
        forces = np.zeros(self.displacement.shape)
        forces[self.loaded] = fitted.reshape(-1, 3)
        return forces

    def without_tangential(
        self, forces: Vectors, moved: Vectors, covariance: Covariance
    ) -> GelContact:
        """Return forces along z; tangential components that were not measured are NaN.

        Where there is no contact, tangential forces are zero.
        """
        forces, moved, covariance = forces.copy(), moved.copy(), covariance.copy()
        forces[self.loaded, :2] = np.nan
        moved[:, :2] = np.nan
        covariance[:2], covariance[:, :2] = np.nan, np.nan
        return GelContact(self.model.points, moved, forces, covariance)


def require_push(forces: Vectors) -> None:
    """Raise ConvergenceError where the object would be pulled."""
    total = float(forces[:, 2].sum())
    if total > 0.0:
        raise ConvergenceError(
            f"the deformation corresponds to a pull of {total:.3g} N on the gel, which contact"
            " cannot exert: the depth or the contact region of this frame is wrong. Check the"
            " reference image, min_slope and min_depth_mm."
        )
