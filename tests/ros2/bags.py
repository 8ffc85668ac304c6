"""Small bags for tests: messages, and a robot that palpates a half-space."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from tactorch.fem.contact.pressures import ball_force

STORE = get_typestore(Stores.ROS2_HUMBLE)
TYPES = STORE.types
START_S = 1_700_000_000.0
RADIUS, MODULUS, NOISE = 3.0, 0.05, 0.004
POSE, TF = "geometry_msgs/msg/PoseStamped", "tf2_msgs/msg/TFMessage"
WRENCH = "geometry_msgs/msg/WrenchStamped"
#: The tool points downwards, at a slant, and is turned about the vertical.
TOOL = Rotation.from_euler("xz", [155.0, 30.0], degrees=True)

Stamped = tuple[float, Any]


def header(time_s: float, frame: str) -> Any:
    ns = round((START_S + time_s) * 1e9)
    stamp = TYPES["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)
    return TYPES["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)


def vector(values: Sequence[float], kind: str = "Vector3") -> Any:
    x, y, z = (float(v) for v in values)
    return TYPES[f"geometry_msgs/msg/{kind}"](x=x, y=y, z=z)


def quaternion(turn: Rotation | Sequence[float]) -> Any:
    values = turn.as_quat() if isinstance(turn, Rotation) else turn
    x, y, z, w = (float(v) for v in values)
    return TYPES["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w)


def pose(time_s: float, place_mm: np.ndarray, turn: Any = TOOL, frame: str = "base") -> Stamped:
    place = vector(np.asarray(place_mm) / 1e3, "Point")
    inner = TYPES["geometry_msgs/msg/Pose"](position=place, orientation=quaternion(turn))
    return time_s, TYPES[POSE](header=header(time_s, frame), pose=inner)


def transform(
    time_s: float, parent: str, child: str, place_mm: Sequence[float], turn: Rotation
) -> Any:
    inner = TYPES["geometry_msgs/msg/Transform"](
        translation=vector(np.asarray(place_mm) / 1e3), rotation=quaternion(turn)
    )
    return TYPES["geometry_msgs/msg/TransformStamped"](
        header=header(time_s, parent), child_frame_id=child, transform=inner
    )


def wrench(time_s: float, force_n: np.ndarray, frame: str = "ft") -> Stamped:
    inner = TYPES["geometry_msgs/msg/Wrench"](force=vector(force_n), torque=vector((0, 0, 0)))
    return time_s, TYPES[WRENCH](header=header(time_s, frame), wrench=inner)


def write_bag(
    path: Path, topics: dict[str, tuple[str, list[Stamped]]], storage: str = "sqlite3"
) -> Path:
    """Write messages at the times they were received."""
    plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        rows = []
        for topic, (kind, messages) in topics.items():
            connection = writer.add_connection(topic, kind, typestore=STORE)
            rows += [(time_s, connection, kind, message) for time_s, message in messages]
        for time_s, connection, kind, message in sorted(rows, key=lambda row: row[0]):
            raw = STORE.serialize_cdr(message, kind)
            writer.write(connection, round((START_S + time_s) * 1e9), raw)
    return path


def height(x: Any, y: Any) -> Any:
    return 0.02 * x + 0.3 * np.sin(y / 8.0) - 40.0


@dataclass
class Robot:
    """A session: a ball is moved over places, pressed down, held, and lifted."""

    places: int = 4
    spacing_mm: float = 6.0
    depth_mm: float = 1.2
    pose_hz: float = 25.0
    wrench_hz: float = 100.0
    bias_n: tuple[float, float, float] = (0.3, -0.2, 1.5)
    seed: int = 0
    paths: list[tuple[float, np.ndarray]] = field(default_factory=list)

    def __post_init__(self) -> None:
        axis = self.spacing_mm * np.arange(self.places)
        time, speed = 0.0, 4.0
        points = [np.array([0.0, 0.0, -30.0])]
        times = [0.0]

        def move(to: np.ndarray, seconds: float | None = None) -> None:
            nonlocal time
            time += seconds or float(np.linalg.norm(to - points[-1])) / speed
            points.append(to)
            times.append(time)

        move(points[0], 1.0)
        for x in axis:
            for y in axis:
                z = height(x, y) + RADIUS
                move(np.array([x, y, z + 3.0]))
                move(np.array([x, y, z - self.depth_mm]))
                move(points[-1], 0.2)
                move(np.array([x, y, z + 3.0]))
        move(points[-1], 0.5)
        self.times, self.points = np.array(times), np.array(points)

    def centre(self, time_s: np.ndarray) -> np.ndarray:
        return np.column_stack([np.interp(time_s, self.times, p) for p in self.points.T])

    def force(self, centres: np.ndarray) -> np.ndarray:
        """Force of the ball at each of several places."""
        x, y, z = centres.T
        return MODULUS * ball_force(height(x, y) + RADIUS - z, RADIUS)

    def poses(self, offset_mm: Sequence[float] = (0.0, 0.0, 0.0)) -> list[tuple[float, np.ndarray]]:
        """Places of the tool, whose ball is at an offset in its axes."""
        time_s = np.arange(0.0, self.times[-1], 1.0 / self.pose_hz)
        shift = TOOL.apply(offset_mm)
        return [(float(t), c - shift) for t, c in zip(time_s, self.centre(time_s), strict=True)]

    def forces(self) -> list[tuple[float, np.ndarray]]:
        """Forces on the ball in the axes of the base, with noise and without offset.

        They are half as large while the ball is lifted.
        """
        rng = np.random.default_rng(self.seed)
        time_s = np.arange(0.007, self.times[-1] - 0.05, 1.0 / self.wrench_hz)
        centres = self.centre(time_s)
        lifted = self.centre(time_s + 0.01)[:, 2] > centres[:, 2] + 1e-6
        forces = NOISE * rng.standard_normal((len(time_s), 3))
        forces[:, 2] += np.where(lifted, 0.5, 1.0) * self.force(centres)
        return list(zip(time_s.tolist(), forces, strict=True))

    def wrenches(self, frame: str = "ft", sign: float = 1.0, fixed: bool = False) -> list[Stamped]:
        """Messages in the axes of the tool, with the offset of the sensor."""
        times, forces = zip(*self.forces(), strict=True)
        turned = np.array(forces) if fixed else TOOL.inv().apply(forces)
        rows = sign * turned + self.bias_n
        return [wrench(t, row, frame) for t, row in zip(times, rows, strict=True)]

    def topics(self) -> dict[str, tuple[str, list[Stamped]]]:
        return {
            "/tool_pose": (POSE, [pose(t, place) for t, place in self.poses()]),
            "/wrench": (WRENCH, self.wrenches()),
        }
