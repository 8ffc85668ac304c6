"""Palpations as loggers write them: air, lifting, offsets, units, names, and orders of rows."""

import logging
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tactorch.errors import TactorchError
from tactorch.fem.contact.pressures import ball_force
from tactorch.importers import import_palpation
from tactorch.importers.sheets import read_sheet
from tactorch.importers.strokes import find_mixed, find_stroke, is_limited, lost_work
from tactorch.mesh import TetMesh, box_mesh, write_mesh
from tactorch.recording import Recording

from .palpation_tables import (
    DEPTH,
    HEIGHT,
    MODULUS,
    NAMES,
    NOISE,
    PLANE,
    RADIUS,
    Rows,
    palpation,
    path_of,
    write,
)

TIMED = (*NAMES, "time_s")
BACK = np.arange(DEPTH, -1.0, -0.05)
FULL = np.concatenate([path_of(), BACK])
OFFSETS = 0.02 * np.random.default_rng(3).standard_normal(16)


def read(path: Path, **options: Any) -> Recording:
    settings = {"radius_mm": RADIUS, "depth_mm": 15.0, "margin_mm": 4.0, "edge_mm": 6.0}
    return import_palpation(path, **settings | options)


def forces_over_expected(recording: Recording) -> np.ndarray:
    """Ratios of the forces of the deepest presses to those of the half-space at their poses."""
    ratios = []
    for press in recording.presses:
        assert press.probe is not None
        assert press.force is not None
        depth = HEIGHT + RADIUS - press.probe.position_mm[2:]
        if press.step == 3:
            ratios.append(press.force.values[0] / (PLANE * ball_force(depth, RADIUS)[0]))
    return np.array(ratios)


def check(recording: Recording, probes: int = 16, tolerance: float = 0.08) -> None:
    """The contacts, forces and levels are those of the ball on the half-space."""
    assert recording.provenance["probes"] == probes
    assert len(recording.presses) == 4 * probes
    ratios = forces_over_expected(recording)
    assert np.median(ratios) == pytest.approx(1.0, abs=0.03)
    assert np.abs(ratios - 1.0).max() < tolerance
    assert (
        recording.provenance["rows_used"] + sum(recording.provenance["rows_left_out"].values())
        == (recording.provenance["rows"])
    )


PATHS = {
    "long approach": path_of(10.0),
    "lifted into the air": FULL,
    "lifted in contact": np.concatenate([path_of(), np.arange(DEPTH, 0.5, -0.05)]),
    "stops in air and at the deepest": np.concatenate(
        [path_of(3.0, -0.5), np.full(60, -0.5), path_of(0.5), np.full(99, DEPTH), BACK]
    ),
    "steps": np.concatenate([np.repeat(np.arange(-2.0, 1.51, 0.25), 20), BACK]),
    "a light touch before": np.concatenate([path_of(1.0, 0.4), np.arange(0.4, -1.0, -0.05), FULL]),
    "two touches": np.concatenate([FULL, FULL]),
    "coarse in air": np.concatenate([np.arange(-8.0, -0.5, 0.5), np.arange(-0.5, 1.5, 0.02)]),
}


@pytest.mark.parametrize("path", PATHS)
def test_presses_are_those_of_the_loading_branch_in_contact(tmp_path: Path, path: str) -> None:
    rows = palpation(PATHS[path], lifted=0.6)
    recording = read(write(tmp_path / "p.csv", rows))
    check(recording)
    assert recording.provenance["rows_left_out"]["in air"] > 0
    if np.diff(PATHS[path]).min() < -1e-9:
        assert recording.provenance["hysteresis"] == pytest.approx(0.4, abs=0.04)


def test_what_is_left_out_is_counted(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.INFO):
        read(write(tmp_path / "p.csv", palpation(FULL, lifted=0.6)))
    assert "of 1616 rows are used, of 16 probes. Left out: 800 lifted or pressed again" in (
        caplog.text
    )
    assert "% less work (hysteresis)" in caplog.text


@pytest.mark.parametrize("share", [0.01, 0.03])
@pytest.mark.parametrize("height_n", [0.3, 3.0])
def test_spikes_of_the_force_are_left_out(tmp_path: Path, share: float, height_n: float) -> None:
    rows = palpation()
    spikes = np.random.default_rng(1).random(len(rows)) < share
    rows[spikes, 6] += height_n
    recording = read(write(tmp_path / "p.csv", rows))
    check(recording)
    count = recording.provenance["rows_left_out"]["far from the others of their probe"]
    assert count == pytest.approx(spikes.sum(), abs=1)


