"""Tables of grasps: the part in which the gripper holds, the reference, and errors."""

from pathlib import Path

import numpy as np
import pytest

from tactorch.errors import ConfigError, FileError
from tactorch.importers import grasp, import_grasp
from tactorch.importers.grasp import rigid_depth
from tactorch.importers.holds import GraspColumns, GraspRows, find_hold
from tactorch.mesh import Box, Sphere
from tactorch.recording import Recording
from tactorch.sensor.description import GelLayer

RATE = 30.0  # rows a second
GEL = GelLayer(4.0, 0.2, size_mm=(20.0, 20.0))
CUBE = {
    "shape": "box", "size_mm": (6.0, 6.0, 6.0), "edge_mm": 2.0, "offset_mm": 1.5, "gel": GEL,
}  # fmt: skip


def write(path: Path, lag_s: float = 0.2, force_n: float = 4.0, hold_s: float = 1.0) -> Path:
    """A gripper closes from 8 to 3.5 mm in half a second, holds, and opens, with late widths."""
    closed = (0.5, 0.5 + hold_s)
    time = np.arange(0.0, closed[1] + 1.0, 1.0 / RATE)
    corners = [0.0, closed[0], closed[1], closed[1] + 0.5]
    force = np.interp(time, corners, [0.0, force_n, force_n, 0.0])
    width = np.interp(time - lag_s, corners, [8.0, 3.5, 3.5, 8.0])
    rows = [f"{t:.4f},{f:.4f},{w:.4f}" for t, f, w in zip(time, force, width, strict=True)]
    path.write_text("\n".join(["time_s,force_n,width_mm", *rows]))
    return path


@pytest.fixture
def coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    """Take few elements for the gels."""
    monkeypatch.setattr(grasp, "_CELLS", 6)


@pytest.mark.parametrize("lag_s", [0.0, 0.2, 0.5])
def test_hold_pairs_force_and_width_although_widths_are_late(tmp_path: Path, lag_s: float) -> None:
    hold = GraspColumns().hold(write(tmp_path / "a.csv", lag_s))
    assert (hold.force_n, hold.width_mm) == pytest.approx((4.0, 3.5), abs=0.05)
    assert hold.lag_s == pytest.approx(lag_s, abs=1.5 / RATE)
    assert hold.time_s[0] > 0.45 + lag_s  # not of the motion before
    assert hold.time_s[1] < 1.55


def test_slow_closing_is_no_hold(tmp_path: Path) -> None:
    time = np.arange(0.0, 3.0, 1.0 / RATE)
    force = np.interp(time, [0.0, 2.0, 2.6, 2.7], [0.0, 4.0, 4.0, 0.0])
    width = np.interp(time, [0.0, 2.0, 2.6, 2.7], [8.0, 3.5, 3.5, 8.0])
    hold = find_hold(GraspRows(tmp_path / "a.csv", time, force, width))
    assert (hold.force_n, hold.width_mm) == pytest.approx((4.0, 3.5), abs=0.05)


def test_compliance_is_of_the_force_beyond_that_of_the_references(
    coarse: None, tmp_path: Path
) -> None:
    """Two references whose widths differ by as much as the fingers bend have one offset."""
    folder = tmp_path / "references"
    folder.mkdir()
    usual = {**CUBE, "offset_mm": None, "reference": folder, "reference_shape": "box",
             "reference_mm": 6.0, "gel": GelLayer(2.0, 0.2, size_mm=(5.0, 5.0))}  # fmt: skip
    write(folder / "one.csv", force_n=1.0)
    path = write(tmp_path / "a.csv", force_n=2.0)
    plain, bent = (
        import_grasp(path, **usual, compliance_mm_per_n=c)  # type: ignore[arg-type]
        for c in (0.0, 0.1)
    )
    before, after = (r.presses[0].gel.pose[0, 3] for r in (plain, bent))  # type: ignore[union-attr]
    assert after - before == pytest.approx(-0.5 * 0.1 * 1.0, abs=2e-3)  # farther from the middle


def test_table_of_a_gripper_that_does_not_hold_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"a\.csv.*less than 4 rows.*Hold the object"):
        GraspColumns().hold(write(tmp_path / "a.csv", lag_s=0.3, hold_s=0.2))


