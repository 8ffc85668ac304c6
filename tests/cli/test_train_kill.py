"""Training by command, killed outright at random moments, goes on to the same curve and scores."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

DATA = (
    "dataset.count=24", "dataset.shard=12", "dataset.samples=1", "dataset.reconstruct=false",
    "dataset.mesh.relative_edge_length=0.25", "dataset.mesh.fine_relative=null",
    "dataset.presses.steps=[1]",
)  # fmt: skip
EPOCHS = 60
KINDS = {
    "recognizer": (
        ("dataset=recognition",),
        ("model.hidden=8", "data.source=truth", "data.voxels=12", "data.batch=4"),
    ),
    "surrogate": (
        ("dataset=warmstart",),
        ("model=surrogate", "data=warmstart", "model.width=8", "model.encoded=4", "data.cells=4"),
    ),
}


def command(*words: str) -> list[str]:
    return [sys.executable, "-m", "tactorch", *words]


@pytest.mark.slow
@pytest.mark.parametrize("kind", list(KINDS))
def test_killed_training_goes_on_to_the_same_curve(kind: str, tmp_path: Path) -> None:
    dataset, settings = KINDS[kind]
    folder = tmp_path / "data"
    subprocess.run(command("generate", *dataset, *DATA, f"out={folder}"), cwd=tmp_path, check=True)
    train = command(
        "train", *settings, f"data.folder={folder}", "data.shares=[0.6,0.2,0.2]",
        f"trainer.max_epochs={EPOCHS}",
    )  # fmt: skip
    subprocess.run([*train, f"run_dir={tmp_path / 'whole'}"], cwd=tmp_path, check=True)
    rng, kills, words = np.random.default_rng(0), 0, [*train, f"run_dir={tmp_path / 'killed'}"]
    for start in range(60):
        process = subprocess.Popen(words, cwd=tmp_path, start_new_session=True)
        try:
            # A loaded machine may take longer to start than the first kills leave it.
            status = process.wait(timeout=2.0 + 0.5 * start + rng.uniform(0.0, 2.0))
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            kills += 1
        else:
            assert status == 0
            break
        if (tmp_path / "killed" / ".hydra").is_dir():
            words = command("train", f"resume={tmp_path / 'killed'}")
    else:
        raise AssertionError("it never ended")
    assert kills > 0
    for name in ("curve.json", "scores.json"):
        one, other = (json.loads((tmp_path / k / name).read_text()) for k in ("whole", "killed"))
        assert one == other
