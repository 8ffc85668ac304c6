"""A full disk: one error, the files of before, and no word from destructors and threads."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

SCRIPT = """
import resource, sys
from dataclasses import replace
from pathlib import Path
import numpy as np
from tactorch.errors import FileError
from tactorch.files import write_arrays
from tactorch.hdf5 import write_hdf5
from tactorch.inverse import Reconstruction
from tactorch.mesh import box_mesh
from tactorch.recording import MaterialSpec, Press, Recording, append_press

folder, actions = Path(sys.argv[1]), sys.argv[3:]
mesh = box_mesh(10.0, 4)
rng = np.random.default_rng(0)
ones = np.ones((mesh.n_points, 3))
press = Press(ones, ones > 0, 0.1 * rng.random(ones.shape), springs=ones)
recording = Recording(mesh, (press,), MaterialSpec("neo_hookean", 0.3))
small = replace(press, displacement=0.1 * ones)
path = folder / "session.h5"
replace(recording, presses=(small,)).save(path)
append_press(path, small)
before = path.read_bytes()

def save():
    recording.save(path)

def append():
    append_press(path, press)

def reconstruction():
    youngs = rng.random(mesh.n_tets) + 0.1
    Reconstruction(mesh, youngs, rng.random((1, mesh.n_points, 3)), [], "", 1.0).save(path)

def arrays():
    write_arrays(path, {"x": rng.random(3000)})

def train():
    sys.path.insert(0, sys.argv[2])
    from test_training import Blobs
    from tactorch.learning.recognizer import Recognizer
    from tactorch.learning.training import TrainerOptions, fit
    fit(Recognizer(["a", "b"], hidden=8, layers=2), Blobs(), folder, TrainerOptions(max_epochs=2))

_, most = resource.getrlimit(resource.RLIMIT_FSIZE)
for what in actions:
    limit = len(before) + 1000 if what == "append" else 3000
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, most))
    try:
        globals()[what]()
    except FileError as error:
        print(what, "refused:", " ".join(str(error).split()))
    assert path.read_bytes() == before
    assert not [p for p in folder.iterdir() if ".part" in p.name or p.suffix == ".ckpt"], folder
"""


@pytest.mark.skipif(sys.platform == "win32", reason="there is no limit of a file's size")
@pytest.mark.parametrize(
    "actions",
    [
        ("save", "append", "reconstruction", "arrays"),
        pytest.param(("train",), marks=pytest.mark.slow),
    ],
)
def test_a_full_disk_is_one_error(actions: tuple[str, ...], tmp_path: Path) -> None:
    learning = Path(__file__).parent / "learning"
    command = [
        sys.executable,
        "-B",
        "-W",
        "ignore",
        "-c",
        SCRIPT,
        str(tmp_path),
        str(learning),
        *actions,
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    for line, what in zip(done.stdout.splitlines()[-len(actions) :], actions, strict=True):
        assert line.startswith(f"{what} refused: cannot write")
    assert "Traceback" not in done.stderr
    assert "Exception ignored" not in done.stderr


LIMIT = 6000  # bytes; enough for the settings and the log of a run
PRESS = ("press.faces=[z+]", "press.steps=1")
DATASET = (
    "dataset.count=4", "dataset.shard=4", "dataset.reconstruct=false", "dataset.samples=1",
    "dataset.mesh.relative_edge_length=0.3", "dataset.mesh.fine_relative=null",
    "dataset.presses.steps=[1]", "workers=1",
)  # fmt: skip
COMMANDS = {
    "simulate": (*PRESS, "mesh=coarse", "out=out.h5"),
    "generate": (*DATASET, "out=out"),
    "invert": ("recording=case.h5", "plots=false", "method=map", "optimizer.max_iterations=1"),
    "live": ("recording=case.h5", "plots=false", "shapes=false", "patience_seconds=1"),
    "train": (
        "data.folder=data", "data.source=truth", "data.voxels=6", "data.shares=[0.5,0.25,0.25]",
        "model.hidden=8", "model.layers=2", "trainer.max_epochs=1",
    ),
}  # fmt: skip


def run_command(folder: Path, *words: str, limit: int | None = None) -> Any:
    def full_disk() -> None:
        import resource

        if limit is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    command = [sys.executable, "-B", "-m", "tactorch", *words]  # -B: no truncated bytecode
    return subprocess.run(
        command, capture_output=True, text=True, timeout=120, cwd=folder, preexec_fn=full_disk
    )


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("full")
    for words in (
        ("simulate", *PRESS, "mesh=coarse", "out=case.h5", "run_dir=a"),
        ("generate", *DATASET, "out=data", "run_dir=b"),
    ):
        done = run_command(folder, *words)
        assert done.returncode == 0, done.stderr
    return folder


# A part of the first record fits; it fits, the traceback does not.
@pytest.mark.skipif(sys.platform == "win32", reason="there is no limit of a file's size")
@pytest.mark.parametrize(
    ("free", "reason"),
    [
        (100, "cannot write"),
        (600, "'missing.h5' is not"),
    ],
)
@pytest.mark.slow
def test_a_log_that_is_full_within_a_record_ends_with_one_line(
    free: int, reason: str, tmp_path: Path
) -> None:
    (tmp_path / "invert.log").write_bytes(b"-" * (LIMIT - free))
    words = ("invert", "recording=missing.h5", "run_dir=.")
    done = run_command(tmp_path, *words, limit=LIMIT)
    assert done.returncode == 2, done.stderr
    assert len(done.stderr.splitlines()) == 1, done.stderr
    assert done.stderr.startswith("tactorch invert: error: ")
    assert reason in done.stderr


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="there is no limit of a file's size")
@pytest.mark.parametrize("is_log_full", [False, True])
@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_on_a_full_disk_ends_with_one_line(
    command: str, is_log_full: bool, place: Path
) -> None:
    run = place / f"{command}-{is_log_full}"
    run.mkdir()
    if is_log_full:
        (run / f"{command}.log").write_bytes(b"-" * LIMIT)
    done = run_command(place, command, *COMMANDS[command], f"run_dir={run}", limit=LIMIT)
    assert done.returncode == 2, done.stderr
    assert len(done.stderr.splitlines()) == 1, done.stderr
    assert done.stderr.startswith(f"tactorch {command}: error: cannot write '")
    assert (".log'" in done.stderr) == is_log_full
    assert not (place / "out.h5").exists()
    results = {path.name for folder in (run, place / "out") for path in folder.rglob("*")}
    assert not [name for name in results if ".part" in name or name.endswith((".h5", ".ckpt"))]
