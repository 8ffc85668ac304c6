"""How samples lie on disk.

A dataset is a folder:

| file | what |
|---|---|
| recipe.json | all that decides the samples |
| shard-00000.h5 ... | samples, some 50 a file, each file written whole or not at all |
| manifest.json | written last: recipe, versions, each shard's checksum, failed samples |
| card.md, card.png | for people |
| partial/ | samples of unfinished shards, while generation runs |

In a shard (HDF5, text and arrays as in recordings):

| path | type |
|---|---|
| / `format`, `version` | attributes: "tactorch-samples", 1 |
| / `failed` | attribute, JSON object: sample number to reason |
| /samples/000012 | a recording (`tactorch.recording.schema`), and beside it: |
| /samples/000012 `index`, `object`, `label` | attributes |
| /samples/000012 `facts`, `figures` | attributes, JSON objects |
| /samples/000012/reconstruction | float64 (m,), MPa; absent where none was made |
| /meshes/HASH | points and tets that samples of this mesh share |
"""

import io
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from tactorch.errors import FileError, RecordingError
from tactorch.files import atomic_path
from tactorch.generation.sample import Sample
from tactorch.mesh import TetMesh
from tactorch.recording.reader import Reader
from tactorch.recording.storage import LIBVER, mark, put, write_recording

if TYPE_CHECKING:
    import h5py

FORMAT = "tactorch-samples"
VERSION = 1
MANIFEST_FORMAT = "tactorch-dataset"
RECIPE, MANIFEST, PARTIAL = "recipe.json", "manifest.json", "partial"


def shard_name(shard: int) -> str:
    """Return the name of a shard's file."""
    return f"shard-{shard:05d}.h5"


def sample_name(index: int) -> str:
    """Return the name of a sample within a shard."""
    return f"{index:06d}"


def to_bytes(sample: Sample) -> bytes:
    """Return a sample as the content of an HDF5 file of its own."""
    import h5py

    memory = io.BytesIO()
    with h5py.File(memory, "w", libver=LIBVER) as file:
        write_recording(file, sample.recording)
        mark(file, "mesh_hash", sample.recording.mesh.content_hash())
        mark(file, "index", sample.index)
        mark(file, "object", sample.object)
        mark(file, "label", sample.label)
        mark(file, "facts", json.dumps(sample.facts))
        mark(file, "figures", json.dumps(sample.figures))
        if sample.reconstruction is not None:
            put(file, "reconstruction", sample.reconstruction)
    return memory.getvalue()


def write_shard(path: Path, parts: Mapping[int, bytes], failed: Mapping[int, str]) -> None:
    """Gather samples in a shard, in the order of their numbers; written whole or not at all.

    Raises:
        FileError: The file cannot be written.
    """
    import h5py

    with atomic_path(path) as temporary, h5py.File(temporary, "w", libver=LIBVER) as shard:
        mark(shard, "format", FORMAT)
        mark(shard, "version", VERSION)
        reasons = {str(index): failed[index] for index in sorted(failed)}
        mark(shard, "failed", json.dumps(reasons))
        shard.create_group("samples")
        shard.create_group("meshes")
        for index in sorted(parts):
            with h5py.File(io.BytesIO(parts[index]), "r") as part:
                _copy(part, shard, sample_name(index))


def _copy(part: "h5py.File", shard: "h5py.File", name: str) -> None:
    group = shard["samples"].create_group(name)
    for key, value in part.attrs.items():
        group.attrs[key] = value
    for key in part:
        if key != "mesh":
            part.copy(key, group)
    mesh = _text(part, "mesh_hash")
    if mesh not in shard["meshes"]:
        part.copy("mesh", shard["meshes"], name=mesh)
    group["mesh"] = shard["meshes"][mesh]


@dataclass(frozen=True, eq=False)
class Maps:
    """What a sample shows, without its presses.

    Attributes:
        index: Its number in the dataset.
        object: Number of the object.
        label: What a recognizer should call it.
        mesh: Of the recording, m elements; shared by samples of one mesh.
        truth: (m,), MPa.
        reconstruction: (m,), MPa; None where none was made.
        pushes: Direction of each press; None where one is not known.
    """

    index: int
    object: int
    label: str
    mesh: TetMesh
    truth: Float[np.ndarray, " m"]
    reconstruction: Float[np.ndarray, " m"] | None
    pushes: Float[np.ndarray, "k 3"] | None


class ShardReader:
    """Reads samples out of an open shard.

    Args:
        shard: The file.
        path: What to call it in messages.
        meshes: Those read before, by their hash; new ones are added.
    """

    def __init__(self, shard: "h5py.File", path: Path, meshes: dict[str, TetMesh]) -> None:
        self.shard, self.path, self.meshes = shard, path, meshes

    def sample(self, index: int) -> Sample:
        """Read a sample.

        Raises:
            FileError: The shard is damaged there.
        """
        with self._group(index) as group:
            reader = self._reader(group)
            return Sample(
                int(group.attrs["index"]),
                int(group.attrs["object"]),
                _text(group, "label"),
                json.loads(_text(group, "facts")),
                reader.recording(check_units=False),
                _moduli(group, "reconstruction"),
                json.loads(_text(group, "figures")),
            )

    def maps(self, index: int) -> Maps:
        """Read what a sample shows, without its presses.

        Raises:
            FileError: The shard is damaged there.
        """
        with self._group(index) as group:
            presses = [group["presses"][name] for name in group["presses"]]
            known = all("direction" in press for press in presses)
            truth = _moduli(group, "truth")
            assert truth is not None
            return Maps(
                int(group.attrs["index"]),
                int(group.attrs["object"]),
                _text(group, "label"),
                self._reader(group).mesh(),
                truth,
                _moduli(group, "reconstruction"),
                np.array([press["direction"][()] for press in presses]) if known else None,
            )

    @contextmanager
    def _group(self, index: int) -> "Iterator[h5py.Group]":
        name = sample_name(index)
        try:
            yield self.shard["samples"][name]
        except RecordingError as error:  # says itself what to do
            raise FileError(str(error)) from error
        # What h5py raises on a damaged file has no common base.
        except Exception as error:
            raise damaged(self.path, f"sample {name}: {error}") from error

    def _reader(self, group: "h5py.Group") -> Reader:
        name = _text(group, "mesh_hash")
        source = f"{self.path}, {group.name}"
        if name not in self.meshes:
            self.meshes[name] = Reader(group, source).mesh()
        return Reader(group, source, self.meshes[name])


def damaged(path: Path, reason: Any) -> FileError:
    """Return the error for a shard that cannot be read."""
    return FileError(
        f"shard '{path}' is damaged ({reason}); delete it and generate again: only its samples are"
        " made anew."
    )


def _text(group: "h5py.Group", name: str) -> str:
    value = group.attrs[name]
    return value.decode("utf-8") if isinstance(value, bytes) else str(value)


def _moduli(group: "h5py.Group", name: str) -> Float[np.ndarray, " m"] | None:
    return np.asarray(group[name][()], dtype=np.float64) if name in group else None
