"""Pose of the sensor at first contact.

Gel and object move together from this pose on, so its error adds to the object's displacements.
"""

import logging
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from tactorch.mesh import TetMesh
from tactorch.sensor.contact import MIN_FACING, Pose
from tactorch.sensor.description import GelLayer
from tactorch.sensor.poses import Poses, transform_points

_log = logging.getLogger(__name__)
_BISECTIONS = 30
_POINT_SPACING_MM = 0.5  # on the object's face
_MAX_GAP_MM = 0.5  # at the first frame with contact, without a warning


def first_pose_by_shape(
    poses: Poses, free_s: float | None, contact_s: float, mesh: TetMesh, gel: GelLayer
) -> Pose:
    """Return T_object_sensor at which the gel's face meets the object's, both at rest.

    `free_s` is the time of the last frame without contact, if any, `contact_s` that of the first
    with contact.
    """
    surface = sample_surface(mesh)

    def gap_at(time_s: float) -> float:
        return axial_gap(poses.at([time_s])[0], *surface, gel)

    pose = poses.at([contact_s])[0]
    gap = gap_at(contact_s)
    if gap >= 0:
        if _MAX_GAP_MM < gap < np.inf:
            _log.warning(
                "At %.3f s the images show contact, but by the poses gel and object are %.2f mm"
                " apart: check T_object_sensor and the object's mesh.", contact_s, gap,
            )  # fmt: skip
        return pose
    earlier = [] if free_s is None else [free_s, *poses.time_s[poses.time_s < free_s][::-1]]
    low = next((float(time_s) for time_s in earlier if gap_at(float(time_s)) >= 0), None)
    if low is None:  # without an approach in the poses, retract along the sensor's axis
        retracted = pose.copy()
        retracted[:3, 3] += gap * pose[:3, 2]
        return retracted
    high = contact_s
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if gap_at(middle) >= 0 else (low, middle)
    return poses.at([low])[0]


def first_pose_by_depth(
    poses: Poses, free_s: float | None, times_s: Sequence[float], depths_mm: Sequence[float]
) -> Pose:
    """Return the pose at which the depth starts, extrapolated from the first two frames."""
    first = times_s[0]
    earliest = first if free_s is None else free_s
    if len(times_s) < 2 or depths_mm[1] <= depths_mm[0]:
        return poses.at([0.5 * (earliest + first)])[0]
    rate = (depths_mm[1] - depths_mm[0]) / (times_s[1] - times_s[0])
    start = first - depths_mm[0] / rate
    return poses.at([float(np.clip(start, earliest, first))])[0]


def axial_gap(
    pose: Pose, points: Float[np.ndarray, "p 3"], normals: Float[np.ndarray, "p 3"], gel: GelLayer
) -> float:
    """Return the smallest distance along the sensor's axis from gel to object, both at rest, mm.

    It is negative for an overlap, infinite if the gel is not over the object. `points` and their
    outward `normals` are those of `sample_surface`.
    """
    facing = np.asarray(normals @ pose[:3, 2] < -MIN_FACING)
    in_sensor = transform_points(np.linalg.inv(pose), points[facing])
    # A face farther behind than the gel is thick is another part of the object.
    near = gel.covers(in_sensor[:, :2]) & (in_sensor[:, 2] > -gel.thickness_mm)
    if not near.any():
        return np.inf
    return float((in_sensor[near, 2] - gel.height_mm(in_sensor[near, :2])).min())


def sample_surface(mesh: TetMesh) -> tuple[Float[np.ndarray, "p 3"], Float[np.ndarray, "p 3"]]:
    """Return points on the object's surface and the normals at them."""
    surface = mesh.surface
    corners = mesh.points[surface.triangles]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max()
    n = max(2, int(np.ceil(longest / _POINT_SPACING_MM)))
    grid = np.array([(i, j, n - i - j) for i in range(n + 1) for j in range(n + 1 - i)]) / n
    points = np.einsum("pc,tcd->tpd", grid, corners).reshape(-1, 3)
    return points, np.repeat(surface.normals, len(grid), axis=0)