@pytest.mark.parametrize("jumps", [False, True])
def test_bends_and_jumps_of_the_force_are_no_spikes(tmp_path: Path, jumps: bool) -> None:
    rows = palpation(modulus=20.0 * MODULUS)
    if jumps:
        rows[rows[:, 3] < HEIGHT + RADIUS - 0.6, 6] += 1.0
    recording = read(write(tmp_path / "p.csv", rows))
    assert "far from the others of their probe" not in recording.provenance["rows_left_out"]


@pytest.mark.parametrize("resolution_n", [0.01, 0.02])
def test_forces_in_coarse_steps_are_no_spikes(tmp_path: Path, resolution_n: float) -> None:
    rows = palpation(path_of(step=0.05))
    rows[:, 4:7] = resolution_n * np.round(rows[:, 4:7] / resolution_n)
    recording = read(write(tmp_path / "p.csv", rows))
    assert "far from the others of their probe" not in recording.provenance["rows_left_out"]
    assert recording.provenance["noise_n"] > 0.05 * resolution_n


@pytest.mark.parametrize("jitter_mm", [0.005, 0.02, 0.05])
def test_positions_may_have_noise(tmp_path: Path, jitter_mm: float) -> None:
    depths = np.concatenate([path_of(3.0, step=0.02), np.arange(DEPTH, -3.0, -0.02)])
    rows = palpation(depths, lifted=0.6)
    rows[:, 1:4] += jitter_mm * np.random.default_rng(5).standard_normal((len(rows), 3))
    check(read(write(tmp_path / "p.csv", rows, TIMED)), tolerance=0.15)


def test_motion_to_the_next_place_is_no_approach(tmp_path: Path) -> None:
    rows = palpation(FULL, lifted=0.6)
    parts = np.split(rows, 16)
    moves = []
    for one, other in pairwise(parts):
        move = np.repeat(one[-1:], 40, axis=0)
        move[:, 1:4] = np.linspace(one[-1, 1:4], other[0, 1:4], 40)
        move[20:, 0] += 1
        move[:, 4:7] = 0.0
        moves += [one, move]
    path = write(tmp_path / "p.csv", np.concatenate([*moves, parts[-1]]))
    recording = read(path)
    check(recording)
    assert recording.provenance["rows_left_out"]["before the approach"] > 150


# --- Offset of the force sensor --------------------------------------------------------------


@pytest.mark.parametrize("step_mm", [0.05, 0.2])
def test_each_probe_has_its_own_offset(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, step_mm: float
) -> None:
    rows = palpation(path_of(1.0, step=step_mm), offset=lambda k, time: 5.0 + OFFSETS[k])
    recording = read(write(tmp_path / "p.csv", rows))
    check(recording, tolerance=0.12)
    assert "differs between probes by more than its noise" in caplog.text
    assert recording.provenance["tare_n"] == pytest.approx(5.0 + np.median(OFFSETS), abs=0.005)
    assert recording.provenance["tare_deviation_n"] == pytest.approx(OFFSETS.std(), abs=0.003)
    count = rows[:, 0].size / 16 * DEPTH / (1.0 + DEPTH) / 4.0
    force = recording.presses[-1].force
    assert force is not None
    white = NOISE / np.sqrt(count)
    assert 1.05 * white < force.deviations[0] < 2.5 * white


