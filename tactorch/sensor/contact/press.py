"""From a gel in contact to a press on the object (Section III-A, and the end of Section VI-B).

Without slip, a point of the gel stays with the point of the object that it met. They are paired in
the pose of first touch; from then on the object's point goes where the gel's goes.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from tactorch.errors import ConfigError
from tactorch.mesh import TetMesh
from tactorch.mesh.values import Real
from tactorch.recording import Press
from tactorch.sensor.contact.carry import carry_displacements, carry_forces
from tactorch.sensor.contact.pose import check_pose, moved, turned
from tactorch.sensor.gel import Contact

_FACING = 0.5  # cosine between the object's face and the sensor's, from which they may touch
_HALF = 0.5


@dataclass(frozen=True)
class ContactOptions:
    """Which parts of an object may be touched, and what is said of those that are not.

    Attributes:
        reach_mm: Distance of the object's face from the gel's, in the pose of first touch, up to
            which they may come to touch.
        untouched: Nodes under the gel without contact: "unseen" leaves them out; "sensor" takes
            them to have moved as the sensor did, as the paper does for objects of unknown shape
            within a virtual cube (its empty parts then come out as soft as can be).
        smoothing: Of the displacements, see `carry_displacements`.
    """

    reach_mm: Real = 3.0
    untouched: str = "unseen"
    smoothing: float = 0.0

    def __post_init__(self) -> None:
        if not (np.isfinite(self.reach_mm) and self.reach_mm > 0):
            raise ConfigError(f"reach_mm={self.reach_mm} must be a positive number.")
        if self.untouched not in ("unseen", "sensor"):
            raise ConfigError(f"untouched={self.untouched!r}: choose unseen or sensor.")


def build_press(
    contact: Contact,
    pose: Float[np.ndarray, "4 4"],
    first: Float[np.ndarray, "4 4"],
    mesh: TetMesh,
    touched: Bool[np.ndarray, " k"],
    *,
    touching: ContactOptions | None = None,
    **fields: Any,
) -> Press:
    """Return the press that a sensor makes on an object.

    Args:
        contact: Forces on the gel and displacement of its face, in the sensor's frame.
        pose: T_object_sensor of this frame.
        first: T_object_sensor when the gel first touched the object.
        mesh: The object at rest, mm.
        touched: Nodes of the gel's face that touch the object; forces on others do not count.
        touching: Which parts may be touched.
        fields: Of the press beside forces and displacements: what holds the object (`springs`,
            `fixed`, `prescribed`), `noise_mm`, `step`, `name`.

    Raises:
        ConfigError: A pose is none, or the gel touches nothing of the object.
        RecordingError: A field of the press cannot be used.
    """
    options = touching or ContactOptions()
    check_pose(pose, "pose")
    check_pose(first, "first pose")
    _require_touch(touched)
    triangles = facing(mesh, first, contact, float(options.reach_mm))
    outward = first[:3, 2]
    met = moved(first, contact.points)  # where the object's points were that the gel's met
    went = moved(pose, contact.points + contact.displacement) - met
    forces = -turned(pose, np.where(touched[:, None], contact.forces, 0.0))
    carried = carry_forces(met, forces, mesh.points, triangles)
    nodes = np.unique(triangles)
    found, inside = carry_displacements(met, went, mesh.points[nodes], outward, options.smoothing)
    near = _touched_nodes(contact.points, touched, first, mesh.points[nodes])
    seen = np.zeros(mesh.points.shape, dtype=bool)
    displacement = np.full(mesh.points.shape, np.nan)
    displacement[nodes[inside & near]] = found[inside & near]
    seen[nodes[inside & near]] = True
    if options.untouched == "sensor":
        free = nodes[inside & ~near]
        rest = moved(np.linalg.inv(first), mesh.points[free])
        displacement[free] = moved(pose, rest) - mesh.points[free]
        seen[free] = True
    if not seen.any():
        raise ConfigError("no node of the object lies where the gel touches; is it too coarse?")
    return Press(carried, seen, displacement, direction=pose[:3, 2].copy(), **fields)


def facing(
    mesh: TetMesh, first: Float[np.ndarray, "4 4"], contact: Contact, reach_mm: float
) -> Int[np.ndarray, "t 3"]:
    """Return the object's surface triangles that face the gel, under it and within reach.

    Raises:
        ConfigError: There is none.
    """
    surface = mesh.surface
    toward = np.asarray(surface.normals @ first[:3, 2] < -_FACING)
    corners = moved(np.linalg.inv(first), mesh.points[surface.triangles].mean(axis=1))
    low, high = contact.points[:, :2].min(axis=0), contact.points[:, :2].max(axis=0)
    under = ((corners[:, :2] >= low) & (corners[:, :2] <= high)).all(axis=1)
    close = np.abs(corners[:, 2] - float(np.median(contact.points[:, 2]))) <= reach_mm
    found = surface.triangles[toward & under & close]
    if not len(found):
        away = np.abs(corners[toward & under, 2]).min() if (toward & under).any() else np.inf
        raise ConfigError(
            "the gel is over no part of the object in the pose of first touch"
            + (f": the nearest is {away:.3g} mm away" if np.isfinite(away) else "")
            + "; check T_object_sensor, whose z axis points out of the sensor to the object."
            + _metres(first, mesh)
        )
    return found


def _metres(first: Float[np.ndarray, "4 4"], mesh: TetMesh) -> str:
    """A hint, where a pose that misses the object would not if its place were in metres."""
    place = first[:3, 3]
    largest = float(np.abs(place).max())
    if not 0 < largest < 0.05 * float(np.abs(mesh.points).max()):
        return ""
    return f" Its place {[float(f'{v:.4g}') for v in place]} looks like metres; give mm."


def _touched_nodes(
    points: Float[np.ndarray, "k 3"],
    touched: Bool[np.ndarray, " k"],
    first: Float[np.ndarray, "4 4"],
    nodes: Float[np.ndarray, "n 3"],
) -> Bool[np.ndarray, " n"]:
    """Which of the object's nodes lie under nodes of the gel that touch."""
    from scipy.interpolate import LinearNDInterpolator

    flat = moved(np.linalg.inv(first), nodes)[:, :2]
    share = LinearNDInterpolator(points[:, :2], touched.astype(float), fill_value=0.0)(flat)
    return np.asarray(share >= _HALF)


def _require_touch(touched: Bool[np.ndarray, " k"]) -> None:
    if not touched.any():
        raise ConfigError("the gel touches nothing in this frame; leave it out.")
