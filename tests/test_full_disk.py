"""A full disk: one error, the files of before, and no word from destructors and threads."""

import subprocess
import sys
from pathlib import Path

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

folder, what = Path(sys.argv[1]), sys.argv[2]
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
    sys.path.insert(0, sys.argv[3])
    from test_training import Blobs
    from tactorch.learning.recognizer.network import Recognizer
    from tactorch.learning.training import TrainerOptions, fit
    fit(Recognizer(["a", "b"], hidden=8, layers=2), Blobs(), folder, TrainerOptions(max_epochs=2))

action = globals()[what]
limit = len(before) + 1000 if what == "append" else 3000
resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
try:
    action()
except FileError as error:
    print("refused:", " ".join(str(error).split()))
assert path.read_bytes() == before
assert not [p for p in folder.iterdir() if ".part" in p.name or p.suffix == ".ckpt"], folder
"""


@pytest.mark.skipif(sys.platform == "win32", reason="there is no limit of a file's size")
@pytest.mark.parametrize("what", ["save", "append", "reconstruction", "arrays", "train"])
def test_a_full_disk_is_one_error(what: str, tmp_path: Path) -> None:
    learning = Path(__file__).parent / "learning"
    command = [sys.executable, "-W", "ignore", "-c", SCRIPT, str(tmp_path), what, str(learning)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1].startswith("refused: cannot write")
    assert "Traceback" not in done.stderr
    assert "Exception ignored" not in done.stderr
