"""Layout of a dataset on disk.

A dataset is a folder:

| file | what |
|---|---|
| recipe.json | all settings that determine the samples |
| shard-00000.h5 ... | samples, about 50 per file; written whole or not at all |
| manifest.json | written last: recipe, versions, checksums, failed samples |
| card.md, card.png | for people |
| partial/ | samples of unfinished shards, while generation runs |

In a shard (HDF5, text and arrays as in recordings):

| path | type |
|---|---|
| / `format`, `version` | attributes: "tactorch-samples", 1 |
| / `failed` | attribute, JSON object: sample number to reason |
| /samples/000012 | a recording (`tactorch.recording.schema`), and: |
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
from tactorch.generation.sample import Sample
from tactorch.hdf5 import Hdf5Reader, hdf5_image, write_array, write_attribute, write_hdf5
from tactorch.mesh import TetMesh
from tactorch.recording import Recording
from tactorch.recording.storage import RecordingReader, write_recording

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
    """Return a sample as the content of a separate HDF5 file."""

    def write(file: "h5py.File") -> None:
        write_recording(file, vars(sample.recording))
        write_attribute(file, "mesh_hash", sample.recording.mesh.content_hash())
        write_attribute(file, "index", sample.index)
        write_attribute(file, "object", sample.object)
        write_attribute(file, "label", sample.label)
        write_attribute(file, "facts", json.dumps(sample.facts))
        write_attribute(file, "figures", json.dumps(sample.figures))
        if sample.reconstruction is not None:
            write_array(file, "reconstruction", sample.reconstruction)

    return hdf5_image(write)


def write_shard(path: Path, parts: Mapping[int, bytes], failed: Mapping[int, str]) -> None:
    """Write samples to a shard, in the order of their numbers; whole or not at all.

    Raises:
        FileError: The file cannot be written.
    """
    import h5py

    def write(shard: "h5py.File") -> None:
        write_attribute(shard, "format", FORMAT)
        write_attribute(shard, "version", VERSION)
        reasons = {str(index): failed[index] for index in sorted(failed)}
        write_attribute(shard, "failed", json.dumps(reasons))
        shard.create_group("samples")
        shard.create_group("meshes")
        for index in sorted(parts):
            with h5py.File(io.BytesIO(parts[index]), "r") as part:
                _copy(part, shard, sample_name(index))

    write_hdf5(path, write)


def _copy(part: "h5py.File", shard: "h5py.File", name: str) -> None:
    group = shard["samples"].create_group(name)
    for key, value in part.attrs.items():
        group.attrs[key] = value
    for key in part:
        if key != "mesh":
            part.copy(key, group)
    mesh = part.attrs["mesh_hash"].decode()
    if mesh not in shard["meshes"]:
        part.copy("mesh", shard["meshes"], name=mesh)
    group["mesh"] = shard["meshes"][mesh]


@dataclass(frozen=True, eq=False)
class SampleMaps:
    """Maps of Young's modulus of a sample, without its presses.

    Attributes:
        index: Number in the dataset.
        object: Number of the object.
        label: Class of the object, for a recognizer.
        mesh: Mesh of the recording, m elements; one object for all samples of the mesh.
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
    """Reads samples from an open shard.

    Args:
        shard: The file.
        path: Its name, for messages.
        meshes: Meshes that were read before, by hash; new ones are added.
    """

    def __init__(self, shard: "h5py.File", path: Path, meshes: dict[str, TetMesh]) -> None:
        self.shard, self.path, self.meshes = shard, path, meshes

    def sample(self, index: int) -> Sample:
        """Read a sample.

        Raises:
            FileError: The shard is damaged there.
        """
        with self._reader(index) as reader:
            return Sample(
                reader.attribute("/", "index", int),
                reader.attribute("/", "object", int),
                reader.attribute("/", "label", str),
                reader.parse_json("facts", reader.attribute("/", "facts", str)),
                Recording(**reader.fields(), check_units=False),
                _moduli(reader, "reconstruction"),
                json.loads(reader.attribute("/", "figures", str)),
            )

    def maps(self, index: int) -> SampleMaps:
        """Read the maps of a sample, without its presses.

        Raises:
            FileError: The shard is damaged there.
        """
        with self._reader(index) as reader:
            directions = [f"presses/{i:04d}/direction" for i in range(reader.count())]
            known = all(reader.has(name) for name in directions)
            return SampleMaps(
                reader.attribute("/", "index", int),
                reader.attribute("/", "object", int),
                reader.attribute("/", "label", str),
                reader.mesh(),
                reader.array("truth", "f", (reader.mesh().n_tets,)),
                _moduli(reader, "reconstruction"),
                np.array([reader.array(name, "f", (3,)) for name in directions]) if known else None,
            )

    @contextmanager
    def _reader(self, index: int) -> Iterator[RecordingReader]:
        name = sample_name(index)
        try:
            samples = Hdf5Reader(self.shard, self.path, "shard", "tactorch generate")
            group = samples.group(f"samples/{name}")
            source = f"{self.path}, {group.name}"
            key = RecordingReader(group, source).attribute("/", "mesh_hash", str)
            reader = RecordingReader(group, source, self.meshes.get(key))
            self.meshes[key] = reader.mesh()
            yield reader
        except RecordingError as error:  # its message has the remedy
            raise FileError(str(error)) from error
        # What h5py raises on a damaged file has no common base.
        except Exception as error:
            raise damaged(self.path, f"sample {name}: {error}") from error


def damaged(path: Path, reason: Any) -> FileError:
    """Return the error for a shard that cannot be read."""
    return FileError(
        f"shard '{path}' is damaged ({reason}); delete it and generate again: only its samples are"
        " made again."
    )


def _moduli(reader: RecordingReader, name: str) -> Float[np.ndarray, " m"] | None:
    return reader.array(name, "f", (reader.mesh().n_tets,)) if reader.has(name) else None