@pytest.mark.parametrize(
    ("header", "force_n", "message"),
    [
        ("time_s,force_n,gap_mm", 4.0, r"lacks the column 'width_mm'.*format\.columns=\{width"),
        ("time_s,force_n,width_mm", -4.0, "change their sign"),
        ("time_s,force_n,width_mm", 4000.0, "state the units"),
    ],
)
def test_implausible_tables_are_refused(
    tmp_path: Path, header: str, force_n: float, message: str
) -> None:
    path = write(tmp_path / "a.csv", force_n=force_n)
    path.write_text(path.read_text().replace("time_s,force_n,width_mm", header))
    with pytest.raises(FileError, match=rf"a\.csv.*{message}"):
        GraspColumns().hold(path)


def test_grasps_of_a_folder_are_presses_between_two_gels(tmp_path: Path) -> None:
    folder = tmp_path / "grasps"
    folder.mkdir()
    for name, force_n in (("b10.csv", 4.0), ("b9.csv", 4.2)):
        write(folder / name, force_n=force_n)
    recording = import_grasp(folder, **CUBE, along="y")
    assert [press.name for press in recording.presses] == ["b9", "b10"]
    press = recording.presses[0]
    assert press.gel is not None
    assert press.gel.opposed[0] == pytest.approx(6.0)
    # The faces are at 3.5 + 1.5 mm: each gel moves by half a millimetre, toward y.
    moved = press.gel.pose[:3, 3] - press.gel.first_pose[:3, 3]
    assert moved == pytest.approx([0.0, 0.5, 0.0], abs=0.03)
    assert press.total_force == pytest.approx([0.0, 4.2, 0.0], abs=0.05)
    assert not press.fixed.any()
    # The error of the offset is common to both: they are presses of one contact.
    np.testing.assert_array_equal(press.springs, recording.presses[1].springs)
    recording.save(tmp_path / "grasps.h5")
    assert len(Recording.load(tmp_path / "grasps.h5").presses) == 2


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"offset_mm": None}, ConfigError, r"format\.reference is required"),
        ({"size_mm": (6.0,)}, ConfigError, r"a box has 3 sizes"),
        ({"offset_mm": 9.0}, FileError, r"12\.\d* mm apart, and the object is 6 mm wide along x"),
        ({"shape": "mesh"}, ConfigError, r"format\.mesh is required"),
        ({"compliance_mm_per_n": 0.1}, ConfigError, r"format\.offset_mm is instead of"),
    ],
)
def test_settings_that_do_not_fit_are_refused(
    tmp_path: Path, changes: dict[str, object], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        import_grasp(write(tmp_path / "a.csv"), **{**CUBE, **changes})  # type: ignore[arg-type]


@pytest.mark.slow
def test_rigid_ball_is_as_deep_in_a_thick_gel_as_hertz_states() -> None:
    layer = GelLayer(20.0, 0.2, 0.3, size_mm=(20.0, 20.0))
    depth, by_modulus = rigid_depth(layer, Sphere((0.0, 0.0, 0.0), 8.0), 1.5)
    # Friction and the window, at two and a half depths of the contact, make the gel stiffer.
    hertz = (0.75 * 1.5 * (1.0 - 0.3**2) / 0.2 / np.sqrt(8.0)) ** (2.0 / 3.0)
    assert depth == pytest.approx(hertz, rel=0.15)
    assert by_modulus == pytest.approx(-2.0 / 3.0 * depth, rel=0.1)


def test_reference_gives_the_distance_of_the_faces(coarse: None, tmp_path: Path) -> None:
    """A rigid block of 6 mm that covers the gels compresses both alike."""
    layer = GelLayer(2.0, 0.2, 0.3, size_mm=(5.0, 5.0))
    depth, by_modulus = rigid_depth(layer, Box((0.0, 0.0, 0.0), 6.0), 1.0)
    # Between uniaxial stress and uniaxial strain, whose moduli are 0.2 and 0.27 MPa.
    assert 2.0 / (0.27 * 25.0) < depth < 2.0 / (0.2 * 25.0)
    reference = write(tmp_path / "block.csv", force_n=1.0)
    recording = import_grasp(
        write(tmp_path / "a.csv"), **{**CUBE, "offset_mm": None, "gel": layer},
        reference=reference, reference_shape="box", reference_mm=6.0,
    )  # type: ignore[arg-type]  # fmt: skip
    assert recording.provenance["offset_mm"] == pytest.approx(6.0 - 2.0 * depth - 3.5, abs=0.05)
    gel = recording.presses[0].gel
    assert gel is not None
    # Faces of stiffer gels are farther apart: they yield less to the reference.
    assert gel.opposed[1] == pytest.approx(-2.0 * by_modulus, rel=0.05)
    assert gel.opposed[1] > 0.0
