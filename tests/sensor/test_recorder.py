"""A session of frames and poses becomes a recording: the presses that were made.

The gel's motion is that of one simulation of gel and cube, so its presses are known.
"""

import logging
import tracemalloc
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from tactorch.errors import ConfigError
from tactorch.mesh import TetMesh, box_mesh
from tactorch.recording import MaterialSpec
from tactorch.sensor.chain import ChainOptions, Measurement, SensorChain
from tactorch.sensor.depth import HeightMap
from tactorch.sensor.description import GelLayer, SensorDescription
from tactorch.sensor.frames import Frame
from tactorch.sensor.gel import EdgeDistance, GelContact, GelModel
from tactorch.sensor.poses import Poses
from tactorch.sensor.recorder import Fixture, RecordOptions, VirtualCube, record, record_streaming
from tactorch.sensor.recorder.detector import ContactDetector, ContactInterval
from tactorch.sensor.recorder.press_builder import (
    axial_gap,
    first_pose_by_depth,
    first_pose_by_shape,
    opposite_nodes,
    sample_surface,
)

from .gel_on_cube import FIRST, GEL, Pair, pressed, sensor_pose

SPEC = MaterialSpec("neo_hookean", 0.45)
DEPTHS = (0.2, 0.4)  # mm, that are simulated
# Sensor's way over time, s: down until 0.4 s before the end of each contact; touch is at z = 10.
TIMES = np.arange(0.0, 1.01, 0.1)
HEIGHTS = np.array([10.3, 10.2, 10.1, 9.8, 9.6, 9.8, 10.2, 10.3, 9.8, 9.6, 10.3])
STILL = np.zeros((8, 8, 3), dtype=np.uint8)


class Chain(SensorChain):
    """Sees what was simulated, in place of images."""

    def __init__(self, pairs: dict[float, Pair], noise_px: float = 0.0) -> None:
        self.pairs, self.model = pairs, next(iter(pairs.values())).model
        self.sensor = SensorDescription("seeing", (8, 8), (1.0, 1.0), GEL)
        self.options = ChainOptions()
        self.tracker = SimpleNamespace(reference_px=np.array([(1.0, 1.0), (2.0, 2.0)]))
        self.noise_px, self.rng = noise_px, np.random.default_rng(0)

    def measure_deformation(self, frame: Frame) -> Measurement:
        none = np.zeros(len(self.model.points), dtype=bool)
        if frame.image is None:
            unseen = np.full((2, 2), np.nan)
            return Measurement(frame, unseen, none)
        depth = self._depth(frame)
        here = self.tracker.reference_px + self.noise_px * self.rng.normal(size=(2, 2))
        flat = np.full((8, 8), -depth)
        height = HeightMap(flat, flat - flat.mean(), flat == 0, flat < 0)
        if depth <= 0:
            return Measurement(frame, here, none, height, depth, 0.0)
        return Measurement(frame, here, ~none, height, depth, 0.0, self.pairs[depth].u_gel)

    def solve_contact(
        self, measurement: Measurement, outline: EdgeDistance | None = None
    ) -> GelContact | None:
        if measurement.displacement is None:
            return None
        return _forces(self.model, measurement.displacement.tobytes())

    def _depth(self, frame: Frame) -> float:
        return max(0.0, round(10.0 - HEIGHTS[frame.index], 6))


@cache
def _forces(model: GelModel, moved: bytes) -> GelContact:
    return model.forces(np.frombuffer(moved).reshape(-1, 3))


@pytest.fixture(scope="module")
def pairs() -> dict[float, Pair]:
    return {depth: pressed(depth) for depth in DEPTHS}


@pytest.fixture
def poses() -> Poses:
    return Poses(TIMES, np.stack([sensor_pose(z) for z in HEIGHTS]))


def ball_mesh(radius_mm: float) -> TetMesh:
    """A cube's cells, moved outward onto a ball."""
    cube = box_mesh(2.0, 12, center_mm=(0.0, 0.0, 0.0))
    reach = np.abs(cube.points).max(axis=1, keepdims=True)
    away = np.maximum(np.linalg.norm(cube.points, axis=1, keepdims=True), 1e-9)
    return TetMesh.create(radius_mm * cube.points * reach / away, cube.tets)


