"""Palpations from bags: poses or transforms, axes of forces, presses of a session; wrong bags."""

import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags")

from scipy.spatial.transform import Rotation

from tactorch.errors import ConfigError, TactorchError
from tactorch.fem.contact.pressures import ball_force
from tactorch.importers import import_ros2
from tactorch.importers.sessions import Detection, Session, split_presses
from tactorch.recording import Recording

from .bags import (
    MODULUS,
    POSE,
    RADIUS,
    START_S,
    STORE,
    TF,
    TOOL,
    WRENCH,
    Robot,
    height,
    pose,
    transform,
    wrench,
    write_bag,
)

ROBOT = Robot()
BLOCK = {"radius_mm": RADIUS, "depth_mm": 10.0, "margin_mm": 4.0, "edge_mm": 5.0}


def check(recording: Recording) -> None:
    """The presses are those of the robot: contacts, depths and forces."""
    assert {press.name for press in recording.presses} == {f"probe {n}" for n in range(1, 17)}
    depths, forces, above = [], [], []
    for press in recording.presses:
        assert press.probe is not None
        assert press.force is not None
        x, y, z = press.probe.position_mm
        above.append(min(abs(x - 6.0 * round(x / 6.0)), 9.0) + abs(y - 6.0 * round(y / 6.0)))
        depths.append(height(x, y) + RADIUS - z)
        forces.append(press.force.values[0])
    assert max(above) < 0.1
    expected = MODULUS * ball_force(np.array(depths), RADIUS)
    pressed = np.array(depths) > 0.2
    assert pressed.sum() >= 16
    np.testing.assert_allclose(np.array(forces)[pressed], expected[pressed], rtol=0.15, atol=0.01)
    # The last of four presses is the mean over a quarter of the depth of 1.2 mm.
    assert max(depths) == pytest.approx(1.2 - 1.2 / 8, abs=0.08)


@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
def test_poses_and_wrenches_become_presses(tmp_path: Path, storage: str) -> None:
    bag = write_bag(tmp_path / "bag", ROBOT.topics(), storage)
    recording = import_ros2(bag, **BLOCK)
    check(recording)
    assert recording.provenance["file"] == "bag"
    assert recording.provenance["tare_n"] == pytest.approx(0.0, abs=0.01)


def test_a_press_is_an_approach_and_ends_where_the_ball_is_deepest() -> None:
    rows = ROBOT.forces()
    time_s = np.array([t for t, _ in rows])
    forces = np.array([f for _, f in rows]) + ROBOT.bias_n
    session = Session(time_s, ROBOT.centre(time_s), forces)
    probe, samples = split_presses(session, Detection(approach_mm=1.5), "session")
    assert probe.max() == 16
    for number in range(1, 17):
        centres = samples.centres_mm[probe == number]
        assert (np.diff(centres[:, 2]) < 0.0).all()
        assert np.ptp(centres[:, :2], axis=0).max() < 0.02
        surface = height(*centres[0, :2]) + RADIUS
        assert surface - centres[-1, 2] == pytest.approx(1.2, abs=0.05)
        assert 0.5 < centres[0, 2] - surface < 1.5
    clear = samples.forces_n[samples.centres_mm[:, 2] > -36.5]
    np.testing.assert_allclose(clear.mean(axis=0), 0.0, atol=0.002)


@pytest.mark.parametrize("stop_s", [0.0, 30.0])
def test_a_stop_above_the_surface_takes_no_samples_from_the_press(stop_s: float) -> None:
    surface = height(0.0, 0.0) + RADIUS
    ends = np.cumsum([0.0, 1.0, 2.0, stop_s, 0.55, 0.2, 1.0])
    above = [10.0, 10.0, 1.0, 1.0, -1.2, -1.2, 3.0]
    time_s = np.arange(0.0, ends[-1], 0.01)
    centres = np.outer(surface + np.interp(time_s, ends, above), [0.0, 0.0, 1.0])
    noise = 0.004 * np.random.default_rng(0).standard_normal((len(time_s), 3))
    forces = noise + np.outer(ROBOT.force(centres), [0.0, 0.0, 1.0])
    _, samples = split_presses(Session(time_s, centres, forces), Detection(), "session")
    depths = surface - samples.centres_mm[:, 2]
    assert depths.max() == pytest.approx(1.2, abs=0.05)
    assert (depths > 0.0).sum() >= 20


