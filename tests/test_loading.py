"""`tactorch.load`: any file or folder by what it contains."""

from pathlib import Path

import numpy as np
import pytest

import tactorch
from tactorch.errors import FileError, MeshError, RecordingError
from tactorch.files import write_json
from tactorch.generation import MeshSizes, Recipe, SampleSet, generate
from tactorch.inverse import Settings, invert_map
from tactorch.mesh import TetMesh, box_mesh, write_mesh, write_surface
from tactorch.phantoms import make_phantom
from tactorch.recording import Recording
from tactorch.sensor.description import load_sensor, save_sensor
from tactorch.simulation import PressPlan, simulate


@pytest.fixture(scope="module")
def recording() -> Recording:
    plan = PressPlan(("z+",), (0.01,))
    return simulate(make_phantom("uniform_cube"), plan, mesh=box_mesh(10.0, 3))


def test_recordings_reconstructions_and_runs(recording: Recording, tmp_path: Path) -> None:
    recording.save(tmp_path / "presses.h5")
    loaded = tactorch.load(tmp_path / "presses.h5")
    assert isinstance(loaded, Recording)
    np.testing.assert_array_equal(loaded.mesh.points, recording.mesh.points)
    result = invert_map(recording, Settings(max_seconds=20.0))
    result.save(tmp_path / "reconstruction.h5")
    for path in (tmp_path / "reconstruction.h5", tmp_path):
        again = tactorch.load(path)
        assert isinstance(again, tactorch.Reconstruction)
        np.testing.assert_array_equal(again.youngs, result.youngs)


def test_meshes_and_sensors(tmp_path: Path) -> None:
    mesh = box_mesh(2.0, 1)
    write_mesh(tmp_path / "box.vtu", mesh)
    assert isinstance(tactorch.load(tmp_path / "box.vtu"), TetMesh)
    save_sensor(load_sensor("finger"), tmp_path / "mine.yaml")
    assert tactorch.load(str(tmp_path / "mine.yaml")) == load_sensor("finger")


def test_datasets(tmp_path: Path) -> None:
    sizes = MeshSizes(relative_edge_length=0.3, fine_relative=0.2)
    generate(Recipe(name="one", count=1, family={"name": "inclusions"}, mesh=sizes), tmp_path)
    loaded = tactorch.load(tmp_path)
    assert isinstance(loaded, SampleSet)
    assert len(loaded) == 1


def test_what_it_cannot_load(recording: Recording, tmp_path: Path) -> None:
    mesh = recording.mesh
    write_surface(tmp_path / "part.stl", mesh.points, mesh.surface.triangles)
    (tmp_path / "notes.txt").write_text("none")
    write_json(tmp_path / "other.json", {"a": 1})
    (tmp_path / "bad.h5").write_bytes(b"no HDF5")
    (tmp_path / "empty").mkdir()
    for name, message in (
        ("part.stl", r"`tactorch mesh .*part\.stl` makes a mesh"),
        ("notes.txt", "cannot be loaded: tactorch loads recordings"),
        ("other.json", "give shapes.json of a run"),
        ("bad.h5", "bad.h5"),
        ("empty", "is no dataset .* and no run"),
        ("gone.h5", "gone.h5"),
        ("gone.vtu", "gone.vtu"),
    ):
        with pytest.raises((FileError, MeshError, RecordingError), match=message):
            tactorch.load(tmp_path / name)