def frames(**changes: object) -> list[Frame]:
    fields = {"image": STILL, "fault": "", "usable": True}
    return [
        Frame(i, f"{i:03d}.png", time_s=float(t), **{**fields, **changes})
        for i, t in enumerate(TIMES)
    ]


def test_presses_are_those_that_were_made(pairs: dict[float, Pair], poses: Poses) -> None:
    told: list[tuple[str, int, int | None]] = []
    cube = pairs[0.2].cube
    recording, measurements, contacts = record(
        frames(), Chain(pairs), poses, cube, SPEC, RecordOptions(steps=2),
        progress=lambda *all_: told.append(all_),
    )  # fmt: skip
    presses = recording.presses
    assert [m.frame.name for m in measurements] == [frame.name for frame in frames()]
    assert all(m.frame.image is None and m.height is None for m in measurements)
    assert [m.depth_mm for m in measurements[3:6]] == pytest.approx([0.2, 0.4, 0.2])
    assert [[m.frame.index for m in contact.measurements] for contact in contacts] == [
        [3, 4, 5], [8, 9],
    ]  # fmt: skip
    assert [p.name for p in presses] == [
        "contact 1, 003.png", "contact 1, 004.png", "contact 2, 008.png", "contact 2, 009.png",
    ]  # fmt: skip
    assert [p.step for p in presses] == [0, 1, 0, 1]
    for press, depth in zip(presses, (0.2, 0.4, 0.2, 0.4), strict=True):
        pair = pairs[depth]
        np.testing.assert_allclose(press.forces, pair.on_cube, atol=1e-6)
        seen = press.observed.all(axis=1)
        assert seen[cube.points[:, 2] > 9.999].mean() > 0.95
        np.testing.assert_allclose(press.displacement[seen], pair.u_cube[seen], atol=1e-6)
        np.testing.assert_array_equal(press.fixed, np.repeat(pair.bottom[:, :1], 3, axis=1))
        assert press.noise_mm == pytest.approx(0.01)  # what the chain allows for
        assert press.gel is not None
        np.testing.assert_allclose(press.gel.first_pose, FIRST, atol=1e-6)
        np.testing.assert_allclose(press.gel.pose, sensor_pose(10.0 - depth), atol=1e-6)
    assert told[-1] == ("presses", 4, 4)
    assert ("frames", 11, None) in told
    notes = recording.provenance
    assert notes["sensor"] == "seeing"
    assert notes["frames"] == 11
    assert [row["frame"] for row in notes["presses"]] == [p.name[-7:] for p in presses]
    assert notes["presses"][1]["depth_mm"] == pytest.approx(0.4)
    assert notes["presses"][1]["force_n"] == pytest.approx(pairs[0.4].on_cube.sum(axis=0), abs=1e-6)


def test_markers_are_recorded_where_the_gel_sticks_to_a_known_object(
    pairs: dict[float, Pair], poses: Poses
) -> None:
    chain, cube = Chain(pairs), pairs[0.2].cube
    measure = chain.measure_deformation

    def moved(frame: Frame) -> Measurement:
        """The first marker moves by half a pixel, and the second one is not seen."""
        found = measure(frame)
        shown = np.add(chain.tracker.reference_px, [(0.5, 0.0), (np.nan, np.nan)])
        return replace(found, markers_px=shown) if found.depth_mm > 0 else found

    chain.measure_deformation = moved  # type: ignore[method-assign]
    options = RecordOptions(steps=1, gel_deviation=0.1, pose_mm=0.2, pose_deg=0.5)
    press, *_ = record(frames(), chain, poses, cube, SPEC, options)[0].presses
    assert press.gel is not None
    np.testing.assert_allclose(press.gel.markers_mm, chain.sensor.to_mm(np.array([(1.0, 1.0)])))
    np.testing.assert_allclose(press.gel.displacement_mm, [(0.5, 0.0)], atol=1e-12)
    # Noise, which no frame without contact shows here, and 0.5 % of the displacement.
    noise = chain.options.marker_noise_mm
    assert press.gel.deviations_mm == pytest.approx(np.hypot(noise, 0.0025))
    assert press.gel.uncertain == pytest.approx([0.1, 0.2, np.deg2rad(0.5)])
    assert GelLayer.of_numbers(press.gel.layer, GEL.material) == GEL
    for target, changes in ((cube, {"friction": 0.5}), (VirtualCube(8.0, 4.0, 1.0), {})):
        other = replace(options, **changes)
        press, *_ = record(frames(), chain, poses, target, SPEC, other)[0].presses
        assert press.gel is None


