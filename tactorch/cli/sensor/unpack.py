r"""`tactorch sensor unpack`: frames and poses of a ROS 2 bag into a folder, for record.

    tactorch sensor unpack bag=session.mcap out=session pose_topic=/robot/sensor_pose
    tactorch sensor unpack bag=session out=session image_topic=/gel/image_raw/compressed \
      frame=object tool_frame=gelsight
    tactorch sensor record ... frames=session/frames poses=session/poses.csv

The folder gets frames/ with an image per message and the times of all in times.csv, and poses.csv
with the pose of each frame. Frames without a pose are left out.
"""

from dataclasses import dataclass
from pathlib import Path

from tactorch.cli.console import log, progress
from tactorch.cli.settings import CommandOptions
from tactorch.config import option
from tactorch.errors import ConfigError
from tactorch.files import atomic_path
from tactorch.ros2 import open_bag, read_poses
from tactorch.ros2.images import unpack_frames


@dataclass(frozen=True, kw_only=True)
class UnpackOptions(CommandOptions):
    """Settings of the command."""

    bag: Path = option(help="Bag: a folder with metadata.yaml, or a file .mcap or .db3")
    out: Path = option(help="Folder to write, which must not exist yet")
    image_topic: str | None = option(None, "Topic of images; null: the only one")
    pose_topic: str | None = option(
        None, "Topic of poses or transforms; null: the only one of poses, or /tf with tool_frame"
    )
    frame: str | None = option(None, "Frame of the object, of transforms")
    tool_frame: str | None = option(None, "Frame of the sensor, of transforms")
    max_gap_s: float = option(
        0.25, "Longest time between two poses that is interpolated", unit="s", gt=0
    )


def run(options: UnpackOptions) -> Path:
    """Write frames and poses; returns the folder."""
    out = options.out
    if out.exists():
        raise ConfigError(f"out={out} is there already; choose another, or move it away.")
    with (
        atomic_path(out) as part,
        open_bag(options.bag) as bag,
        progress("unpacking", "messages") as update,
    ):
        poses = read_poses(
            bag, options.pose_topic, options.frame, options.tool_frame, options.max_gap_s
        )
        done = unpack_frames(bag, options.image_topic, poses, part, update)
    if done.without_pose:
        log.warning("%d frames without a pose are left out.", done.without_pose)
    if done.repeated:
        log.warning("%d frames with the time of an earlier one are left out.", done.repeated)
    log.info("%d frames: %s, poses: %s", done.frames, out / "frames", out / "poses.csv")
    return out
