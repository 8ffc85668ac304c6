"""Where the sensor is: poses T_object_sensor, checked, read, and paired with frames by time.

A pose turns points in the sensor's frame into the object's: p_object = R p_sensor + t, mm.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation, Slerp

from tactorch.errors import ConfigError, FileError
from tactorch.sensor.table import read_rows

_EXACT = 1e-4  # of a rotation's orthonormality
_FAR_MM = 1e4  # poses farther off look like metres taken for millimetres, or a wrong frame
_QUATERNION = ("time_s", "x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz")


@dataclass(frozen=True, eq=False)
class Poses:
    """Poses of the sensor over time.

    Attributes:
        time_s: When, rising, (n,).
        T_object_sensor: (n, 4, 4), mm.

    Raises:
        ConfigError: Shapes differ, times do not rise, or a pose is none; the message names it.
    """

    time_s: Float[np.ndarray, " n"]
    T_object_sensor: Float[np.ndarray, "n 4 4"]

    def __post_init__(self) -> None:
        if not len(self.time_s):
            raise ConfigError("there is no pose.")
        if not np.isfinite(self.time_s).all():
            i = int(np.argmin(np.isfinite(self.time_s)))
            raise ConfigError(f"pose {i} has no time: time_s is {self.time_s[i]:g}; give seconds.")
        bad = np.flatnonzero(~(np.diff(self.time_s) > 0))
        if len(bad):
            raise ConfigError(
                f"time_s must rise: pose {bad[0] + 1} is at {self.time_s[bad[0] + 1]:g} s, the one"
                f" before it at {self.time_s[bad[0]]:g} s."
            )
        for i, pose in enumerate(self.T_object_sensor):
            check_pose(pose, f"pose {i}")

    def __len__(self) -> int:
        return len(self.time_s)

    def since(self, start_s: float) -> "Poses":
        """Return them with times counted from `start_s`."""
        return replace(self, time_s=self.time_s - start_s)

    def at(self, times_s: Sequence[float] | Float[np.ndarray, " k"]) -> Float[np.ndarray, "k 4 4"]:
        """Return the poses at times between those known: turned and moved evenly.

        Raises:
            ConfigError: A time lies before the first or after the last.
        """
        times = np.asarray(times_s, dtype=float)
        untimed = ~np.isfinite(times)
        if untimed.any():
            raise ConfigError(
                f"{int(untimed.sum())} of {len(times)} frames have no time, by which poses are"
                " found; give frame_rate_hz in the sensor's description."
            )
        outside = (times < self.time_s[0]) | (times > self.time_s[-1])
        if outside.any():
            raise ConfigError(
                f"{int(outside.sum())} of {len(times)} frames have no pose: frames are from"
                f" {times.min():.3f} to {times.max():.3f} s, poses from {self.time_s[0]:.3f} to"
                f" {self.time_s[-1]:.3f} s. Leave such frames out, or set both to one clock."
            )
        found = np.tile(np.eye(4), (len(times), 1, 1))
        moved = self.T_object_sensor[:, :3, 3]
        if len(self) == 1:
            found[:] = self.T_object_sensor[0]
            return found
        turns = Slerp(self.time_s, Rotation.from_matrix(self.T_object_sensor[:, :3, :3]))
        found[:, :3, :3] = turns(times).as_matrix()
        found[:, :3, 3] = np.column_stack(
            [np.interp(times, self.time_s, moved[:, k]) for k in range(3)]
        )
        return found


def check_pose(pose: Float[np.ndarray, "4 4"], name: str = "T_object_sensor") -> None:
    """Refuse what is no rigid motion.

    Raises:
        ConfigError: It is not; the message says why.
    """
    if not np.isfinite(pose).all():
        raise ConfigError(f"{name} is not finite; leave out what the robot did not tell.")
    if np.abs(pose[3] - (0, 0, 0, 1)).max() > _EXACT:
        raise ConfigError(f"{name}: the last row must be 0 0 0 1; is it transposed?")
    turn = pose[:3, :3]
    determinant = float(np.linalg.det(turn))
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
    if np.abs(turn @ turn.T - np.eye(3)).max() > _EXACT:
        raise ConfigError(f"{name}: its rotation is not orthonormal; does it scale or shear?")
    far = float(np.abs(pose[:3, 3]).max())
    if far > _FAR_MM:
        raise ConfigError(f"{name} is {far:.4g} mm away from the object's origin; give mm.")


def moved(
    pose: Float[np.ndarray, "4 4"], points: Float[np.ndarray, "*n 3"]
) -> Float[np.ndarray, "*n 3"]:
    """Turn points in the sensor's frame into the object's, mm."""
    return points @ pose[:3, :3].T + pose[:3, 3]


def turned(
    pose: Float[np.ndarray, "4 4"], vectors: Float[np.ndarray, "*n 3"]
) -> Float[np.ndarray, "*n 3"]:
    """Turn vectors (forces, say) in the sensor's frame into the object's."""
    return vectors @ pose[:3, :3].T


def read_poses(path: str | Path, *, growing: bool = False) -> Poses:
    """Read poses from a CSV file, with places in mm and quaternions.

    Columns are time_s, x_mm, y_mm, z_mm, qw, qx, qy, qz.

    Args:
        path: The file.
        growing: Whether lines are still added; then a last one without an end is left out.

    Raises:
        FileError: The file is missing or a line cannot be read.
        ConfigError: A pose cannot be used.
    """
    rows = list(read_rows(path, "table of poses", _QUATERNION, growing=growing))
    numbers = [[row.number(name) for name in _QUATERNION] for row in rows]
    table = np.array(numbers).reshape(-1, len(_QUATERNION))
    sizes = np.linalg.norm(table[:, 4:], axis=1)
    bad = np.flatnonzero(~(np.abs(sizes - 1.0) < 1e-2))
    if len(bad):
        raise FileError(
            f"{rows[bad[0]].location}: the quaternion has length {sizes[bad[0]]:.4g}, not 1; give"
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