def test_markers_move_from_where_they_are_in_frames_without_contact(
    pairs: dict[float, Pair], poses: Poses
) -> None:
    """The median of these frames leaves out one in which the contact has begun already."""
    chain, shifts = Chain(pairs), {0: 0.1, 1: 0.12, 2: 0.9, 6: 0.14, 7: 0.14}
    measure = chain.measure_deformation

    def moved(frame: Frame) -> Measurement:
        shown = np.add(chain.tracker.reference_px, [(shifts.get(frame.index, 0.5), 0), (0, np.nan)])
        return replace(measure(frame), markers_px=shown)

    chain.measure_deformation = moved  # type: ignore[method-assign]
    first, second = ContactDetector(chain).detect(frames())
    np.testing.assert_allclose(first.rest_mm, [(0.12, 0.0), (0.0, 0.0)])
    np.testing.assert_allclose(second.rest_mm, [(0.14, 0.0), (0.0, 0.0)])
    presses = record(frames(), chain, poses, pairs[0.2].cube, SPEC, RecordOptions(steps=1))[0]
    shown = [press.gel.displacement_mm for press in presses.presses]
    np.testing.assert_allclose(shown, [[(0.38, 0.0)], [(0.36, 0.0)]], atol=1e-12)


def test_contacts_come_as_they_end_and_are_those_of_the_whole_session(
    pairs: dict[float, Pair], poses: Poses
) -> None:
    cube, options = pairs[0.2].cube, RecordOptions(steps=2)
    whole = record(frames(), Chain(pairs), poses, cube, SPEC, options)[0].presses
    seen: list[int] = []

    def coming() -> Iterator[Frame]:
        for frame in frames():
            seen.append(frame.index)
            yield frame

    late = iter([Poses(poses.time_s[:3], poses.T_object_sensor[:3]), poses, poses])
    grown = record_streaming(coming(), Chain(pairs), lambda: next(late), cube, SPEC, options)
    first = next(grown)
    assert seen == list(range(7))  # frame 6 is the first one without contact again
    second = next(grown)
    assert next(grown, None) is None
    assert next(late, None) is None
    for one, other in zip((*first.presses, *second.presses), whole, strict=True):
        assert (one.name, one.step) == (other.name, other.step)
        np.testing.assert_array_equal(one.displacement, other.displacement)
        np.testing.assert_array_equal(one.forces, other.forces)


def test_a_contact_whose_poses_stay_away_is_skipped(
    pairs: dict[float, Pair], poses: Poses, caplog: pytest.LogCaptureFixture
) -> None:
    short = Poses(poses.time_s[:8], poses.T_object_sensor[:8])
    cube, options = pairs[0.2].cube, RecordOptions(steps=1)
    found = list(
        record_streaming(
            frames(), Chain(pairs), lambda: short, cube, SPEC, options, poses_timeout_s=0.0
        )
    )
    assert [p.name for one in found for p in one.presses] == ["contact 1, 004.png"]
    assert "Contact 2 is skipped: 2 of 2 frames have no pose" in caplog.text


def test_steps_are_even_in_depth(pairs: dict[float, Pair], poses: Poses) -> None:
    cube = pairs[0.2].cube
    one, *_ = record(frames(), Chain(pairs), poses, cube, SPEC, RecordOptions(steps=1))
    assert [p.name for p in one.presses] == ["contact 1, 004.png", "contact 2, 009.png"]
    many, *_ = record(frames(), Chain(pairs), poses, cube, SPEC, RecordOptions(steps=9))
    assert len(many.presses) == 4  # what is released again is no new step
    long = RecordOptions(steps=1, min_frames=3)
    assert len(record(frames(), Chain(pairs), poses, cube, SPEC, long)[0].presses) == 1


