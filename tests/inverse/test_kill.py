"""An inversion killed at any moment resumes and ends with the same map."""

import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tactorch.inverse import Reconstruction, Settings, invert_map
from tactorch.mesh import box_mesh
from tactorch.phantoms import make_phantom
from tactorch.recording import Recording
from tactorch.simulation import PressPlan, simulate

MOMENTS = 20
PROGRAM = """
import sys
from tactorch.inverse import invert_map
from tactorch.recording import Recording

recording = Recording.load(sys.argv[1])
print("ready", flush=True)
invert_map(recording, checkpoint=sys.argv[2], show_progress=False)
"""


@pytest.fixture(scope="module")
def recording() -> Recording:
    ball = make_phantom("cube_sphere", radius=0.3)
    plan = PressPlan(("z+", "x+"), (0.005, 0.01))
    return simulate(ball, plan, mesh=box_mesh(10.0, 6), samples=4, snr_db=30, seed=1)


@pytest.fixture(scope="module")
def undisturbed(recording: Recording) -> Reconstruction:
    return invert_map(recording, show_progress=False)


def _killed(recording: Path, checkpoint: Path, seconds: float) -> None:
    """Start an inversion in another process and kill it so long after its start."""
    command = [sys.executable, "-c", PROGRAM, str(recording), str(checkpoint)]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        time.sleep(seconds)
        process.send_signal(signal.SIGKILL)


def _distance(found: Reconstruction, other: Reconstruction) -> float:
    return float(np.abs(found.youngs / other.youngs - 1.0).max())


@pytest.mark.slow
def test_a_run_killed_at_random_moments_ends_with_the_same_map(
    recording: Recording, undisturbed: Reconstruction, tmp_path: Path
):
    source = tmp_path / "recording.h5"
    recording.save(source)
    rng, resumed = np.random.default_rng(0), 0
    for moment in range(MOMENTS):
        checkpoint = tmp_path / f"{moment}.npz"
        _killed(source, checkpoint, rng.uniform(0.0, 1.0) * undisturbed.seconds)
        # Killed before the first iterate: there is nothing to resume, and nothing half-written.
        resume = checkpoint if checkpoint.exists() else None
        found = invert_map(recording, resume=resume, show_progress=False)
        assert _distance(found, undisturbed) < 1e-6
        resumed += resume is not None
        assert not list(tmp_path.glob("*.part"))
    assert resumed >= MOMENTS // 2


@pytest.mark.parametrize(
    "after", [pytest.param(0, marks=pytest.mark.slow), 4, pytest.param(9, marks=pytest.mark.slow)]
)
def test_a_run_stopped_after_an_iteration_ends_with_the_same_map(
    make_cube: Callable[..., Recording], tmp_path: Path, after: int
):
    cube = make_cube(snr_db=30, seed=1)

    def stop(record: dict, youngs: np.ndarray) -> None:
        if record["iteration"] == after:
            raise KeyboardInterrupt

    checkpoint = tmp_path / "checkpoint.npz"
    whole = invert_map(cube, Settings(), show_progress=False)
    first = invert_map(cube, checkpoint=checkpoint, on_iteration=stop, show_progress=False)
    found = invert_map(cube, resume=checkpoint, show_progress=False)
    assert first.iterations == min(after, whole.iterations)
    assert found.iterations == whole.iterations
    assert _distance(found, whole) < 1e-9
