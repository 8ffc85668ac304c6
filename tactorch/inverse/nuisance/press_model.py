"""A press as the nuisance parameters make it: true forces, true rest shape, reported motion."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from tactorch.inverse.nuisance.values import Nuisance
from tactorch.recording import Press, Recording


@dataclass(frozen=True, eq=False)
class PressModel:
    """One press at given nuisance values.

    Attributes:
        forces: True forces on the mesh's nodes, in its frame, N.
        arm: True rest position from where the press holds the object, mm.
        drift: Displacement that the sensor reports where nothing moves, mm.
        values: The nuisance values.
        rest: Rest positions, as assumed, from the centre of turning, mm.
    """

    forces: Float[np.ndarray, "n 3"]
    arm: Float[np.ndarray, "n 3"]
    drift: Float[np.ndarray, "n 3"]
    values: Nuisance
    rest: Float[np.ndarray, "n 3"]

    def reported(self, u: Float[np.ndarray, "nodes 3"]) -> Float[np.ndarray, "n 3"]:
        """Return the displacement that the sensor reports where the true one is u, mm."""
        return self.drift + u[: len(self.rest)] @ self.values.rotation.T

    def force_rates(self, name: str) -> list[Float[np.ndarray, "n 3"]]:
        """Return the change of the true forces by each component of a parameter.

        For a scale the component is its logarithm.
        """
        if name == "force_scale":
            return [self.forces]
        if name == "rotation_rad":
            turned = self.forces @ self.values.rotation.T
            rates = self.values.rotation_rates().T
            return [-np.cross(rate, turned) @ self.values.rotation for rate in rates]
        return []

    def report_rates(
        self, name: str, u: Float[np.ndarray, "nodes 3"]
    ) -> list[Float[np.ndarray, "n 3"]]:
        """Return the change of the report by each component, the true displacement unchanged."""
        if name == "rest_scale":
            return [np.outer(self.arm[:, a], self.values.rotation[:, a]) for a in range(3)]
        if name == "translation_mm":
            return [np.broadcast_to(row, self.rest.shape).copy() for row in np.eye(3)]
        if name == "rotation_rad":
            turned = self.reported(u) + self.rest - self.values.translation_mm
            return [np.cross(rate, turned) for rate in self.values.rotation_rates().T]
        return []


class PressModelFactory:
    """Places the presses of a recording; what does not depend on the values is done once."""

    def __init__(self, recording: Recording) -> None:
        """Find where each press holds the object."""
        self._presses = recording.presses
        self.points = recording.mesh.points
        self._center = recording.mesh.bounds.mean(axis=0)
        self._held = [_held(press, self.points, self._center) for press in recording.presses]

    def rest_points(self, values: Nuisance) -> Float[np.ndarray, "n 3"]:
        """Return the true rest shape, mm; where it lies does not matter to mechanics."""
        return self.points * values.rest_scale

    def at(self, values: Nuisance, index: int) -> PressModel:
        """Place one press."""
        rotation, held = values.rotation, self._held[index]
        rest, arm = self.points - self._center, (self.points - held) * values.rest_scale
        # Written so that it is exactly zero at the assumed values.
        true = rest + (arm - (self.points - held))
        drift = true @ rotation.T - rest + values.translation_mm
        forces = values.force_scale * (self._presses[index].forces @ rotation)
        return PressModel(forces, arm, drift, values, rest)


def _held(
    press: Press, points: Float[np.ndarray, "n 3"], center: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "3"]:
    """Where a press holds the object: along each axis the mean of what is held along it.

    The table is where it is, whatever the object's size; an axis without support keeps the centre.
    """
    supported = press.fixed | (press.springs > 0)
    return np.array(
        [points[on, a].mean() if (on := supported[:, a]).any() else center[a] for a in range(3)]
    )