def test_faulty_frames_do_not_count(pairs: dict[float, Pair], poses: Poses) -> None:
    session = frames()
    bad = Frame(4, "004.png", STILL, 0.4, "dark: 10% of the reference's brightness", usable=False)
    session[4] = bad
    session[9] = Frame(9, "009.png", None, 0.9, "cannot be read", usable=False)
    dropped = Frame(3, "003.png", STILL, 0.3, "2 frames were dropped before it")
    session[3] = dropped
    found, *_ = record(session, Chain(pairs), poses, pairs[0.2].cube, SPEC, RecordOptions(steps=1))
    assert [p.name for p in found.presses] == ["contact 1, 003.png", "contact 2, 008.png"]
    faults = found.provenance["faulty frames"]
    assert list(faults) == ["003.png", "004.png", "009.png"]
    assert faults["004.png"].startswith("dark")


def test_noise_is_what_frames_without_contact_show(pairs: dict[float, Pair], poses: Poses) -> None:
    found = ContactDetector(Chain(pairs, noise_px=0.05))
    assert len(list(found.detect(frames()))) == 2
    assert found.noise_mm == pytest.approx(0.05, rel=0.4)  # 24 numbers
    cube = pairs[0.2].cube
    press = record(frames(), Chain(pairs, 0.05), poses, cube, SPEC)[0].presses[0]
    assert press.noise_mm == pytest.approx(found.noise_mm)
    given = RecordOptions(press_noise_mm=0.02)
    press = record(frames(), Chain(pairs, 0.05), poses, cube, SPEC, given)[0].presses[0]
    assert press.noise_mm == 0.02


def test_first_touch_is_where_the_shapes_meet() -> None:
    cube, gel = box_mesh(10.0, 3), GEL
    poses = Poses(TIMES, np.stack([sensor_pose(z) for z in HEIGHTS]))
    np.testing.assert_allclose(first_pose_by_shape(poses, 0.2, 0.3, cube, gel), FIRST, atol=1e-6)
    # The last frame without contact may be one in which contact was not seen yet.
    np.testing.assert_allclose(
        first_pose_by_shape(poses, 0.25, 0.3, cube, gel)[2, 3], 10.0, atol=1e-6
    )
    # Where nothing is known of the way, straight back.
    np.testing.assert_allclose(first_pose_by_shape(poses, None, 0.4, cube, gel), FIRST, atol=1e-9)


def test_first_touch_on_the_way_along_the_face() -> None:
    """A sensor that slides down sideways meets the object beside where it presses in the end."""
    ways = np.stack([sensor_pose(z) for z in (10.5, 9.5)])
    ways[:, 0, 3] = (4.0, 6.0)
    found = first_pose_by_shape(Poses(np.array([0.0, 1.0]), ways), 0.0, 1.0, box_mesh(10.0, 3), GEL)
    np.testing.assert_allclose(found[:3, 3], (5.0, 5.0, 10.0), atol=1e-6)


def test_gap_of_a_curved_gel_on_a_ball() -> None:
    """Two spheres meet at their poles; elsewhere their sagittas keep them apart."""
    ball = ball_mesh(6.0)
    gel = GelLayer(5.0, 0.12, 0.45, radius_mm=6.0, curvature_radius_mm=20.0)
    above = sensor_pose(7.5)
    above[:2, 3] = 0.0
    points, normals = sample_surface(ball)
    assert axial_gap(above, points, normals, gel) == pytest.approx(1.5, abs=0.1)
    # Beside it by 2 mm: the least of both sagittas, 2 mm shared as 6 : 20 between them.
    beside = above.copy()
    beside[0, 3] = 2.0
    x = np.linspace(-3, 3, 601)
    apart = 7.5 + (20 - np.sqrt(400 - (x - 2) ** 2)) - np.sqrt(36 - x**2)
    assert axial_gap(beside, points, normals, gel) == pytest.approx(apart.min(), abs=0.1)
    away = above.copy()
    away[0, 3] = 40.0
    assert axial_gap(away, points, normals, gel) == np.inf


def test_poses_that_do_not_fit_the_images_are_told(caplog: pytest.LogCaptureFixture) -> None:
    high = Poses(np.array([0.0, 1.0]), np.stack([sensor_pose(12.0), sensor_pose(11.5)]))
    with caplog.at_level(logging.WARNING):
        found = first_pose_by_shape(high, 0.0, 1.0, box_mesh(10.0, 3), GEL)
    assert "1.50 mm apart: check T_object_sensor" in caplog.text
    np.testing.assert_allclose(found, sensor_pose(11.5))


