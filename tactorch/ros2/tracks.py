"""Poses and wrenches over time, from the messages of a bag. Lengths in mm, forces in N.

ROS has metres; they are converted here. Times are since the begin of the bag, s.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from tactorch.errors import FileError
from tactorch.ros2.bag import Bag
from tactorch.ros2.transforms import Chain, Track, TransformTree, increasing, rigid

POSE, TRANSFORMS = "geometry_msgs/msg/PoseStamped", "tf2_msgs/msg/TFMessage"
WRENCH = "geometry_msgs/msg/WrenchStamped"
_STATIC = "tf_static"

Times = Float[np.ndarray, " n"]


@dataclass(frozen=True, eq=False)
class PoseTrack(Chain):
    """Pose of a frame in another one over time.

    Attributes:
        frame: Name of the frame that poses are in.
        rotation_of: Rotations from the axes of a named frame to those of `frame` at times, (n, 3,
            3); raises `FileError` where the frame is unknown.
    """

    frame: str
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

    return PoseTrack(between.up, between.down, frame, rotation_of)


def _track_of_poses(bag: Bag, topic: str, max_gap_s: float) -> PoseTrack:
    """Return the poses of a topic of poses; wrenches are in their frame, or turn with the tool."""
    what, poses, times = f"bag '{bag.path}': {topic}", [], []
    for time_s, message in _stamped(bag, topic):
        place, turn = message.pose.position, message.pose.orientation
        poses.append(rigid(place, turn, f"{what} at {time_s:.3f} s"))
        times.append(time_s)
    frame = str(message.header.frame_id)
    track = Track(np.array(times), np.array(poses), what, max_gap_s)

    def rotation_of(name: str, at: Times) -> np.ndarray:
        if name.lstrip("/") == frame.lstrip("/"):
            return np.tile(np.eye(3), (len(at), 1, 1))
        rotations: np.ndarray = track.at(at)[:, :3, :3]
        return rotations

    return PoseTrack([], [track], frame, rotation_of)


def _stamped(bag: Bag, topic: str) -> Iterator[tuple[float, Any]]:
    """Yield the messages of a topic with their times, s; refuse another frame than before."""
    frame = None
    for received, message in bag.messages(topic):
        new = str(message.header.frame_id)
        if new != (frame or new):
            raise FileError(
                f"bag '{bag.path}': {topic} has messages in the frames {frame!r} and {new!r}; leave"
                " one of the publishers out."
            )
        frame = new
        yield bag.seconds(message.header, received, topic), message


def read_wrenches(bag: Bag, topic: str | None, max_gap_s: float) -> WrenchTrack:
    """Read the forces of a topic of wrenches.

    Raises:
        FileError: There is no such topic; a force is not finite; times run backwards, or have a
            gap.
    """
    topic = bag.choose(topic, (WRENCH,), "wrench_topic")
    what = f"bag '{bag.path}': {topic}"
    times, forces = [], []
    for time_s, message in _stamped(bag, topic):
        force = message.wrench.force
        times.append(time_s)
        forces.append((force.x, force.y, force.z))
    array = np.array(forces, dtype=np.float64)
    at_s, kept = increasing(np.array(times), what)
    array = array[kept]
    for i in np.flatnonzero(~np.isfinite(array).all(axis=1)):
        raise FileError(f"{what} has a force that is not finite at {at_s[i]:.3f} s; leave it out.")
    for i in np.flatnonzero(np.diff(at_s) > max_gap_s):
        raise FileError(
            f"{what} has no message from {at_s[i]:.3f} to {at_s[i + 1]:.3f} s; cut the bag "
            "there, or raise max_gap_s."
        )
    return WrenchTrack(at_s, array, str(message.header.frame_id))
