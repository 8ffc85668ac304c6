"""Rigid transforms over time, and the tree of frames that they form. Lengths in mm, times in s."""

import logging
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from tactorch.errors import FileError
from tactorch.sensor.poses import interpolate_poses

_log = logging.getLogger(__name__)
_MM_PER_M = 1e3
_QUATERNION_TOLERANCE = 1e-2
_SHOWN = 20  # frames that a message lists
_MOVES = 1e-9  # change of a transform, mm or of its rotation, that moves the frame
#: By which messages may be out of order, s; more is a clock that was set back.
MAX_BACK_S = 0.05
Poses = Float[np.ndarray, "n 4 4"]
Times = Float[np.ndarray, " n"]


def rigid(place: Any, turn: Any, what: str) -> Float[np.ndarray, "4 4"]:
    """Return the transform of a position (m) and a quaternion as a matrix, mm.

    Raises:
        FileError: They are not finite, or the quaternion has not length 1; names `what`.
    """
    position = np.array([place.x, place.y, place.z], dtype=np.float64)
    quaternion = np.array([turn.x, turn.y, turn.z, turn.w], dtype=np.float64)
    if not (np.isfinite(position).all() and np.isfinite(quaternion).all()):
        raise FileError(f"{what}: the pose is not finite; leave such messages out.")
    length = float(np.linalg.norm(quaternion))
    if abs(length - 1.0) > _QUATERNION_TOLERANCE:
        raise FileError(f"{what}: the quaternion has length {length:.4g}, not 1.")
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_quat(quaternion).as_matrix()
    matrix[:3, 3] = _MM_PER_M * position
    return matrix


def increasing(times: Times, what: str) -> tuple[Times, Int[np.ndarray, " k"]]:
    """Return increasing times without equal ones, and the indices of their messages.

    Raises:
        FileError: Times run back by more than messages that are out of order.
    """
    back = np.maximum.accumulate(times) - times
    if len(times) and back.max() > MAX_BACK_S:
        i = int(np.argmax(back > MAX_BACK_S))
        raise FileError(
            f"{what}: times run back by {back[i]:.3g} s after {times[i] + back[i]:.3f} s. Was the "
            "clock set, or a bag played again? Cut the bag there."
        )
    unique, first = np.unique(times, return_index=True)
    return unique, first


@dataclass(eq=False)
class Track:
    """One transform over time, sorted.

    Attributes:
        time_s: Times, s.
        poses: Transforms, mm.
        what: Name in messages.
        max_gap_s: Longest time between two poses that is interpolated, s.
        static: Whether the last transform applies at all times.
    """

    time_s: Float[np.ndarray, " n"]
    poses: Poses
    what: str
    max_gap_s: float
    static: bool = False

    def __post_init__(self) -> None:
        if self.static:
            return
        self.time_s, kept = increasing(self.time_s, self.what)
        self.poses = self.poses[kept]

    @property
    def begin_s(self) -> float:
        """First time with a transform."""
        return -np.inf if self.static else float(self.time_s[0])

    @property
    def end_s(self) -> float:
        """Last time with a transform."""
        return np.inf if self.static else float(self.time_s[-1])

    def at(self, times: Float[np.ndarray, " t"]) -> Float[np.ndarray, "t 4 4"]:
        """Interpolate at times within: linear translation, spherical linear rotation.

        Raises:
            FileError: A time is in a gap, or before or after all transforms.
        """
        if self.static:
            return np.tile(self.poses[-1], (len(times), 1, 1))
        outside = times[(times < self.begin_s) | (times > self.end_s)]
        if len(outside):
            raise FileError(
                f"{self.what} is known from {self.begin_s:.3f} to {self.end_s:.3f} s, and needed at"
                f" {outside[0]:.3f} s; cut the bag to the times of all transforms."
            )
        right = np.searchsorted(self.time_s, times)
        left = np.maximum(right - 1, 0)
        gaps = self.time_s[right] - self.time_s[left]
        inner = times != self.time_s[right]
        for i in np.flatnonzero((gaps > self.max_gap_s) & inner):
            raise FileError(
                f"{self.what} has no message from {self.time_s[left[i]]:.3f} to "
                f"{self.time_s[right[i]]:.3f} s; cut the bag there, or raise max_gap_s."
            )
        return interpolate_poses(times, self.time_s, self.poses)