def test_first_touch_by_depth() -> None:
    poses = Poses(np.array([0.0, 1.0]), np.stack([sensor_pose(10.5), sensor_pose(9.5)]))
    times, depths = np.array([0.7, 0.9]), np.array([0.1, 0.2])  # half of the way goes to the gel
    np.testing.assert_allclose(first_pose_by_depth(poses, 0.4, times, depths), FIRST, atol=1e-9)
    # Not before the last frame without contact, nor by depths that do not grow.
    assert first_pose_by_depth(poses, 0.6, times, depths)[2, 3] == pytest.approx(9.9)
    assert first_pose_by_depth(poses, 0.4, times, depths[::-1])[2, 3] == pytest.approx(9.95)


def test_a_virtual_cube_moves_with_the_sensor_where_untouched(
    pairs: dict[float, Pair], poses: Poses
) -> None:
    chain = Chain(pairs)
    touched = chain.model.points[:, 1] < 0.1  # along the object's x
    whole = chain.measure_deformation

    def half(frame: Frame) -> Measurement:
        measurement = whole(frame)
        return replace(measurement, in_contact=measurement.in_contact & touched)

    chain.measure_deformation = half  # type: ignore[method-assign]
    cube = VirtualCube(8.0, 6.0, 1.0)
    found = record(frames(), chain, poses, cube, SPEC, RecordOptions(steps=1))[0]
    low, high = found.mesh.bounds
    # Under the middle of what is touched, from the height of first touch downward.
    begin = found.presses[0].displacement
    middle = chain.model.points[touched].mean(axis=0)
    np.testing.assert_allclose(low + high, 2 * np.array((5 + middle[1], 5.0, high[2] - 3)), atol=1)
    np.testing.assert_allclose(high - low, (8, 8, 6), atol=1e-9)
    assert high[2] == pytest.approx(10.0, abs=0.11)
    press = found.presses[0]
    free = press.observed.all(axis=1) & (found.mesh.points[:, 0] > 5.8)
    assert free.sum() >= 9
    np.testing.assert_allclose(begin[free, 2], 9.6 - high[2], atol=1e-9)
    assert not press.forces[found.mesh.points[:, 0] > 6.1].any()
    assert press.fixed[np.isclose(found.mesh.points[:, 2], low[2])].all()


def test_what_holds_the_object() -> None:
    cube = box_mesh(10.0, 2)
    down = np.array([0.0, 0.0, -1.0])
    fixed = Fixture().supports(cube, down)["fixed"]
    np.testing.assert_array_equal(fixed.all(axis=1), cube.points[:, 2] == 0)
    springs = Fixture("x-", "springs", 2.5).supports(cube, down)["springs"]
    assert set(np.unique(springs)) == {0.0, 2.5}
    np.testing.assert_array_equal(springs.any(axis=1), cube.points[:, 0] == 0)
    with pytest.raises(ConfigError, match="no flat side opposite to a press along"):
        opposite_nodes(ball_mesh(5.0), np.array([0.6, 0.0, -0.8]))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Fixture("under"), "held_side='under': give opposite, x-"),
        (lambda: Fixture(held_by="glued"), "held_by='glued': give fixed or springs"),
        (lambda: Fixture(spring_n_per_mm=0), "spring_n_per_mm"),
        (lambda: RecordOptions(steps=0), "steps=0: give a whole number, at least 1"),
        (lambda: RecordOptions(min_frames=0), "min_frames=0: give a whole number, at least 1"),
        (lambda: RecordOptions(first_contact="feel"), "first_contact='feel': give shape or depth"),
        (lambda: RecordOptions(press_noise_mm=-1.0), "press_noise_mm"),
        (lambda: VirtualCube(10.0, edge_mm=6.0), "edge_mm=6 is more than half the region of 10"),
        (lambda: VirtualCube(10.0, edge_mm=0.1), "edge_mm=0.1 makes 6000000 elements"),
        (lambda: VirtualCube(-1.0), "side_mm"),
    ],
)
def test_settings_that_cannot_be(make: object, message: str) -> None:
    assert callable(make)
    with pytest.raises(ConfigError, match=message):
        make()


