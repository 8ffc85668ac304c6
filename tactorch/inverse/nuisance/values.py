"""Values of the nuisance parameters, all presses in common."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from tactorch.recording import Recording


@dataclass(frozen=True, eq=False)
class Nuisance:
    """What the data depend on beside the moduli.

    The sensor's frame is that of the mesh, but for a small rigid motion: what the sensor reports
    at x it reports at `rotation (x - c) + c + translation`, c the centre of the mesh's bounding
    box, and forces turned likewise. The true rest shape is the mesh stretched along the axes
    about where each press holds it. The true forces are the reported ones times `force_scale`.

    Attributes:
        poisson: Poisson's ratio of the whole object.
        force_scale: True over reported force.
        rest_scale: True over assumed size along x, y and z.
        translation_mm: Of what the sensor reports, mm.
        rotation_rad: Of what the sensor reports, a rotation vector.
    """

    poisson: float
    force_scale: float = 1.0
    rest_scale: Float[np.ndarray, "3"] = field(default_factory=lambda: np.ones(3))
    translation_mm: Float[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))
    rotation_rad: Float[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))

    @staticmethod
    def assumed(recording: Recording) -> "Nuisance":
        """Take the values that the recording states, or implies by not stating any."""
        return Nuisance(recording.material.poisson)

    @property
    def rotation(self) -> Float[np.ndarray, "3 3"]:
        """The rotation as a matrix; exactly the unit matrix for a zero vector."""
        if not self.rotation_rad.any():
            return np.eye(3)
        return Rotation.from_rotvec(self.rotation_rad).as_matrix()

    def rotation_rates(self) -> Float[np.ndarray, "3 3"]:
        """Return, column by column, the spatial rotation by a change of each component.

        This is the left Jacobian of the rotation group (Sola, Deray and Atchuthan, 2018, eq. 145).
        """
        angle = float(np.linalg.norm(self.rotation_rad))
        x, y, z = self.rotation_rad
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        if angle < 1e-4:  # the coefficients' own series: their differences would cancel
            return np.eye(3) + 0.5 * cross + cross @ cross / 6.0
        a = (1.0 - np.cos(angle)) / angle**2
        b = (angle - np.sin(angle)) / angle**3
        return np.eye(3) + a * cross + b * (cross @ cross)
