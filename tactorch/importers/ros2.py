"""Palpation recorded with ROS 2: poses of a tool with a ball, and wrenches of a force sensor.

| messages | what |
|---|---|
| geometry_msgs/PoseStamped, or tf2_msgs/TFMessage between two frames | pose of the tool |
| geometry_msgs/WrenchStamped | force, in the axes of its frame |

The forces keep their times, and poses are interpolated to them. The session begins without contact.
A press is found from the force (`tactorch.importers.sessions`), and becomes a probe of the
palpation (`tactorch.importers.palpation`). Normals are opposite to the motion.
"""

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from tactorch.config import option
from tactorch.errors import FileError
from tactorch.importers.palpation import PalpationSettings
from tactorch.importers.samples import Rows
from tactorch.importers.sessions import Detection, Session, split_presses
from tactorch.recording import Recording
from tactorch.ros2 import PoseTrack, WrenchTrack, open_bag, read_poses, read_wrenches

_log = logging.getLogger(__name__)
_MIN_COMMON = 20  # forces at times with poses
_FIXED = 1e-6  # change of a rotation that is none


@dataclass(frozen=True, kw_only=True)
class Ros2Options(Detection, PalpationSettings):
    """Read a palpation from a ROS 2 bag: poses of the tool, and wrenches of a force sensor."""

    pose_topic: str | None = option(
        None, "Topic of poses or transforms; null: the only one of poses, or /tf with tool_frame"
    )
    frame: str | None = option(None, "Frame of the object, of transforms; z points out of it")
    tool_frame: str | None = option(None, "Frame of the tool, of transforms")
    wrench_topic: str | None = option(None, "Topic of wrenches; null: the only one")
    wrench_axes: Literal["message", "tool", "fixed"] = option(
        "message", "Axes of the forces: by the frame of their messages, of the tool, or fixed"
    )
    ball_mm: tuple[float, float, float] = option(
        (0.0, 0.0, 0.0), "Centre of the ball in the frame of the tool", unit="mm"
    )
    max_gap_s: float = option(
        0.25, "Longest time between two messages that is interpolated", unit="s", gt=0
    )

    def __call__(self, *, path: str | Path) -> Recording:
        """Read a bag; see `import_ros2`."""
        if self.radius_mm is None:
            raise FileError(f"bag '{path}' does not state the radius of the ball; give radius_mm.")
        with open_bag(path) as bag:
            names = self.pose_topic, self.frame, self.tool_frame
            poses = read_poses(bag, *names, self.max_gap_s)
            wrenches = read_wrenches(bag, self.wrench_topic, self.max_gap_s)
        probe, samples = split_presses(self._session(poses, wrenches, str(path)), self, str(path))
        lines = [f"{time_s:.3f} s" for time_s in samples.time_s]
        labels = probe.astype(str)
        rows = Rows(labels, samples.centres_mm, samples.forces_n, lines, samples.time_s)
        return self.record(rows, path)

    def _session(self, poses: PoseTrack, wrenches: WrenchTrack, source: str) -> Session:
        """Return centres of the ball and forces at the times of the forces that have poses."""
        time_s = wrenches.time_s
        common = (time_s >= poses.begin_s) & (time_s <= poses.end_s)
        if common.sum() < _MIN_COMMON:
            raise FileError(
                f"bag '{source}': {common.sum()} forces have a pose: forces are from "
                f"{time_s[0]:.3f} to {time_s[-1]:.3f} s, poses from {poses.begin_s:.3f} to "
                f"{poses.end_s:.3f} s. Set their computers to one clock."
            )
        if not common.all():
            left = (~common).sum()
            _log.warning("bag '%s': %d forces without a pose are left out.", source, left)
        time_s, forces = time_s[common], wrenches.force_n[common]
        at = poses.at(time_s)
        rotations = self._axes(at, poses, wrenches, time_s)
        forces = np.einsum("nij,nj->ni", rotations, forces)
        centres = at[:, :3, :3] @ np.array(self.ball_mm) + at[:, :3, 3]
        return Session(time_s, centres, forces)

    def _axes(
        self,
        at: Float[np.ndarray, "n 4 4"],
        poses: PoseTrack,
        wrenches: WrenchTrack,
        time_s: Float[np.ndarray, " n"],
    ) -> Float[np.ndarray, "n 3 3"]:
        """Return the rotations from the axes of the forces to those of the poses."""
        if self.wrench_axes == "tool":
            return at[:, :3, :3]
        if self.wrench_axes == "fixed":
            return np.tile(np.eye(3), (len(time_s), 1, 1))
        if not wrenches.frame:
            raise FileError(
                "The forces are in the frame '', that is, in unknown axes; give"
                " format.wrench_axes=tool if they turn with the tool, or fixed if they do not."
            )
        try:
            rotations = poses.rotation_of(wrenches.frame, time_s)
        except FileError as error:
            raise FileError(f"{error} Or give format.wrench_axes=tool or fixed.") from error
        _log.info(
            "Forces are in the axes of the frame %r, which %s.", wrenches.frame,
            "are fixed" if np.ptp(rotations, axis=0).max() < _FIXED else "move with the tool",
        )  # fmt: skip
        return rotations


def import_ros2(path: str | Path, **options: Any) -> Recording:
    """Read a palpation from a ROS 2 bag (see the module's docstring).

    Args:
        path: The bag: a folder with metadata.yaml, or a file .mcap or .db3.
        options: Settings, see `Ros2Options`.

    Returns:
        A recording as of `import_palpation`.

    Raises:
        ConfigError: A setting is not valid, or rosbags is not installed.
        FileError: The bag cannot be used; names topic, frame or time, and remedy.
        MeshError: The surface or the mesh cannot be used.
        RecordingError: The bag does not make a valid recording.
    """
    return Ros2Options(**options)(path=path)
