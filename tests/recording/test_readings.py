"""Presses by probes, measured forces and displacements along directions, in memory and on disk."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tactorch.errors import RecordingError
from tactorch.fem.contact import Ball, FlatPunch
from tactorch.mesh import box_mesh, face_nodes
from tactorch.recording import (
    ForceReading,
    MaterialSpec,
    Press,
    ProbePose,
    Recording,
    SurfaceReading,
    append_press,
)
from tactorch.recording.append import digest

BOX = box_mesh(10.0, 2)
POSE = ProbePose(FlatPunch(3.0, 0.5), np.array([5.0, 5.0, 9.0]))
FORCE = ForceReading.vector((0.0, 0.0, 0.3), 0.01)
SURFACE = SurfaceReading(
    np.array([[1.0, 1.0, 10.0]]), np.array([[0.0, 0.6, 0.8]]), np.array([0.1]), np.array([0.02])
)


def _press(**changes) -> Press:
    n = BOX.n_points
    fixed = np.zeros((n, 3), dtype=bool)
    fixed[face_nodes(BOX, "z-")] = True
    fields = {
        "forces": np.zeros((n, 3)),
        "observed": np.zeros((n, 3), dtype=bool),
        "displacement": np.full((n, 3), np.nan),
        "fixed": fixed,
        "probe": POSE,
        "force": FORCE,
    }
    return Press(**{**fields, **changes})


def _recording(*presses: Press) -> Recording:
    return Recording(BOX, presses, MaterialSpec("neo_hookean", 0.45))


def test_a_press_by_a_probe_needs_no_displacements() -> None:
    recording = _recording(_press())
    np.testing.assert_allclose(recording.presses[0].total_force, (0.0, 0.0, -0.3), atol=1e-12)
    summary = recording.summary()
    assert "force 0.3 N" in summary
    assert "readings: 1 presses by a probe, 3 components of force or moment" in summary


def test_presses_by_probes_share_their_arrays() -> None:
    fixed = np.zeros((BOX.n_points, 3), dtype=bool)
    fixed[face_nodes(BOX, "z-")] = True
    fixed.setflags(write=False)
    press = Press.by_probe(POSE, BOX.n_points, force=FORCE, fixed=fixed, name="first")
    assert press.fixed is fixed
    for array in (press.forces, press.displacement, press.springs, press.prescribed):
        assert array.strides == (0, 0)
    assert digest(press) == digest(_press())
    assert _recording(press).presses[0].name == "first"


def test_files_keep_probes_and_readings(tmp_path: Path) -> None:
    path = tmp_path / "probe.h5"
    turned = replace(POSE, rotation=np.diag([1.0, -1.0, -1.0]))
    presses = (_press(), _press(probe=turned, surface=SURFACE), _press(force=None, surface=SURFACE))
    _recording(*presses).save(path)
    append_press(path, _press(probe=ProbePose(Ball(2.0), np.array([5.0, 5.0, 11.0]))))
    read = Recording.load(path).presses
    assert [digest(press) for press in read[:3]] == [digest(press) for press in presses]
    assert len({digest(press) for press in read}) == 4
    assert read[3].probe.probe == Ball(2.0)
    assert read[2].force is None


def test_a_file_with_an_unknown_probe_is_refused(tmp_path: Path) -> None:
    import h5py

    path = tmp_path / "probe.h5"
    _recording(_press()).save(path)
    with h5py.File(path, "r+") as file:
        file["presses/0000/probe"].attrs["name"] = "cone"
    with pytest.raises(RecordingError, match=r"presses/0000/probe.*cone"):
        Recording.load(path)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ProbePose(Ball(1.0), np.array([0.0, np.nan, 0.0])), "position_mm holds 1"),
        (lambda: ProbePose(Ball(1.0), np.zeros(3), 2.0 * np.eye(3)), "not a rotation"),
        (lambda: ForceReading.vector((0.0, np.inf, 0.1), 0.01), "values holds 1"),
        (lambda: ForceReading.along((0.0, 0.0, 1.0), 0.1, 0.0), "standard deviation is 0"),
        (lambda: ForceReading.along((0.0, 0.0, 0.0), 0.1, 0.1), "row of zeros"),
        (lambda: replace(SURFACE, directions=np.array([[0.0, 0.0, 2.0]])), "has length 2"),
        (lambda: replace(SURFACE, deviations_mm=np.array([-1.0])), "deviation is -1"),
        (
            lambda: SurfaceReading(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros(0)),
            "is empty",
        ),
        (lambda: _press(probe=None), "no probe and no support is moved"),
        (lambda: _press(force=None), "observed is empty"),
    ],
)
def test_bad_readings_are_refused(make, message: str) -> None:
    with pytest.raises(RecordingError, match=message):
        make()


# The type checker of these tests forbids wrong shapes, so they are tried without it.
_WRONG_SHAPES = """
import numpy as np
from tactorch.errors import RecordingError
from tactorch.fem.contact import Ball
from tactorch.recording import ForceReading, ProbePose, SurfaceReading

one = np.ones((1, 3))
for make in (
    lambda: ProbePose(Ball(1.0), [0.0, 0.0]),
    lambda: ForceReading(np.eye(6), [1.0, 2.0, 3.0], [1.0, 1.0, 1.0]),
    lambda: SurfaceReading(one, np.ones((2, 3)), [0.1], [0.1]),
    lambda: SurfaceReading(one, one, ["deep"], [0.1]),
):
    try:
        make()
    except RecordingError as error:
        print(error)
"""


def test_wrong_shapes_are_refused() -> None:
    command = [sys.executable, "-c", _WRONG_SHAPES]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.stderr == ""
    assert run.stdout.splitlines() == [
        "probe: position_mm has shape (2,); (3) is needed",
        "force: axes has shape (6, 6); (3, 6) is needed",
        "surface: directions has shape (2, 3); (1, 3) is needed",
        "surface: displacement_mm has dtype <U4; real numbers are needed",
    ]
