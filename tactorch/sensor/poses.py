"""Poses of the sensor: checks, CSV tables and interpolation in time.

A pose T_object_sensor maps points from the sensor frame to the object frame:
p_object = R p_sensor + t, in mm.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation, Slerp

from tactorch.errors import ConfigError, FileError
from tactorch.sensor.table import read_rows

_TOLERANCE = 1e-4  # of a rotation's orthonormality
_MAX_DISTANCE_MM = 1e4
_COLUMNS = ("time_s", "x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz")
Pose = Float[np.ndarray, "4 4"]
_Vectors = Float[np.ndarray, "*n 3"]


@dataclass(frozen=True, eq=False)
class Poses:
    """Poses of the sensor over time.

    Attributes:
        time_s: Strictly increasing times, (n,).
        T_object_sensor: Rigid transforms, (n, 4, 4), mm.
    """

    time_s: Float[np.ndarray, " n"]
    T_object_sensor: Float[np.ndarray, "n 4 4"]

    def __post_init__(self) -> None:
        if not len(self.time_s):
            raise ConfigError("there is no pose; give one or more.")
        for i in np.flatnonzero(~np.isfinite(self.time_s)):
            raise ConfigError(f"pose {i} has no time: time_s is {self.time_s[i]:g}; give seconds.")
        for i in np.flatnonzero(np.diff(self.time_s) <= 0):
            raise ConfigError(
                f"time_s must rise: pose {i + 1} is at {self.time_s[i + 1]:g} s, the one before it"
                f" at {self.time_s[i]:g} s."
            )
        for number, pose in enumerate(self.T_object_sensor):
            check_pose(pose, f"pose {number}")

    def __len__(self) -> int:
        return len(self.time_s)

    def relative_to(self, start_s: float) -> "Poses":
        """Return the poses with times relative to `start_s`."""
        return replace(self, time_s=self.time_s - start_s)

    def at(self, times_s: Sequence[float] | Float[np.ndarray, " k"]) -> Float[np.ndarray, "k 4 4"]:
        """Return poses interpolated in time: linear translation, spherical linear rotation.

        Raises:
            ConfigError: A time is before the first pose, after the last, or unknown.
        """
        times = np.asarray(times_s, dtype=float)
        untimed = int((~np.isfinite(times)).sum())
        if untimed:
            raise ConfigError(
                f"{untimed} of {len(times)} frames have no time, which is needed to find"
                " their poses; give frame_rate_hz in the sensor's description."
            )
        outside = int(((times < self.time_s[0]) | (times > self.time_s[-1])).sum())
        if outside:
            raise ConfigError(
                f"{outside} of {len(times)} frames have no pose: frames are from"
                f" {times.min():.3f} to {times.max():.3f} s, poses from {self.time_s[0]:.3f} to"
                f" {self.time_s[-1]:.3f} s. Leave such frames out, or set both to one clock."
            )
        return interpolate_poses(times, self.time_s, self.T_object_sensor)


def interpolate_poses(
    times_s: Float[np.ndarray, " k"],
    known_s: Float[np.ndarray, " n"],
    poses: Float[np.ndarray, "n 4 4"],
) -> Float[np.ndarray, "k 4 4"]:
    """Return poses at times within known ones.

    Positions are interpolated linearly, rotations along the shortest arc (Shoemake, 1985).
    """
    if len(known_s) == 1:
        return np.tile(poses, (len(times_s), 1, 1))
    found = np.tile(np.eye(4), (len(times_s), 1, 1))
    rotations = Slerp(known_s, Rotation.from_matrix(poses[:, :3, :3]))
    found[:, :3, :3] = rotations(times_s).as_matrix()
    for k in range(3):
        found[:, k, 3] = np.interp(times_s, known_s, poses[:, k, 3])
    return found


def check_pose(pose: Pose, name: str = "T_object_sensor") -> None:
    """Check that a matrix is a rigid transform."""
    if not np.isfinite(pose).all():
        raise ConfigError(f"{name} is not finite; leave out poses that the robot did not report.")
    if np.abs(pose[3] - (0, 0, 0, 1)).max() > _TOLERANCE:
        raise ConfigError(f"{name}: the last row must be 0 0 0 1; is it transposed?")
    rotation = pose[:3, :3]
    determinant = float(np.linalg.det(rotation))
    if abs(determinant) < 0.5:
        raise ConfigError(
            f"{name} is singular (determinant {determinant:.3g}): its upper left 3 x 3 numbers"
            " must be a rotation."
        )
    if determinant < 0:
        raise ConfigError(
            f"{name} mirrors (determinant {determinant:.3g}); turn one axis round, so that x, y and"
            " z are right-handed."
        )
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > _TOLERANCE:
        raise ConfigError(f"{name}: its rotation is not orthonormal; does it scale or shear?")
    distance = float(np.abs(pose[:3, 3]).max())
    if distance > _MAX_DISTANCE_MM:
        raise ConfigError(f"{name} is {distance:.4g} mm away from the object's origin; give mm.")


def transform_points(pose: Pose, points: _Vectors) -> _Vectors:
    """Transform points from the sensor frame to the object frame, mm."""
    return points @ pose[:3, :3].T + pose[:3, 3]


def rotate_vectors(pose: Pose, vectors: _Vectors) -> _Vectors:
    """Rotate vectors, such as forces, from the sensor frame to the object frame."""
    return vectors @ pose[:3, :3].T


def read_poses(path: str | Path, *, growing: bool = False) -> Poses:
    """Read poses from a CSV file with columns time_s, x_mm, y_mm, z_mm, qw, qx, qy, qz.

    In a `growing` file, to which lines are still appended, an unterminated last line is ignored.
    """
    rows = list(read_rows(path, "table of poses", _COLUMNS, growing=growing))
    table = np.array([[row.number(name) for name in _COLUMNS] for row in rows])
    table = table.reshape(-1, len(_COLUMNS))
    with np.errstate(over="ignore"):
        lengths = np.linalg.norm(table[:, 4:], axis=1)
    for i in np.flatnonzero(~(np.abs(lengths - 1.0) < 1e-2)):
        raise FileError(
            f"{rows[i].location}: the quaternion has length {lengths[i]:.4g}, not 1; give"
            " qw, qx, qy, qz in the columns of these names."
        )
    poses = np.tile(np.eye(4), (len(table), 1, 1))
    if len(table):
        poses[:, :3, :3] = Rotation.from_quat(table[:, 4:], scalar_first=True).as_matrix()
    poses[:, :3, 3] = table[:, 1:4]
    try:
        return Poses(table[:, 0], poses)
    except ConfigError as error:
        raise ConfigError(f"table of poses '{path}': {error}") from error
