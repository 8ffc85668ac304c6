"""Damaged files of every kind: a clean error or the right result, never anything else.

Files of tactorch carry checksums: damage that does not matter may pass, and nothing may change in
silence. In files of other programs a changed digit is another number.
"""

import json
import pickle
import shutil
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from tactorch.errors import TactorchError
from tactorch.generation import MeshSizes, PressDraw, Recipe, SampleSet, generate
from tactorch.importers import import_published
from tactorch.inverse import Monitor, Reconstruction
from tactorch.learning.recognizer import Recognizer
from tactorch.learning.training import read_checkpoint
from tactorch.mesh import box_mesh, read_mesh, read_surface, write_mesh, write_surface
from tactorch.recording import MaterialSpec, Press, Recording, append_press

QUICK, FULL = 40, 1500


@dataclass
class Kind:
    """A kind of file.

    Attributes:
        path: A valid file of the kind.
        read: Function that reads it.
        exact: Whether a result that differs must be refused.
    """

    path: Path
    read: Callable[[Path], Any]
    exact: bool = True


def recording() -> Recording:
    mesh = box_mesh((10.0, 10.0, 10.0), 1)
    ones = np.ones((8, 3))
    press = Press(ones, ones > 0, 0.1 * ones, springs=ones, name="top")
    truth = np.linspace(0.1, 0.3, mesh.n_tets)
    material = MaterialSpec("neo_hookean", 0.3)
    return Recording(mesh, (press,), material, truth, provenance={"operator": "Ada"})


def saved(path: Path) -> Kind:
    recording().save(path / "recording.h5")
    return Kind(path / "recording.h5", Recording.load)


def grown(path: Path) -> Kind:
    """A recording with appended presses: its end may be missing, as after a killed writer."""
    whole = recording()
    whole.save(path / "grown.h5")
    for _ in range(3):
        append_press(path / "grown.h5", whole.presses[0])

    def read(file: Path) -> Any:
        loaded = Recording.load(file)
        assert 2 <= len(loaded.presses) <= 4
        return loaded.select([0, 1])

    return Kind(path / "grown.h5", read)


def reconstruction(path: Path) -> Kind:
    whole = recording()
    youngs = np.linspace(0.1, 0.3, whole.mesh.n_tets)
    moved = np.zeros((1, whole.mesh.n_points, 3))
    history = [{"iteration": 0, "misfit": 1.0}]
    found = Reconstruction(whole.mesh, youngs, moved, history, "gradient", 1.0, {"start": 0.2})
    return Kind(found.save(path / "reconstruction.h5"), Reconstruction.load)


def checkpoint(path: Path) -> Kind:
    monitor = Monitor(checkpoint=path / "checkpoint.npz", identity={"solver": "x"}, task="t")
    monitor.best = np.linspace(0, 1, 6)
    monitor.history = [{"iteration": 0, "evaluations": 1, "misfit": 1.0}]
    monitor.save()

    def read(file: Path) -> Any:
        again = Monitor(identity={"solver": "x"}, task="t")
        again.restore(file, 6)
        return (again.best, again.history, again.state)

    return Kind(path / "checkpoint.npz", read)


def dataset(path: Path) -> Path:
    recipe = Recipe(
        name="tiny", count=2, mesh=MeshSizes(0.5, None),
        family={"name": "inclusions", "count": (1, 1), "shapes": ["ball"]},
        presses=PressDraw(steps=(1,), faces=(("z+",),)), samples=1,
    )  # fmt: skip
    return generate(recipe, path / "tiny", workers=1).folder


def in_dataset(name: str, path: Path) -> Kind:
    def read(file: Path) -> Any:
        samples = SampleSet(file.parent)
        return (samples.indices, [sample.recording for sample in samples])

    return Kind(dataset(path) / name, read)


def shard(path: Path) -> Kind:
    return in_dataset("shard-00000.h5", path)


def manifest(path: Path) -> Kind:
    return in_dataset("manifest.json", path)