def test_equal_offsets_are_one(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    recording = read(write(tmp_path / "p.csv", palpation(offset=lambda k, time: 0.1)))
    assert recording.provenance["tare_deviation_n"] < 1e-6
    assert recording.provenance["tare_n"] == pytest.approx(0.1, abs=0.001)
    assert not caplog.text


def test_a_drift_of_the_offset_is_named(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    rows = palpation(offset=lambda k, time: 0.0015 * time)
    check(read(write(tmp_path / "p.csv", rows, TIMED)))
    assert "drifts by 0.04" in caplog.text
    assert "from the first probe to the last" in caplog.text


def test_a_drift_during_each_probe_is_subtracted(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    rows = palpation(path_of(7.0), offset=lambda k, time: 0.005 * (time - time[0]))
    check(read(write(tmp_path / "p.csv", rows, TIMED)))
    assert "during a probe" in caplog.text


def test_the_offset_of_probes_without_air_is_that_of_the_others(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    def depths(k: int) -> np.ndarray:
        return path_of() if k % 4 else np.arange(0.3, 1.5, 0.05)

    rows = palpation(depths, offset=lambda k, time: 0.1 + OFFSETS[k])
    recording = read(write(tmp_path / "p.csv", rows))
    assert "4 probes without enough samples in air" in caplog.text
    assert "'0', '4', '8', '12'" in caplog.text
    deviations = {
        press.name: press.force.deviations[0] for press in recording.presses if press.force
    }
    assert deviations["probe 4"] == pytest.approx(OFFSETS.std(), rel=0.4)
    assert deviations["probe 5"] < 0.003


@pytest.mark.parametrize("offset", [0.0, -5.0])
def test_forces_at_the_limit_of_the_sensor_are_left_out(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, offset: float
) -> None:
    rows = palpation(offset=lambda k, time: offset)
    stiff = rows[:, 0] % 5 == 0
    rows[stiff] = palpation(offset=lambda k, time: offset, modulus=4.0 * MODULUS)[stiff]
    rows[:, 6] = np.minimum(rows[:, 6], offset + 0.3)
    recording = read(write(tmp_path / "p.csv", rows))
    ratios = forces_over_expected(recording)
    assert ratios[::5] == pytest.approx(4.0, rel=0.15)
    assert np.delete(ratios, np.s_[::5]) == pytest.approx(1.0, abs=0.08)
    count = np.isclose(rows[:, 6], offset + 0.3).sum()
    assert recording.provenance["rows_left_out"]["at the limit of the force sensor"] == count
    shown = f"limit of the sensor ({abs(offset + 0.3):.3g} N): '0', '5', '10', '15'."
    assert f"{count} samples of 4 probes are left out" in caplog.text
    assert shown in caplog.text


@pytest.mark.parametrize("step_mm", [0.002, 0.05])
@pytest.mark.parametrize("noise", [0.0, 1.0])
@pytest.mark.parametrize("resolution", [0.02, 0.1])
def test_coarse_and_slow_forces_and_dwells_are_not_at_the_limit(
    step_mm: float, noise: float, resolution: float
) -> None:
    depth = np.concatenate([path_of(step=step_mm), np.full(50, DEPTH)])
    rows = palpation(depth, side=1)
    force = PLANE * ball_force(depth, RADIUS) + noise * (
        rows[:, 6] - PLANE * ball_force(depth, RADIUS)
    )
    coarse = resolution * np.round(force / resolution)
    assert not is_limited(depth, coarse)
    slow = force[np.arange(len(force)) // 10 * 10]
    assert not is_limited(depth[:-50], slow[:-50])
    assert not is_limited(depth, resolution * np.round(noise * rows[:, 4] / resolution))
    assert is_limited(depth, np.minimum(coarse, 0.1)) == (resolution < 0.1 / 4.0)


@pytest.mark.parametrize("jitter_mm", [0.0, 0.003])
@pytest.mark.parametrize("rate", [0.2, -0.2])
def test_samples_of_held_balls_are_left_out_where_the_force_falls(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, jitter_mm: float, rate: float
) -> None:
    rows = palpation(np.repeat(path_of(step=0.1), 20))
    held = 1.0 - 0.35 * (1.0 - np.exp(-rate * (np.arange(len(rows)) % 20)))
    rows[:, 6] *= held if rate > 0.0 else 1.0
    rows[:, 3] += jitter_mm * np.random.default_rng(2).standard_normal(len(rows))
    recording = read(write(tmp_path / "p.csv", rows))
    check(recording, tolerance=0.12)
    count = recording.provenance["rows_left_out"].get("held while the force falls", 0)
    assert count == (16 * 25 * 19 if rate > 0.0 else 0)
    assert ("of their rise while balls are held at a depth" in caplog.text) == (rate > 0.0)


# --- Units -----------------------------------------------------------------------------------

FORCES = ("fx", "fy", "fz")
SCALES = {
    "mN": (slice(4, 7), 1e3, FORCES),
    "kN": (slice(4, 7), 1e-3, FORCES),
    "m": (slice(1, 4), 1e-3, ("x", "y", "z")),
    "um": (slice(1, 4), 1e3, ("x", "y", "z")),
    "cm": (slice(1, 4), 0.1, ("x", "y", "z")),
}


@pytest.mark.parametrize("unit", SCALES)
def test_units_are_refused_by_what_they_imply(tmp_path: Path, unit: str) -> None:
    columns, factor, quantities = SCALES[unit]
    rows = palpation()
    rows[:, columns] *= factor
    path = write(tmp_path / "p.csv", rows)
    stated = ", ".join(f"{name}: {unit}" for name in quantities)
    with pytest.raises(TactorchError, match=f"in {unit}; give .format.units={{{stated}}}"):
        read(path)
    check(read(path, units=dict.fromkeys(quantities, unit)))
    suffixed = {f"{name}_mm" if name in "xyz" else f"{name}_n" for name in quantities}
    names = [f"{name.split('_')[0]}_{unit}" if name in suffixed else name for name in NAMES]
    check(read(write(path, rows, names)))


OTHER_UNITS = {
    "g": (slice(4, 7), 1e3 / 9.80665),
    "kgf": (slice(4, 7), 1.0 / 9.80665),
    "lbf": (slice(4, 7), 1.0 / 4.4482216),
    "inch": (slice(1, 4), 1.0 / 25.4),
    "\u00b5m": (slice(1, 4), 1e3),  # the letter of the unit, then the Greek one
    "\u03bcm": (slice(1, 4), 1e3),
    "dyn": (slice(4, 7), 1e5),
    "ft": (slice(1, 4), 1.0 / 304.8),
}


@pytest.mark.parametrize(
    ("place", "named"), [("{} [{}]", False), ("{}_{}", True), ("below", False), ("below", True)]
)
@pytest.mark.parametrize("unit", OTHER_UNITS)
def test_units_of_names_are_read_or_refused(
    tmp_path: Path, unit: str, place: str, named: bool
) -> None:
    columns, factor = OTHER_UNITS[unit]
    rows = palpation(side=3)
    rows[:, columns] *= factor
    names, units = [name.split("_")[0] for name in NAMES], [""] * 7
    units[columns] = [unit] * 3
    if place != "below":
        names[columns] = [place.format(name, unit) for name in names[columns]]
    quantities = ("x", "y", "z", *FORCES)
    stated = dict(zip(quantities, [f"{'Log ' * named}{n}" for n in names[1:]], strict=True))
    path = write(tmp_path / "p.csv", rows, ["probe", *stated.values()])
    if place == "below":
        default = ["-", *["mm"] * 3, *["N"] * 3]
        units = [known or other for known, other in zip(units, default, strict=True)]
        path.write_text(path.read_text().replace("\n", "\n" + ",".join(units) + "\n", 1))
    options = {"columns": stated} if named else {}
    if unit in ("dyn", "ft"):
        with pytest.raises(TactorchError, match=rf"p\.csv.*unit '{unit}', which is none of"):
            read(path, **options)
    else:
        check(read(path, **options), probes=9)


def test_a_wide_palpation_in_cm_is_refused_by_its_depths(tmp_path: Path) -> None:
    rows = palpation()
    rows[:, 1:3] *= 2.5  # 10 mm apart
    rows = np.concatenate([rows, rows + np.array([16, 40, *np.zeros(6)])])
    rows[:, 1:4] *= 0.1
    path = write(tmp_path / "p.csv", rows)
    with pytest.raises(TactorchError, match=r"at places 1 mm apart.* as if they were in cm; give"):
        read(path)
    check(read(path, units=dict.fromkeys("xyz", "cm"), edge_mm=15.0), probes=32)


def test_dense_probes_and_few_are_no_sign_of_cm(tmp_path: Path) -> None:
    rows = palpation()
    rows[:, 1:3] *= 0.6
    check(read(write(tmp_path / "p.csv", rows)))


def test_contacts_far_from_the_given_mesh_are_refused(tmp_path: Path) -> None:
    rows, block = palpation(), box_mesh((110.0, 110.0, 12.0), (18, 18, 2))
    rows[:, 1:3] *= 7.0
    body = TetMesh(block.points - np.array([13.0, 13.0, 10.0]), block.tets)
    write_mesh(tmp_path / "body.vtu", body)
    options = {"mesh": tmp_path / "body.vtu"}
    check(read(write(tmp_path / "p.csv", rows), **options))
    centimetres = rows.copy()
    centimetres[:, 1:4] *= 0.1
    path = write(tmp_path / "q.csv", centimetres)
    with pytest.raises(TactorchError, match=r"surface of format\.mesh, as .* in cm; give"):
        read(path, **options)
    check(read(path, **options, units=dict.fromkeys("xyz", "cm")))
    rows[:, 1:4] += 60.0
    with pytest.raises(TactorchError, match="check that it is the mesh of this object"):
        read(write(tmp_path / "r.csv", rows), **options)


def test_balls_pressed_into_half_of_the_depth_are_reported(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = write(tmp_path / "p.csv", palpation())
    read(path, depth_mm=4.0)
    assert "check format.depth_mm" not in caplog.text
    read(path, depth_mm=2.5)
    assert "% of the depth of the object" in caplog.text


@pytest.mark.parametrize("wrong", [{"depth_mm": 0.015}, {"radius_mm": 0.003}, {"depth_mm": 1.2}])
def test_object_and_ball_that_the_depths_contradict_are_refused(
    tmp_path: Path, wrong: dict[str, float]
) -> None:
    with pytest.raises(TactorchError, match=rf"pressed in by .*format\.{next(iter(wrong))}"):
        read(write(tmp_path / "p.csv", palpation()), **wrong)


def test_a_radius_of_contacts_that_are_far_from_the_first_samples_is_refused(
    tmp_path: Path,
) -> None:
    rows = palpation(path_of(7.0))
    surface = np.column_stack([rows[:, 1:3], np.full(len(rows), HEIGHT)])
    upwards = np.tile([0.0, 0.0, 1.0], (len(rows), 1))
    names = [*NAMES, *(f"contact_{a}_mm" for a in "xyz"), *(f"normal_{a}" for a in "xyz")]
    path = write(tmp_path / "p.csv", np.column_stack([rows[:, :7], surface, upwards]), names)
    with pytest.raises(TactorchError, match=r"give format\.radius_mm"):
        read(path, radius_mm=None)
    check(read(path))


# --- Probes, axes and the order of rows ------------------------------------------------------


@pytest.mark.parametrize("label", ["{}", "A{}", "grid_{:02d}"])
def test_numbers_that_begin_again_are_other_probes(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, label: str
) -> None:
    rows = palpation()
    rows[:, 0] %= 8
    labels = [label.format(int(k)) for k in rows[:, 0]]
    recording = read(write(tmp_path / "p.csv", rows, labels=labels))
    check(recording)
    first = label.format(0)
    assert f"such as those of probe {first}: line 2 at (0, 0) mm, line 410 at (8, 0)" in caplog.text
    names = {press.name for press in recording.presses}
    assert {f"probe {first}", f"probe {first} (2)"} <= names


@pytest.mark.parametrize("label", ["1_1{}", "0E{}", "1E1{}", "{}.0"])
def test_names_of_probes_that_python_takes_as_numbers(tmp_path: Path, label: str) -> None:
    rows = palpation()
    path = write(tmp_path / "p.csv", rows, labels=[label.format(int(k)) for k in rows[:, 0]])
    recording = read(path)
    check(recording)
    names = {press.name for press in recording.presses}
    assert names == {f"probe {label.format(k).removesuffix('.0')}" for k in range(16)}


OTHER_TIMES = {
    "T": lambda rows: 23.0 + 0.1 * np.sin(1e3 * rows[:, 7]),  # a temperature
    "t": lambda rows: 23.0 + 0.1 * np.sin(1e3 * rows[:, 7]),
    "stamp,time_s": lambda rows: np.arange(len(rows)) * 7919 % 1000,
}


@pytest.mark.parametrize("names", OTHER_TIMES)
def test_columns_that_are_no_time_do_not_order_the_rows(tmp_path: Path, names: str) -> None:
    rows = palpation(FULL, lifted=0.6)
    rows = np.column_stack([rows[:, :7], OTHER_TIMES[names](rows), rows[:, 7]])
    check(read(write(tmp_path / "p.csv", rows, (*NAMES, *names.split(",")))))


def test_a_time_t_orders_the_rows_where_it_rises_within_probes(tmp_path: Path) -> None:
    rows = palpation(FULL, lifted=0.6)
    rows[:, 7] -= np.repeat(rows[:: len(FULL), 7], len(FULL))
    mixed = np.arange(len(rows)).reshape(16, -1).T.ravel()  # the probes by turns
    check(read(write(tmp_path / "p.csv", rows[mixed], (*NAMES, "t"))))


def test_one_measured_force_is_enough(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    rows = palpation()
    cut = np.delete(rows, [4, 5], axis=1)
    check(read(write(tmp_path / "p.csv", cut, [*NAMES[:4], "fz_n"])))
    assert "has no fx and fy: they are taken as zero" in caplog.text
    with pytest.raises(TactorchError, match="lacks the column 'fy_n'"):
        read(write(tmp_path / "p.csv", np.delete(rows, 5, axis=1), np.delete(NAMES, 5)))
    rows[:, 5] = np.nan
    with pytest.raises(TactorchError, match="the column 'fy_n' has no numbers"):
        read(write(tmp_path / "p.csv", rows))


def _turned(rows: Rows, order: list[int], signs: list[float]) -> Rows:
    turned = rows.copy()
    for begin in (1, 4):
        turned[:, begin : begin + 3] = rows[:, [begin + i for i in order]] * signs
    return turned


@pytest.mark.parametrize(
    ("up", "order", "signs"),
    [
        ("x+", [2, 0, 1], [1.0, 1.0, 1.0]),
        ("y+", [1, 2, 0], [1.0, 1.0, 1.0]),
        ("z-", [0, 1, 2], [1.0, -1.0, -1.0]),
        ("x-", [2, 0, 1], [-1.0, 1.0, -1.0]),
    ],
)
def test_another_axis_may_point_out(
    tmp_path: Path, up: str, order: list[int], signs: list[float]
) -> None:
    rows = _turned(palpation(FULL, lifted=0.6), order, signs)
    path = write(tmp_path / "p.csv", rows, TIMED)
    with pytest.raises(TactorchError, match=rf"format\.up=.?{up[0]}.?\{up[1]}\."):
        read(path)
    recording = read(path, up=up)
    axis, sign = "xyz".index(up[0]), 1.0 if up[1] == "+" else -1.0
    poses = np.array([press.probe.position_mm for press in recording.presses if press.probe])
    deepest = np.argmin(sign * poses[:, axis])
    assert sign * poses[deepest, axis] == pytest.approx(HEIGHT + RADIUS - 1.3, abs=0.1)
    held = recording.mesh.points[recording.presses[0].fixed.any(axis=1)][:, axis]
    assert (sign * held).max() == pytest.approx(HEIGHT - 15.0, abs=0.2)
    assert recording.presses[0].probe is not None
    assert sign * recording.presses[0].probe.rotation[axis, 2] == pytest.approx(1.0, abs=1e-3)


def test_forces_on_the_object_are_refused_with_the_setting(tmp_path: Path) -> None:
    rows = palpation()
    rows[:, 4:7] *= -1.0
    path = write(tmp_path / "p.csv", rows)
    with pytest.raises(TactorchError, match=r"give format\.reverse_force=true"):
        read(path)
    check(read(path, reverse_force=True))


def test_probes_that_never_touch_are_counted(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    rows = palpation(lambda k: np.arange(-3.0, -0.5, 0.05) if k in (3, 9) else path_of())
    check(read(write(tmp_path / "p.csv", rows)), probes=14)
    assert "2 probes are left out, with a force that does not rise" in caplog.text
    assert "'3', '9'" in caplog.text
    with pytest.raises(TactorchError, match="the balls do not touch"):
        read(write(tmp_path / "p.csv", palpation(np.arange(-3.0, -0.5, 0.05))))


@pytest.mark.parametrize(
    "order",
    [
        lambda rows: np.random.default_rng(0).permutation(len(rows)),
        lambda rows: np.argsort(rows[:, 3], kind="stable"),
    ],
)
def test_rows_may_be_in_any_order(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, order: Callable[[Rows], np.ndarray]
) -> None:
    rows = palpation(FULL, lifted=0.6)
    check(read(write(tmp_path / "p.csv", rows[order(rows)], TIMED)))
    assert "no order of time" not in caplog.text
    pressed = palpation()
    check(read(write(tmp_path / "q.csv", pressed[order(pressed)])))
    assert "in no order of time" in caplog.text
    with pytest.raises(TactorchError, match=r"differ by about \d\d %.* Give a column 'time_s'"):
        read(write(tmp_path / "r.csv", rows[order(rows)]))


@pytest.mark.parametrize("noise", [1.0, 4.0])
def test_branches_at_equal_depth_are_found_by_their_forces(noise: float) -> None:
    def probes(lifted: float, jitter_mm: float = 0.0) -> list[tuple[np.ndarray, np.ndarray]]:
        rows, rng = palpation(FULL, lifted=lifted), np.random.default_rng(1)
        rows[:, 6] += NOISE * np.sqrt(noise**2 - 1.0) * rng.standard_normal(len(rows))
        rows[:, 3] += jitter_mm * rng.standard_normal(len(rows))
        return [(-part[:, 3], part[:, 6]) for part in np.split(rows, 16)]

    assert find_mixed(probes(0.6)) == pytest.approx(0.4, abs=0.1)
    assert find_mixed(probes(1.0)) == 0.0
    assert find_mixed(probes(1.0, 0.04)) == 0.0
    assert find_mixed([]) == 0.0


def test_a_clock_that_begins_again_does_not_mix_sessions(tmp_path: Path) -> None:
    first = palpation(offset=lambda k, time: 0.05)
    rows = np.concatenate([first, palpation(offset=lambda k, time: -0.05, seed=3)])
    recording = read(write(tmp_path / "p.csv", rows, TIMED))
    check(recording)
    assert recording.provenance["noise_n"] == pytest.approx(NOISE, rel=0.2)


def test_nine_probes_have_a_plane(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    check(read(write(tmp_path / "p.csv", palpation(side=3))), probes=9)
    assert "taken as a plane through its 9 contacts" in caplog.text
    assert "format.mesh" in caplog.text


def _one_row_each(rows: Rows) -> Rows:
    rows[:, 0] = np.arange(len(rows))
    return rows


def _at(*places: tuple[float, float]) -> Callable[[Rows], Rows]:
    def moved(rows: Rows) -> Rows:
        rows = rows[rows[:, 0] < len(places)]
        rows[:, 1:3] = np.array(places)[rows[:, 0].astype(int)]
        return rows

    return moved


NO_RESULT: dict[str, tuple[Callable[[Rows], Rows], str]] = {
    "few samples": (
        lambda rows: rows[::18],
        "16 of 16 have fewer than 4 samples .*one number of the probe",
    ),
    "a number for each row": (_one_row_each, "816 of 816 have fewer .*one number of the probe"),
    "z in m": (
        lambda rows: rows * [1, 1, 1, 1e-3, 1, 1, 1, 1],
        "16 of 16 have a travel of less than 0.15 mm\\. .*unit of each of x, y and z",
    ),
    "sliding": (
        lambda rows: np.column_stack(
            [rows[:, :2], rows[:, 2] + rows[:, 3], np.full((len(rows), 5), 0.1)]
        ),
        "Balls that slide along the surface cannot be used",
    ),
    "one place": (_at(*[(0.0, 0.0)] * 12), "12 probes are within 0 mm.* all are at one place"),
    "one probe": (_at((0.0, 0.0)), "by 1 points is not known"),
    "probes in line": (_at((0.0, 0.0), (8.0, 0.0), (16.0, 0.0)), r"in line.*format\.mesh"),
}


@pytest.mark.parametrize("given", NO_RESULT)
def test_the_reason_that_leaves_no_probe_is_named(tmp_path: Path, given: str) -> None:
    spoil, message = NO_RESULT[given]
    path = write(tmp_path / "p.csv", spoil(palpation()))
    with pytest.raises(TactorchError, match=rf"p\.csv'.*{message}") as error:
        read(path)
    assert "format.up=z+" not in str(error.value)


# --- Text ------------------------------------------------------------------------------------


def _units_below(lines: list[str]) -> list[str]:
    cells = [line.split(",") for line in lines[1:]]
    rows = [[*c[:4], *(f"{1e3 * float(f)}" for f in c[4:7]), c[7]] for c in cells]
    return ["probe,x,y,z,fx,fy,fz,time", "-,mm,mm,mm,mN,mN,mN,s", *map(",".join, rows)]


def _stamps(names: str, stamp: Callable[[float], str]) -> Callable[[list[str]], list[str]]:
    def apply(lines: list[str]) -> list[str]:
        cells = [line.rsplit(",", 1) for line in lines]
        rows = [f"{cell[0]},{stamp(float(cell[1]))}" for cell in cells[1:]]
        return [f"{cells[0][0]},{names}", *rows[::-1]]

    return apply


TEXTS: dict[str, Callable[[list[str]], list[str]]] = {
    "semicolons and decimal commas": lambda lines: [
        line.replace(",", ";").replace(".", ",") for line in lines
    ],
    "tabs, comments and a byte order mark": lambda lines: [
        "\ufeff# robot's log", *(line.replace(",", "\t") for line in lines[:9]), "# pause",
        *(line.replace(",", "\t") for line in lines[9:]),
    ],
    "units below the names": _units_below,
    "names and units in brackets": lambda lines: [
        "Probe;X [mm];Y [mm];Z [mm];Fx (N);Fy (N);Fz (N);t [s]",
        *(line.replace(",", ";") for line in lines[1:]),
    ],
    "names again": lambda lines: [*lines[:99], lines[0], *lines[99:]],
    "names in a comment and spaces": lambda lines: [
        "# " + lines[0].replace(",", " "), *(line.replace(",", " ") for line in lines[1:])
    ],
    "nanoseconds": _stamps("timestamp_ns", lambda t: f"{1_700_000_000_000_000_000 + int(1e9 * t)}"),
    "stamps of ROS": _stamps(
        "header.stamp.sec,header.stamp.nanosec",
        lambda t: f"{1_700_000_000 + int(t)},{int(1e9 * (t % 1))}",
    ),
    "empty cells at the end": lambda lines: [f"{line}," for line in lines],
    "lines above": lambda lines: ["Robot: UR5e", "Range, 0, 10", "", *lines],
    "cells above": lambda lines: ["Robot,UR5e,,,,,,", "Serial,7,,,,,,", ",,,,,,,", *lines],
    "lines above and units": lambda lines: ["Robot UR5e, cell 3", *_units_below(lines)],
    "comments of other languages": lambda lines: ["% a, b", "// c", *lines[:9], "%", *lines[9:]],
    "delimiter for Excel": lambda lines: ["sep=;", *(line.replace(",", ";") for line in lines)],
    "numbers of rows by R": lambda lines: [
        " ".join(f'"{name}"' for name in lines[0].split(",")),
        *(f'"{i}" {line.replace(",", " ")}' for i, line in enumerate(lines[1:], start=1)),
    ],
    "probes named by #": lambda lines: ["# log", lines[0], *(f"#{line}" for line in lines[1:])],
}  # fmt: skip


@pytest.mark.parametrize("text", TEXTS)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_tables_of_loggers_are_read(tmp_path: Path, text: str, encoding: str) -> None:
    lines = write(tmp_path / "p.csv", palpation(FULL, lifted=0.6), TIMED).read_text().splitlines()
    path = tmp_path / "q.csv"
    content = "\n".join(TEXTS[text](lines))
    path.write_text(content.lstrip("\ufeff" * (encoding == "utf-16")), encoding=encoding)
    recording = read(path)
    check(recording)
    assert recording.provenance["rows"] == len(lines) - 1


def test_spaces_in_names_are_reported_with_the_line_of_names(tmp_path: Path) -> None:
    lines = write(tmp_path / "p.csv", palpation(side=1)).read_text().replace(",", " ").splitlines()
    rows = ["# log", lines[0], *(f"P {line}" for line in lines[1:])]
    (tmp_path / "p.csv").write_text("\n".join(rows))
    with pytest.raises(TactorchError, match=r"line 3 has 8 cells.*\(line 2\) 7; .*spaces in names"):
        read(tmp_path / "p.csv")


def test_names_of_columns_above_units_and_empty_cells(tmp_path: Path) -> None:
    lines = ["press,x,y,z,ux,uy,uz,fx,fy,fz", ",mm,mm,mm,mm,mm,mm,N,N,N"]
    (tmp_path / "t.csv").write_text("\n".join([*lines, *["1,1,2,3,,,,,,0.5"] * 5]))
    sheet = read_sheet(tmp_path / "t.csv")
    assert [*sheet.columns][:2] == ["press", "x [mm]"]


def test_numbers_of_probes_as_numpy_writes_them(tmp_path: Path) -> None:
    lines = write(tmp_path / "p.csv", palpation()).read_text().splitlines()
    cells = (line.split(",", 1) for line in lines[1:])
    rows = [f"{float(first):.18e},{rest}" for first, rest in cells]
    (tmp_path / "p.csv").write_text("\n".join([lines[0], *rows]))
    assert {press.name for press in read(tmp_path / "p.csv").presses} >= {"probe 0", "probe 11"}


def test_rows_without_numbers_are_counted(tmp_path: Path) -> None:
    lines = write(tmp_path / "p.csv", palpation(), TIMED).read_text().splitlines()
    for row, cell, text in ((4, 5, "nan"), (40, 0, ""), (60, 3, "inf"), (80, 2, "-")):
        cells = lines[row].split(",")
        lines[row] = ",".join([*cells[:cell], text, *cells[cell + 1 :]])
    (tmp_path / "p.csv").write_text("\n".join(lines))
    recording = read(tmp_path / "p.csv")
    check(recording)
    assert recording.provenance["rows_left_out"]["without a number"] == 4


def test_columns_of_other_names_are_stated(tmp_path: Path) -> None:
    names = ("id", "px", "py", "pz", "wx", "wy", "wz")
    path = write(tmp_path / "p.csv", palpation(), names)
    with pytest.raises(TactorchError, match=r"format\.columns={probe: NAME}"):
        read(path)
    check(read(path, columns=dict(zip(("probe", "x", "y", "z", *FORCES), names, strict=True))))


# --- Parts -----------------------------------------------------------------------------------


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.lists(st.floats(-5.0, 1.0), min_size=1, max_size=5), st.floats(1.01, 3.0))
def test_a_stroke_is_ever_deeper_and_ends_at_the_deepest(
    turns: list[float], deepest: float
) -> None:
    corners = [-6.0, *turns, deepest, -6.0]
    depth = np.concatenate([np.linspace(a, b, 30, endpoint=False) for a, b in pairwise(corners)])
    centres = np.column_stack([0.0 * depth, 0.0 * depth, -depth])
    stroke = find_stroke(centres, np.array([0.0, 0.0, 1.0]), 0.03, True)
    pressed = depth[stroke.pressed]
    assert pressed[-1] >= deepest - 0.03
    assert (pressed >= np.maximum.accumulate(pressed) - 0.03).all()
    assert stroke.lifted[0] > stroke.pressed[-1]


def test_work_is_lost_between_the_branches() -> None:
    advance = np.linspace(0.0, 2.0, 41)
    lost, low, high = lost_work((advance, advance), (advance[:30], 0.5 * advance[:30]), 0.1)
    assert (low, high) == (0.0, pytest.approx(1.45))
    assert lost == pytest.approx(0.25 * 1.45**2, rel=1e-3)
    assert np.isnan(lost_work((advance, advance), (advance[:1], advance[:1]), 0.1)[0])
