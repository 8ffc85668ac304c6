"""Poses and wrenches over time, from the messages of a bag. Lengths in mm, forces in N.

ROS has metres; they are converted here. Times are since the begin of the bag, s.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from tactorch.errors import FileError
from tactorch.ros2.bag import Bag
from tactorch.ros2.transforms import Track, TransformTree, increasing, rigid

POSE, TRANSFORMS = "geometry_msgs/msg/PoseStamped", "tf2_msgs/msg/TFMessage"
WRENCH = "geometry_msgs/msg/WrenchStamped"
_STATIC = "tf_static"

Times = Float[np.ndarray, " n"]


@dataclass(frozen=True, eq=False)
class PoseTrack:
    """Pose of a frame in another one over time.

    Attributes:
        frame: Name of the frame that poses are in.
        begin_s: First time with a pose.
        end_s: Last time with a pose.
        at: Poses at times (n,) within, (n, 4, 4), mm; raises `FileError` in a gap.
        rotation_of: Rotations from the axes of a named frame to those of `frame` at times, (n, 3,
            3); raises `FileError` where the frame is unknown.
    """

    frame: str
    begin_s: float
    end_s: float
    at: Callable[[Times], np.ndarray]
    rotation_of: Callable[[str, Times], np.ndarray]


@dataclass(frozen=True, eq=False)
class WrenchTrack:
    """Measured forces over time.

    Attributes:
        time_s: Increasing times, s.
        force_n: Forces in the axes of `frame`, N.
        frame: Name of the frame in the messages; may be empty.
    """

    time_s: Float[np.ndarray, " n"]
    force_n: Float[np.ndarray, "n 3"]
    frame: str


def read_poses(
    bag: Bag, topic: str | None, frame: str | None, tool_frame: str | None, max_gap_s: float
) -> PoseTrack:
    """Read the poses of a tool.

    Args:
        bag: The bag.
        topic: Topic of poses, or of transforms; None for the only one of poses, or for /tf where
            `tool_frame` is given.
        frame: Frame that poses of transforms are in.
        tool_frame: Frame whose poses they are.
        max_gap_s: Longest time between two poses that is interpolated, s.

    Raises:
        FileError: There is no such topic; transforms do not connect the frames; a pose is not
            finite or no rotation; times run backwards; frames are given for poses, or those of
            one topic differ.
    """
    if topic is None and tool_frame is not None:
        topic = "/tf"
    topic = bag.choose(topic, (POSE, TRANSFORMS), "pose_topic")
    if bag.topics[topic] == POSE:
        if frame is not None or tool_frame is not None:
            raise FileError(
                f"bag '{bag.path}': {topic} has poses, which frame and tool_frame do not change; "
                "leave these out, or give a topic of transforms as pose_topic."
            )
        return _track_of_poses(bag, topic, max_gap_s)
    if frame is None or tool_frame is None:
        raise FileError(
            f"bag '{bag.path}': {topic} has transforms; give frame and tool_frame, "
            "the frames of the object and of the tool."
        )
    tree = TransformTree(str(bag.path), max_gap_s)
    static = [t for t, k in bag.topics.items() if k == TRANSFORMS and t.endswith(_STATIC)]
    for name in dict.fromkeys((topic, *static)):
        for received, message in bag.messages(name):
            for transform in message.transforms:
                time_s = bag.seconds(transform.header, received, name)
                tree.add(transform, time_s, static=name.endswith(_STATIC))
    between = tree.between(frame, tool_frame)

    def rotation_of(name: str, times: Times) -> np.ndarray:
        return tree.between(frame, name).at(times)[:, :3, :3]

    return PoseTrack(frame, between.begin_s, between.end_s, between.at, rotation_of)


def _track_of_poses(bag: Bag, topic: str, max_gap_s: float) -> PoseTrack:
    """Return the poses of a topic of poses; wrenches are in their frame, or turn with the tool."""
    times, poses, frame = [], [], ""
    for received, message in bag.messages(topic):
        time_s = bag.seconds(message.header, received, topic)
        place, turn = message.pose.position, message.pose.orientation
        poses.append(rigid(place, turn, f"bag '{bag.path}': {topic} at {time_s:.3f} s"))
        times.append(time_s)
        frame = _same_frame(frame, message, len(times), f"bag '{bag.path}': {topic}")
    track = Track(np.array(times), np.array(poses), f"bag '{bag.path}': {topic}", max_gap_s)

    def rotation_of(name: str, at: Times) -> np.ndarray:
        if name.lstrip("/") == frame.lstrip("/"):
            return np.tile(np.eye(3), (len(at), 1, 1))
        rotations: np.ndarray = track.at(at)[:, :3, :3]
        return rotations

    return PoseTrack(frame, track.begin_s, track.end_s, track.at, rotation_of)


def _same_frame(frame: str, message: Any, count: int, what: str) -> str:
    """Return the frame of a message, the number `count`; refuse another one than before."""
    new = str(message.header.frame_id)
    if count > 1 and new != frame:
        raise FileError(
            f"{what} has messages in the frames {frame!r} and {new!r}; leave one of the publishers "
            "out."
        )
    return new


def read_wrenches(bag: Bag, topic: str | None, max_gap_s: float) -> WrenchTrack:
    """Read the forces of a topic of wrenches.

    Raises:
        FileError: There is no such topic; a force is not finite; times run backwards, or have a
            gap.
    """
    topic = bag.choose(topic, (WRENCH,), "wrench_topic")
    what = f"bag '{bag.path}': {topic}"
    times, forces, frame = [], [], ""
    for received, message in bag.messages(topic):
        times.append(bag.seconds(message.header, received, topic))
        force = message.wrench.force
        forces.append((force.x, force.y, force.z))
        frame = _same_frame(frame, message, len(times), what)
    array = np.array(forces, dtype=np.float64)
    time_s, kept = increasing(np.array(times), what)
    array = array[kept]
    finite = np.isfinite(array).all(axis=1)
    if not finite.all():
        first = float(time_s[np.argmin(finite)])
        raise FileError(f"{what} has a force that is not finite at {first:.3f} s; leave it out.")
    for i in np.flatnonzero(np.diff(time_s) > max_gap_s):
        raise FileError(
            f"{what} has no message from {time_s[i]:.3f} to {time_s[i + 1]:.3f} s; cut the bag "
            "there, or raise max_gap_s."
        )
    return WrenchTrack(time_s, array, frame)
