"""Where the sensor was when its gel first touched the object.

From there on gel and object move together, so an error here goes whole into the object's motion.
"""

import logging
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from tactorch.mesh import TetMesh
from tactorch.sensor.contact import Poses, moved
from tactorch.sensor.description import GelLayer

_log = logging.getLogger(__name__)
_HALVINGS = 30
_FACING = 0.5  # cosine, as where presses are paired
_SPACING_MM = 0.5  # of points on the object's face
_APART_MM = 0.5  # a gap at the first frame of contact that is worth a warning


def by_shape(
    poses: Poses, free_s: float | None, touched_s: float, mesh: TetMesh, gel: GelLayer
) -> Float[np.ndarray, "4 4"]:
    """Return the pose at which the gel's face meets the object's, both at rest.

    Args:
        poses: Of the sensor.
        free_s: Time of the last frame without contact; None where there is none.
        touched_s: Time of the first frame with contact.
        mesh: The object at rest.
        gel: The sensor's.

    Raises:
        ConfigError: A time has no pose.
    """
    points, normals = face_points(mesh)

    def gap(time_s: float) -> float:
        return gap_mm(poses.at([time_s])[0], points, normals, gel)

    now = poses.at([touched_s])[0]
    apart = gap(touched_s)
    if apart >= 0:
        if _APART_MM < apart < np.inf:
            _log.warning(
                "At %.3f s the images show contact, but by the poses gel and object are %.2f mm"
                " apart: check T_object_sensor and the object's mesh.", touched_s, apart,
            )  # fmt: skip
        return now
    low = None if free_s is None else _clear(poses, free_s, gap)
    if low is None:  # nothing tells the way: straight back along the sensor's axis
        back = now.copy()
        back[:3, 3] += apart * now[:3, 2]
        return back
    high = touched_s
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if gap(middle) >= 0 else (low, middle)
    return poses.at([low])[0]


def by_depth(
    poses: Poses,
    free_s: float | None,
    times_s: Float[np.ndarray, " n"],
    depths_mm: Float[np.ndarray, " n"],
) -> Float[np.ndarray, "4 4"]:
    """Return the pose at which the depth that frames show began.

    The first two frames tell how depth grows with the sensor's way along its axis.

    Args:
        poses: Of the sensor.
        free_s: Time of the last frame without contact; None where there is none.
        times_s: Of the frames with contact.
        depths_mm: How deep the gel was pressed in them.

    Raises:
        ConfigError: A time has no pose.
    """
    first = float(times_s[0])
    earliest = first if free_s is None else free_s
    if len(times_s) < 2 or depths_mm[1] <= depths_mm[0]:
        return poses.at([0.5 * (earliest + first)])[0]
    rate = (depths_mm[1] - depths_mm[0]) / (times_s[1] - times_s[0])
    began = first - float(depths_mm[0] / rate)
    return poses.at([float(np.clip(began, earliest, first))])[0]


def gap_mm(
    pose: Float[np.ndarray, "4 4"],
    points: Float[np.ndarray, "p 3"],
    normals: Float[np.ndarray, "p 3"],
    gel: GelLayer,
) -> float:
    """Return the least distance along the sensor's axis from gel to object, both at rest, mm.

    It is negative where they overlap, and infinite where the gel is not over the object.

    Args:
        pose: T_object_sensor.
        points: Of the object's face, see `face_points`.
        normals: Outward, of the face at each.
        gel: The sensor's.
    """
    toward = np.asarray(normals @ pose[:3, 2] < -_FACING)
    seen = moved(np.linalg.inv(pose), points[toward])
    # Faces deeper in than the layer is thick are another part of the object, behind the sensor.
    near = gel.covers(seen[:, :2]) & (seen[:, 2] > -float(gel.thickness_mm))
    if not near.any():
        return np.inf
    return float((seen[near, 2] - gel.height_mm(seen[near, :2])).min())


def face_points(mesh: TetMesh) -> tuple[Float[np.ndarray, "p 3"], Float[np.ndarray, "p 3"]]:
    """Return points all over the object's surface, and its normals there."""
    surface = mesh.surface
    corners = mesh.points[surface.triangles]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max()
    n = max(2, int(np.ceil(longest / _SPACING_MM)))
    grid = np.array([(i, j, n - i - j) for i in range(n + 1) for j in range(n + 1 - i)]) / n
    points = np.einsum("pc,tcd->tpd", grid, corners).reshape(-1, 3)
    return points, np.repeat(surface.normals, len(grid), axis=0)


def _clear(poses: Poses, free_s: float, gap: Callable[[float], float]) -> float | None:
    """Latest time at which gel and object were apart, up to the last frame without contact."""
    before = poses.time_s[poses.time_s < free_s]
    for time_s in (free_s, *before[::-1]):
        if gap(float(time_s)) >= 0:
            return float(time_s)
    return None
