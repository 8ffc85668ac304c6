"""Contact forces of a gel frame by frame: what frames have in common is computed once.

The compliance of the face at rest belongs to the mesh (`tactorch.sensor.gel.compliance`). For small
deformations it gives the forces by a fit without any solve of the finite element model, for large
ones with a fixed number of solves (`tactorch.sensor.gel.force_expansion`). The time for a frame is
therefore bounded, and a frame's forces do not depend on earlier frames.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from tactorch.config import Options, option
from tactorch.mesh.values import Real
from tactorch.sensor.gel.compliance import Report, face_compliance
from tactorch.sensor.gel.force_expansion import expand_forces
from tactorch.sensor.gel.force_fit import ForceFit, Mask, Vectors, require_push
from tactorch.sensor.gel.model import GelContact, GelModel

#: Displacement over the gel's thickness up to which `deformation=auto` takes the gel as linear.
LINEAR_FRACTION = 0.05


@dataclass(frozen=True)
class ForceOptions(Options):
    """Computation of the forces of a frame."""

    deformation: Literal["auto", "small", "large"] = option(
        "auto",
        "Model of the gel; small: linear, fast; large: finite strains; auto: small up to a"
        " displacement of a twentieth of the gel's thickness",
    )


class ForceSolver:
    """Solver for the smooth forces behind displacements of a gel's face, frame by frame.

    The estimate is that of `GelModel.smooth_forces`, which solves the equilibrium by iteration.
    """

    def __init__(self, model: GelModel, options: ForceOptions | None = None) -> None:
        self.model, self.options = model, options or ForceOptions()
        self._compliance: Float[np.ndarray, "k3 k3"] | None = None
        self._is_prepared = False

    def prepare(self, report: Report = lambda done, total: None) -> None:
        """Read or compute the compliance of the face at rest; the first frame does it otherwise.

        `report` receives the nodes done and their number while it is computed.
        """
        if not self._is_prepared:
            self._compliance = face_compliance(self.model, report)
            self._is_prepared = True

    def solve(
        self, displacement: Vectors, noise_mm: Real, contact: Mask, *, free_plane: bool = False
    ) -> GelContact:
        """Return the most likely smooth forces; arguments are those of `GelModel.smooth_forces`.

        Where only displacements along z are known (depth alone), tangential tractions are taken as
        zero (no friction), and tangential forces and displacements of the result are NaN. Nodes
        that would pull on the object are released from the contact.

        Raises:
            ConfigError: `contact` is false at every node, or no displacement is known.
            ConvergenceError: The forces would pull on the object, or the deformation is too large
                for the model.
        """
        self.prepare()
        fit = ForceFit(
            self.model, self._columns, displacement, float(noise_mm), contact, free_plane=free_plane
        )
        forces, covariance = fit.fit_pushing()
        moved = fit.face_displacement(forces)
        if self._is_large(moved):
            forces, moved = expand_forces(fit, forces)
            require_push(forces)
        if fit.normal_only:
            return fit.without_tangential(forces, moved, covariance)
        return GelContact(self.model.points, moved, forces, covariance)

    def _is_large(self, moved: Vectors) -> bool:
        if self.options.deformation != "auto":
            return self.options.deformation == "large"
        return float(np.abs(moved).max()) > LINEAR_FRACTION * float(self.model.gel.thickness_mm)

    def _columns(self, loaded: Mask) -> Float[np.ndarray, "k3 f"]:
        """Compliance at rest by forces on some nodes."""
        if self._compliance is None:
            return self.model.rest_compliance(loaded)
        return self._compliance[:, np.repeat(loaded, 3)]