@dataclass(frozen=True, eq=False)
class Chain:
    """Transform between two frames of a tree: up to a common frame, and down from it."""

    up: list[Track]
    down: list[Track]

    @property
    def begin_s(self) -> float:
        """First time with all transforms."""
        return max((track.begin_s for track in (*self.up, *self.down)), default=-np.inf)

    @property
    def end_s(self) -> float:
        """Last time with all transforms."""
        return min((track.end_s for track in (*self.up, *self.down)), default=np.inf)

    def at(self, times: Float[np.ndarray, " t"]) -> Float[np.ndarray, "t 4 4"]:
        """Return the transforms at times; see `Track.at`."""
        first = second = np.tile(np.eye(4), (len(times), 1, 1))
        for track in self.up:
            first = track.at(times) @ first
        for track in self.down:
            second = track.at(times) @ second
        inverse: np.ndarray = np.linalg.inv(first) @ second
        return inverse


@dataclass
class TransformTree:
    """Frames and the transforms from each to its parent, as messages state them."""

    source: str
    max_gap_s: float
    parents: dict[str, str] = field(default_factory=dict)
    # Times and poses by frame: of static transforms, and of others.
    _messages: dict[tuple[str, bool], list[tuple[float, np.ndarray]]] = field(default_factory=dict)

    def add(self, message: Any, time_s: float, *, static: bool) -> None:
        """Add a geometry_msgs/TransformStamped.

        Raises:
            FileError: The frame has another parent already, or the transform is not rigid.
        """
        parent, child = message.header.frame_id.lstrip("/"), message.child_frame_id.lstrip("/")
        if self.parents.setdefault(child, parent) != parent:
            raise FileError(
                f"bag '{self.source}': frame {child!r} has the parents {self.parents[child]!r} and "
                f"{parent!r}; leave one of the publishers out."
            )
        what = f"bag '{self.source}': transform of {child!r} at {time_s:.3f} s"
        pose = rigid(message.transform.translation, message.transform.rotation, what)
        self._messages.setdefault((child, static), []).append((time_s, pose))

    def between(self, frame: str, tool: str) -> Chain:
        """Return the transforms from the axes of `tool` to those of `frame`.

        Raises:
            FileError: A frame is unknown, or nothing connects them.
        """
        chains = [self._ancestors(name.lstrip("/")) for name in (frame, tool)]
        common = next((name for name in chains[1] if name in chains[0]), None)
        if common is None:
            raise FileError(
                f"bag '{self.source}': no transforms connect the frames {frame!r} and {tool!r}; "
                f"their roots are {chains[0][-1]!r} and {chains[1][-1]!r}."
            )
        up, down = (
            [self._track(name) for name in chain[: chain.index(common)]] for chain in chains
        )
        return Chain(up, down)

    def _ancestors(self, name: str) -> list[str]:
        known = sorted({*self.parents, *self.parents.values()})
        if name not in known:
            shown = ", ".join(known[:_SHOWN]) or "none"
            raise FileError(
                f"bag '{self.source}' has no transform of the frame {name!r}; its frames are "
                f"{shown}."
            )
        chain = [name]
        while chain[-1] in self.parents:
            chain.append(self.parents[chain[-1]])
            if len(chain) > len(known):
                raise FileError(f"bag '{self.source}': the frames above {name!r} form a loop.")
        return chain

    def _track(self, name: str) -> Track:
        """Return the transforms of a frame: the static one, unless others move it."""
        what = f"bag '{self.source}': transform of {name!r}"
        static, moving = (self._messages.get((name, kind), []) for kind in (True, False))
        poses = [pose for _, pose in moving or static]
        moves = not static or (bool(moving) and np.ptp(poses, axis=0).max() > _MOVES)
        if moves and static:
            _log.warning(
                "%s is in messages of a static topic (tf_static) and in %d of a moving one (tf), "
                "which are used.", what, len(moving),
            )  # fmt: skip
        used = moving if moves else static
        times, matrices = (np.array([message[i] for message in used]) for i in (0, 1))
        return Track(times, matrices, what, self.max_gap_s, not moves)