def test_a_short_loss_of_contact_does_not_end_a_press() -> None:
    rows = ROBOT.forces()
    time_s = np.array([t for t, _ in rows])
    forces = np.array([f for _, f in rows])
    pressed = np.flatnonzero(forces[:, 2] > 0.1)
    forces[pressed[3:6]] = 0.0
    session = Session(time_s, ROBOT.centre(time_s), forces)
    assert split_presses(session, Detection(), "session")[0].max() == 16


def test_a_single_file_is_a_bag(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", ROBOT.topics(), "mcap")
    check(import_ros2(next(bag.glob("*.mcap")), **BLOCK))


def test_bags_of_ros_1_are_read_too(tmp_path: Path) -> None:
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    with Writer(tmp_path / "session.bag") as writer:
        rows = []
        for topic, (kind, messages) in ROBOT.topics().items():
            connection = writer.add_connection(topic, kind, typestore=store)
            rows += [(t, connection, kind, message) for t, message in messages]
        for t, connection, kind, message in sorted(rows, key=lambda row: row[0]):
            raw = STORE.cdr_to_ros1(STORE.serialize_cdr(message, kind), kind)
            writer.write(connection, round((START_S + t) * 1e9), raw)
    check(import_ros2(tmp_path / "session.bag", **BLOCK))


def test_transforms_are_chained(tmp_path: Path) -> None:
    """The object is turned and moved in the base; the ball is off the flange."""
    flange = np.array([5.0, -2.0, 40.0])
    table = Rotation.from_euler("z", 90.0, degrees=True)
    place = np.array([100.0, -50.0, 20.0])
    bend = Rotation.from_euler("x", 25.0, degrees=True)
    moving, message = [], TFMessage()
    for t, tool in ROBOT.poses(flange):
        # Of the sensor in the base: the tool is static on it.
        turn = table * TOOL * bend.inv()
        moving.append((t, message([transform(t, "base", "ft", table.apply(tool) + place, turn)])))
    static = [
        (0.0, message([transform(0.0, "base", "/object", place, table)])),
        (0.0, message([transform(0.0, "ft", "tool", (0.0, 0.0, 0.0), bend)])),
    ]
    forces = [
        wrench(t, bend.apply(TOOL.inv().apply(f)) + np.array(ROBOT.bias_n), "ft")
        for t, f in ROBOT.forces()
    ]
    bag = write_bag(
        tmp_path / "bag",
        {"/tf": (TF, moving), "/tf_static": (TF, static), "/ft/wrench": (WRENCH, forces)},
    )
    recording = import_ros2(bag, frame="object", tool_frame="tool", ball_mm=tuple(flange), **BLOCK)
    check(recording)
    with pytest.raises(TactorchError, match=r"give frame and tool_frame"):
        import_ros2(bag, pose_topic="/tf", **BLOCK)
    with pytest.raises(TactorchError, match=r"no transform of the frame 'probe'; its frames are"):
        import_ros2(bag, frame="object", tool_frame="probe", **BLOCK)
    unnamed = [(t, wrench(t, f, "")[1]) for t, f in ROBOT.forces()]
    topics = {"/tf": (TF, moving), "/tf_static": (TF, static), "/wrench": (WRENCH, unnamed)}
    bag = write_bag(tmp_path / "unnamed", topics)
    with pytest.raises(TactorchError, match=r"the frame ''.*give format\.wrench_axes"):
        import_ros2(bag, frame="object", tool_frame="tool", **BLOCK)


def test_forces_of_poses_without_a_frame_have_unknown_axes(tmp_path: Path) -> None:
    topics = ROBOT.topics()
    topics["/wrench"] = (WRENCH, ROBOT.wrenches(""))
    bag = write_bag(tmp_path / "bag", topics)
    with pytest.raises(TactorchError, match=r"the frame ''.*give format\.wrench_axes"):
        import_ros2(bag, **BLOCK)
    check(import_ros2(bag, wrench_axes="tool", **BLOCK))


def test_transforms_of_the_sensor_are_known_at_all_forces(tmp_path: Path) -> None:
    message = TFMessage()
    moves = [(t, message([transform(t, "base", "tool", p, TOOL)])) for t, p in ROBOT.poses()]
    later = [
        (t, message([transform(t, "base", "ft", p, TOOL)])) for t, p in ROBOT.poses() if t > 0.5
    ]
    topics = {"/tf": (TF, moves + later), "/wrench": (WRENCH, ROBOT.wrenches())}
    with pytest.raises(TactorchError, match=r"'ft' is known from 0\.520 to .* needed at 0\.007 s"):
        import_ros2(write_bag(tmp_path / "bag", topics), frame="base", tool_frame="tool", **BLOCK)


def test_a_static_transform_may_be_published_again(tmp_path: Path) -> None:
    message, same = TFMessage(), Rotation.identity()
    moves = [(t, message([transform(t, "base", "tool", p, TOOL)])) for t, p in ROBOT.poses()]
    static = [
        (t, message([transform(stamp, "tool", "ft", (0.0, 0.0, 0.0), turn)]))
        for t, stamp, turn in [(0.0, 0.5, TOOL), (1.0, 0.1, same)]
    ]
    topics = {"/tf": (TF, moves), "/tf_static": (TF, static), "/wrench": (WRENCH, ROBOT.wrenches())}
    check(
        import_ros2(write_bag(tmp_path / "bag", topics), frame="base", tool_frame="tool", **BLOCK)
    )


def TFMessage() -> Callable[[list[Any]], Any]:
    from .bags import TYPES

    return lambda transforms: TYPES[TF](transforms=transforms)


def test_forces_on_the_object_in_fixed_axes(tmp_path: Path) -> None:
    topics = ROBOT.topics()
    topics["/wrench"] = (WRENCH, ROBOT.wrenches("base", sign=-1.0, fixed=True))
    bag = write_bag(tmp_path / "bag", topics)
    check(import_ros2(bag, reverse_force=True, **BLOCK))
    topics["/wrench"] = (WRENCH, ROBOT.wrenches("other", fixed=True))
    bag = write_bag(tmp_path / "other", topics)
    check(import_ros2(bag, wrench_axes="fixed", **BLOCK))
    with pytest.raises(TactorchError, match="force rises"):
        import_ros2(bag, reverse_force=True, wrench_axes="fixed", **BLOCK)


def test_headers_without_times_take_those_of_reception(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    topics = ROBOT.topics()
    for _, messages in topics.values():
        for _, message in messages:
            message.header.stamp.sec = message.header.stamp.nanosec = 0
    with caplog.at_level(logging.WARNING):
        check(import_ros2(write_bag(tmp_path / "bag", topics), **BLOCK))
    assert caplog.text.count("messages of /wrench have no time") == 1


def test_forces_before_and_after_the_poses_are_left_out(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    topics = ROBOT.topics()
    kind, poses = topics["/tool_pose"]
    topics["/tool_pose"] = kind, poses[5:]
    with caplog.at_level(logging.WARNING):
        check(import_ros2(write_bag(tmp_path / "bag", topics), **BLOCK))
    assert "forces without a pose are left out" in caplog.text


Topics = dict[str, tuple[str, list[Any]]]


def changed(topic: str, change: Callable[[list[Any]], list[Any]]) -> Callable[[Topics], Topics]:
    def apply(topics: Topics) -> Topics:
        kind, messages = topics[topic]
        return {**topics, topic: (kind, change(messages))}

    return apply


def without(topic: str) -> Callable[[Topics], Topics]:
    return lambda topics: {name: value for name, value in topics.items() if name != topic}


def again(topic: str, name: str) -> Callable[[Topics], Topics]:
    return lambda topics: {**topics, name: topics[topic]}


def gap(messages: list[Any]) -> list[Any]:
    return [m for m in messages if not 4.0 < m[0] < 5.0]


def spoilt(index: int, change: Callable[[Any], object]) -> Callable[[list[Any]], list[Any]]:
    def apply(messages: list[Any]) -> list[Any]:
        change(messages[index][1])
        return messages

    return apply


def shifted(seconds: int) -> Callable[[list[Any]], list[Any]]:
    def apply(messages: list[Any]) -> list[Any]:
        for _, message in messages:
            message.header.stamp.sec += seconds
        return messages

    return apply


def back(messages: list[Any]) -> list[Any]:
    for _, message in messages[len(messages) // 2 :]:
        message.header.stamp.sec -= 3
    return messages


def nothing(message: Any) -> None:
    message.pose.orientation.w = message.pose.orientation.x = 0.0


def infinite(message: Any) -> None:
    message.wrench.force.z = float("nan")


def lost(message: Any) -> None:
    message.pose.position.x = float("inf")


def elsewhere(message: Any) -> None:
    message.header.frame_id = "world"


def still(messages: list[Any]) -> list[Any]:
    return [pose(t, np.array([0.0, 0.0, 0.0])) for t, _ in messages]


def in_contact(messages: list[Any]) -> list[Any]:
    return [m for m in messages if m[0] > 3.2]


BAD: dict[str, tuple[Callable[[Topics], Topics], dict[str, Any], str]] = {
    "no poses": (without("/tool_pose"), {}, "pose_topic is needed.*has none"),
    "no wrenches": (without("/wrench"), {}, "wrench_topic is needed.*has none"),
    "two topics": (again("/wrench", "/filtered"), {}, "several: /filtered, /wrench"),
    "no such topic": (lambda t: t, {"wrench_topic": "/ft"}, "no topic '/ft'.*its topics are"),
    "other type": (lambda t: t, {"wrench_topic": "/tool_pose"}, "is of geometry_msgs/msg/PoseSt"),
    "no message": (changed("/wrench", lambda m: []), {"wrench_topic": "/wrench"}, "no message"),
    "gap of forces": (changed("/wrench", gap), {}, r"/wrench has no message from 3\.\d+ to"),
    "gap of poses": (changed("/tool_pose", gap), {}, "/tool_pose has no message from.*max_gap_s"),
    "frame of poses": (lambda t: t, {"frame": "object"}, "frame and tool_frame do not change"),
    "frames of poses": (changed("/tool_pose", spoilt(9, elsewhere)), {}, "frames 'base' and 'wo"),
    "frames of forces": (changed("/wrench", spoilt(9, elsewhere)), {}, "frames 'ft' and 'world'"),
    "two clocks": (changed("/tool_pose", shifted(3600)), {}, "0 forces have a pose.*one clock"),
    "clock set back": (changed("/wrench", back), {}, "times run back by"),
    "no rotation": (changed("/tool_pose", spoilt(9, nothing)), {}, "quaternion has length"),
    "pose of infinity": (changed("/tool_pose", spoilt(9, lost)), {}, "pose is not finite"),
    "force of NaN": (changed("/wrench", spoilt(9, infinite)), {}, "force that is not finite at"),
    "no motion": (changed("/tool_pose", still), {}, "has no press"),
    "begins in contact": (changed("/wrench", in_contact), {}, "no contact is expected"),
    "no contact": (lambda t: t, {"contact_n": 50.0}, "has no press: the force changes by up to"),
    "no radius": (lambda t: t, {"radius_mm": None}, "give radius_mm"),
    "short rest": (lambda t: t, {"rest_s": 0.01}, "longer format.rest_s"),
    "forces that pull": (lambda t: t, {"reverse_force": True}, "force rises with depth"),
}


@pytest.mark.parametrize("fault", BAD)
def test_wrong_bags_are_refused(tmp_path: Path, fault: str) -> None:
    change, settings, message = BAD[fault]
    bag = write_bag(tmp_path / "bag", change(Robot(places=2).topics()))
    with pytest.raises(TactorchError, match=message) as error:
        import_ros2(bag, **{**BLOCK, **settings})
    assert "bag" in str(error.value)


def _folder(path: Path) -> Path:
    path.mkdir()
    return path


def _text(path: Path) -> Path:
    path.write_text("not a bag")
    return path


def _cut(path: Path) -> Path:
    bag = write_bag(path, Robot(places=1).topics(), "mcap")
    (file,) = bag.glob("*.mcap")
    file.write_bytes(file.read_bytes()[:3000])
    return bag


def _damaged(path: Path) -> Path:
    bag = write_bag(path, Robot(places=1).topics())
    (file,) = bag.glob("*.db3")
    content = bytearray(file.read_bytes())
    content[2000:9000] = b"\x07" * 7000
    file.write_bytes(content)
    return bag


def _metadata(path: Path) -> Path:
    bag = write_bag(path, Robot(places=1).topics())
    (bag / "metadata.yaml").write_text("rosbag2_bagfile_information: [1, 2]")
    return bag


def _no_file(path: Path) -> Path:
    bag = write_bag(path, Robot(places=1).topics())
    next(bag.glob("*.db3")).unlink()
    return bag


FILES = {
    "missing": (lambda p: p / "none", "bag not found"),
    "a folder": (lambda p: _folder(p / "bag"), "has no metadata.yaml"),
    "no bag": (lambda p: _text(p / "bag.mcap"), "cannot be read"),
    "text": (lambda p: _text(p / "bag.txt"), "cannot be read"),
    "cut short": (lambda p: _cut(p / "bag"), "cannot be read"),
    "damaged": (lambda p: _damaged(p / "bag"), "cannot be read"),
    "wrong metadata": (lambda p: _metadata(p / "bag"), "cannot be read as a bag"),
    "file missing": (lambda p: _no_file(p / "bag"), "cannot be read as a bag"),
    "empty": (lambda p: write_bag(p / "bag", {"/wrench": (WRENCH, [])}), "has no message"),
}


@pytest.mark.parametrize("fault", FILES)
def test_files_that_are_no_bags_are_refused(tmp_path: Path, fault: str) -> None:
    make, message = FILES[fault]
    path = make(tmp_path)
    with pytest.raises(TactorchError, match=message):
        import_ros2(path, **BLOCK)


def test_a_missing_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import importlib.util

    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ConfigError, match=r"tactorch\[ros\]"):
        import_ros2(tmp_path, **BLOCK)


def test_a_frame_with_two_parents_is_refused(tmp_path: Path) -> None:
    message = TFMessage()
    same = Rotation.identity()
    moves = [
        (0.1, message([transform(0.1, "base", "tool", (0, 0, 0), same)])),
        (0.2, message([transform(0.2, "world", "tool", (0, 0, 0), same)])),
    ]
    topics = {"/tf": (TF, moves), "/wrench": (WRENCH, ROBOT.wrenches()[:10])}
    with pytest.raises(TactorchError, match="'tool' has the parents 'base' and 'world'"):
        import_ros2(write_bag(tmp_path / "bag", topics), frame="base", tool_frame="tool", **BLOCK)
    loop = [
        (0.1, message([transform(0.1, "a", "b", (0, 0, 0), same)])),
        (0.2, message([transform(0.2, "b", "a", (0, 0, 0), same)])),
    ]
    topics["/tf"] = (TF, loop)
    with pytest.raises(TactorchError, match="form a loop"):
        import_ros2(write_bag(tmp_path / "loop", topics), frame="a", tool_frame="b", **BLOCK)
    apart = [
        (0.1, message([transform(0.1, "a", "b", (0, 0, 0), same)])),
        (0.2, message([transform(0.2, "c", "d", (0, 0, 0), same)])),
    ]
    topics["/tf"] = (TF, apart)
    with pytest.raises(TactorchError, match="no transforms connect the frames 'b' and 'd'"):
        import_ros2(write_bag(tmp_path / "apart", topics), frame="b", tool_frame="d", **BLOCK)


def test_poses_are_of_one_kind(tmp_path: Path) -> None:
    topics = {**ROBOT.topics(), "/other": (POSE, [pose(0.0, np.zeros(3))])}
    with pytest.raises(TactorchError, match=r"pose_topic is needed.*several"):
        import_ros2(write_bag(tmp_path / "bag", topics), **BLOCK)
    check(import_ros2(tmp_path / "bag", pose_topic="/tool_pose", **BLOCK))


def test_a_moving_frame_may_be_published_as_static_too(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    message = TFMessage()
    moves = [(t, message([transform(t, "base", "tool", p, TOOL)])) for t, p in ROBOT.poses()]
    same = [
        (t, message([transform(t, "tool", "ft", (0.0, 0.0, 0.0), Rotation.identity())]))
        for t, _ in ROBOT.poses()[:5]
    ]
    static = [(0.0, moves[0][1]), (0.0, same[0][1])]
    topics = {"/tf": (TF, moves + same), "/tf_static": (TF, static)}
    topics["/wrench"] = (WRENCH, ROBOT.wrenches())
    with caplog.at_level(logging.WARNING):
        check(
            import_ros2(write_bag(tmp_path / "b", topics), frame="base", tool_frame="tool", **BLOCK)
        )
    assert "transform of 'tool' is in messages of a static topic" in caplog.text
    assert "transform of 'ft'" not in caplog.text
