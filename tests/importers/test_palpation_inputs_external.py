"""Palpations that were read wrongly: the contacts, offsets and messages of each."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tactorch.errors import TactorchError
from tactorch.importers import import_palpation, import_ros2
from tactorch.inverse import find_shapes
from tactorch.inverse.result.build import of_inclusions
from tactorch.recording import Recording

pytestmark = pytest.mark.external

CASES = (
    "control_palpation", "long_approach", "retract_in_palpation", "tare_per_probe", "millinewton",
    "probe_numbers_restart", "nine_probes",
)  # fmt: skip
RADIUS, MODULUS = 3.0, 0.040
Read = Callable[..., Recording]


@pytest.fixture(scope="module")
def make(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Write cases into a folder."""
    folder = tmp_path_factory.mktemp("inputs")

    def write(*cases: str) -> Path:
        script = shared_data / "failing-inputs" / "importers" / "make_inputs.py"
        if not script.is_file():
            pytest.skip(f"{script} is missing")
        subprocess.run([sys.executable, script, folder, *cases], check=True, timeout=300)
        return folder

    return write


@pytest.fixture(scope="module")
def read(make: Callable[..., Path]) -> Read:
    folder = make(*CASES)

    def palpation(name: str, **options: Any) -> Recording:
        block = {"radius_mm": RADIUS, "depth_mm": 15.0, "margin_mm": 6.0, "edge_mm": 4.0}
        return import_palpation(folder / f"{name}.csv", **block | options)

    return palpation


def deepest(recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """Depths below z = 0 and forces of the last presses, by their places."""
    last = [press for press in recording.presses if press.step == 3]
    places = np.array([press.probe.position_mm for press in last if press.probe])
    forces = np.array([press.force.values[0] for press in last if press.force])
    order = np.lexsort(np.round(places[:, :2]).T)
    return RADIUS - places[order, 2], forces[order]


@pytest.mark.parametrize(
    ("name", "control"),
    [
        ("long_approach_modulus_7", "control_uniform"),
        ("long_approach_modulus_10", "control_uniform"),
        ("tare_per_probe", "control_uniform"),
        ("tare_drifts", "control_uniform"),
        ("approach_hides_lump_7", "control_lump"),
        ("approach_hides_lump_10", "control_lump"),
        ("retract_ends_in_contact", "control_lump"),
        ("retract_ends_in_air", "control_lump"),
        ("probe_numbers_restart", "control_lump"),
    ],
)
def test_presses_are_those_of_the_control(read: Read, name: str, control: str) -> None:
    recording = read(name)
    depths, forces = deepest(recording)
    expected_depths, expected_forces = deepest(read(control))
    assert depths == pytest.approx(expected_depths, abs=0.08)
    assert forces == pytest.approx(expected_forces, abs=0.012)
    assert recording.provenance["noise_n"] == pytest.approx(0.004, rel=0.2)
    assert len(recording.presses) == 144


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("retract_ends_in_contact", "hysteresis"),
        ("tare_per_probe", "differs between probes"),
        ("tare_drifts", "drifts by 0.03"),
        ("probe_numbers_restart", "probe 0: line 2 at (-10, -10) mm, line 920 at (2, -10) mm"),
        ("nine_probes", "a plane through its 9 contacts"),
    ],
)
def test_what_was_not_expected_is_said(
    read: Read, caplog: pytest.LogCaptureFixture, name: str, message: str
) -> None:
    read(name)
    assert message in caplog.text


def test_millinewtons_are_refused_and_can_be_stated(read: Read) -> None:
    with pytest.raises(TactorchError, match=r"in mN; give .format.units={fx: mN, fy: mN, fz: mN}"):
        read("millinewton")
    recording = read("millinewton", units=dict.fromkeys(("fx", "fy", "fz"), "mN"))
    assert deepest(recording)[1] == pytest.approx(deepest(read("control_uniform"))[1], abs=1e-4)


def test_the_moving_transforms_of_a_frame_are_used(
    make: Callable[..., Path], caplog: pytest.LogCaptureFixture
) -> None:
    pytest.importorskip("rosbags")
    folder = make("tf_moving_frame_also_static")
    block = {"radius_mm": RADIUS, "frame": "base", "tool_frame": "tool", "depth_mm": 15.0}
    recordings = [
        import_ros2(folder / name, **block)
        for name in ("tf_control", "tf_moving_frame_also_static")
    ]
    assert "transform of 'tool' is in messages of a static topic (tf_static)" in caplog.text
    control, moving = (deepest(recording) for recording in recordings)
    np.testing.assert_array_equal(moving, control)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["control_lump", "approach_hides_lump_7", "retract_ends_in_contact"]
)
def test_the_lump_is_found(read: Read, name: str) -> None:
    recording = read(name)
    (lump,) = of_inclusions(recording, find_shapes(recording), {}, 0.0).lumps
    assert lump.inclusion.center_mm[:2] == pytest.approx([4.0, 0.0], abs=1.0)
    assert lump.inclusion.center_mm[2] == pytest.approx(-5.5, abs=2.0)
    assert lump.inclusion.background_mpa == pytest.approx(MODULUS, rel=0.1)