def test_sessions_without_a_press(pairs: dict[float, Pair], poses: Poses) -> None:
    chain, cube = Chain(pairs), pairs[0.2].cube
    with pytest.raises(ConfigError, match=r"none of 3 frames shows contact: .* by 0 mm at most"):
        record(frames()[:3], chain, poses, cube, SPEC)
    with pytest.raises(ConfigError, match="none of 0 frames"):
        record([], chain, poses, cube, SPEC)
    dark = frames(usable=False, fault="dark")
    with pytest.raises(ConfigError, match="none of 11 frames, 11 of them faulty, shows contact"):
        record(dark, chain, poses, cube, SPEC)
    timeless = [Frame(i, f"{i}.png", STILL, None) for i in range(4)]
    with pytest.raises(ConfigError, match=r"frame '0.png' has no time.*frame_rate_hz"):
        record(timeless, chain, poses, cube, SPEC)
    short = Poses(TIMES[:4], poses.T_object_sensor[:4])
    with pytest.raises(ConfigError, match="2 of 2 frames have no pose"):
        record(frames()[7:], chain, short, cube, SPEC)
    beside = TetMesh(cube.points + np.array((100.0, 0, 0)), cube.tets)
    with pytest.raises(
        ConfigError, match=r"no frame with contact became a press; '003.png': the gel is over no"
    ):
        record(frames(), chain, poses, beside, SPEC)


def test_the_model_is_that_of_the_pair(pairs: dict[float, Pair]) -> None:
    """Else the exact comparison above would compare something else."""
    assert isinstance(pairs[0.2].model, GelModel)
    assert pairs[0.2].on_cube.sum(axis=0)[2] < -0.2


# ---------------------------------------------------------------- memory


def measurement(index: int, depth_mm: float, nodes: int = 4) -> Measurement:
    frame = Frame(index, f"{index}", None, 0.1 * index)
    moved, touched = np.full((nodes, 3), depth_mm), np.ones(nodes, dtype=bool)
    return Measurement(frame, np.zeros((2, 2)), touched, None, depth_mm, 0.0, moved)


def test_a_long_contact_keeps_frames_evenly_in_depth() -> None:
    depths = 0.5 + 0.5 * np.sin(np.linspace(-np.pi / 2, np.pi, 3000))
    contact, all_of_it = ContactInterval(0.0, max_candidates=60), ContactInterval(0.0, 10_000)
    for index, depth in enumerate(depths):
        contact.append(measurement(index, float(depth)))
        all_of_it.append(measurement(index, float(depth)))
    stored = [m for m in contact.measurements if m.displacement is not None]
    assert 30 < len(stored) <= 60
    assert len(contact.measurements) == 3000
    np.testing.assert_array_equal(contact.depths_mm, depths)
    chosen, ideal = contact.select_frames(4), all_of_it.select_frames(4)
    assert chosen[-1] == ideal[-1] == int(np.argmax(depths))
    np.testing.assert_allclose(depths[chosen], depths[ideal], atol=0.03)
    assert all(contact.measurements[i].displacement is not None for i in chosen)
    contact.keep(chosen)
    kept = [m.frame.index for m in contact.measurements if m.displacement is not None]
    assert kept == chosen
    assert contact.select_frames(4) == chosen


def peak_bytes(frames_count: int) -> int:
    """Peak memory of the detection of contacts of 20 of each 25 frames, with 2,000 nodes each."""

    class Pressing(Chain):
        def __init__(self) -> None:
            self.tracker = SimpleNamespace(reference_px=np.zeros((2, 2)))
            self.sensor = SensorDescription("pressing", (8, 8), (1.0, 1.0), GEL)

        def measure_deformation(self, frame: Frame) -> Measurement:
            phase = frame.index % 25
            pressed = measurement(frame.index, 0.01 * phase, nodes=2_000)
            return pressed if phase < 20 else replace(pressed, displacement=None)

    def session() -> Iterator[Frame]:
        for index in range(frames_count):
            yield Frame(index, f"{index}", np.zeros((64, 64, 3), np.uint8), 0.1 * index)

    tracemalloc.start()
    try:
        reports: list[Measurement] = []
        contacts = []
        for contact in ContactDetector(Pressing(), report=reports.append).detect(session()):
            contact.keep(contact.select_frames(1))
            contacts.append(contact)
        assert len(reports) == frames_count
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_memory_does_not_grow_with_the_frames_of_a_session() -> None:
    """A frame with contact has 50 kB; one that is no press costs less than 4 kB."""
    short, long = peak_bytes(500), peak_bytes(2_000)
    presses = (2_000 - 500) / 25
    assert (long - short - presses * 50_000) / 1_500 < 4_000