def weights(path: Path) -> Kind:
    model = Recognizer(["a", "b"], hidden=2, layers=1)
    content = {"state_dict": model.state_dict(), "hyper_parameters": dict(model.hparams)}
    torch.save(content, path / "weights.pt")
    return Kind(path / "weights.pt", lambda file: dict(read_checkpoint(file)["state_dict"]))


def published(path: Path) -> Kind:
    """One file of a case, text of another program."""
    whole, folder = recording(), path / "case"
    (folder / "presses").mkdir(parents=True)
    write_mesh(folder / "mesh.msh", whole.mesh)
    points = whole.mesh.points
    for name, values in (("force1", whole.presses[0].forces), ("pnt1", points * 1.01)):
        np.savetxt(folder / "presses" / f"{name}.txt", values.ravel())
    for name, value in (("A-1", 1000.0), ("B-1", 1.0)):
        lines = "".join(f"{i} {i} {value}\n" for i in range(24))
        (folder / "presses" / f"{name}.txt").write_text(lines)

    def read(file: Path) -> Any:
        return import_published(file.parent.parent, check_units=False)

    return Kind(folder / "presses" / "A-1.txt", read, exact=False)


def mesh(suffix: str) -> Callable[[Path], Kind]:
    def make(path: Path) -> Kind:
        cube, file = box_mesh(10.0, 1), path / f"mesh{suffix}"
        if suffix in (".msh", ".vtu", ".inp"):
            write_mesh(file, cube)
            return Kind(file, lambda file: read_mesh(file, unit="mm"), exact=False)
        write_surface(file, cube.points, cube.surface.triangles)
        return Kind(file, lambda file: read_surface(file, unit="mm"), exact=False)

    make.__name__ = suffix[1:]
    return make


SUFFIXES = (".msh", ".vtu", ".inp", ".stl", ".obj", ".ply")
KINDS = [
    *(saved, grown, reconstruction, checkpoint, shard, manifest, weights, published),
    *(mesh(suffix) for suffix in SUFFIXES),
]


def plain(value: Any) -> Any:
    """Return a value as something that can be compared."""
    if is_dataclass(value):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.ndarray | torch.Tensor):
        array = np.asarray(value)
        return (array.shape, str(array.dtype), array.tobytes())
    return value


def damage(content: bytes, rng: np.random.Generator) -> bytes:
    """Flip a bit or a byte, or cut the end."""
    place, way = int(rng.integers(len(content))), int(rng.integers(3))
    if way == 2:
        return content[:place]
    changed = bytearray(content)
    changed[place] ^= 1 << int(rng.integers(8)) if way == 0 else int(rng.integers(1, 256))
    return bytes(changed)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("amount", [QUICK, pytest.param(FULL, marks=pytest.mark.slow)])
@pytest.mark.parametrize("make", KINDS, ids=lambda make: make.__name__)
def test_damaged_files(make: Callable[[Path], Kind], amount: int, tmp_path: Path) -> None:
    kind = make(tmp_path)
    content, rng = kind.path.read_bytes(), np.random.default_rng(0)
    expected = pickle.dumps(plain(kind.read(kind.path)))
    refused = 0
    for attempt in range(amount):
        damaged = damage(content, rng)
        kind.path.write_bytes(damaged)
        try:
            result = pickle.dumps(plain(kind.read(kind.path)))
        except TactorchError:
            refused += 1  # the message is checked by the tests of each format
        except Exception as error:
            raise AssertionError(f"{make.__name__}, attempt {attempt}: {error!r}") from error
        else:
            assert not kind.exact or result == expected, f"attempt {attempt}: another result"
    assert refused > 0


def test_a_manifest_with_other_failures_is_refused(tmp_path: Path) -> None:
    path = dataset(tmp_path) / "manifest.json"
    content = json.loads(path.read_text())
    path.write_text(json.dumps({**content, "failed": {"1": "left out"}}))
    with pytest.raises(TactorchError, match=r"manifest\.json' is damaged \(its checksum differs"):
        SampleSet(path.parent)
    del content["sha256"]
    path.write_text(json.dumps(content))
    assert len(SampleSet(path.parent)) == 2, "manifests of earlier versions have no checksum"
    shutil.rmtree(path.parent)
