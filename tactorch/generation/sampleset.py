"""Reading a dataset."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from tactorch.display import Summarized
from tactorch.errors import FileError, RecordingError, TactorchError
from tactorch.files import checksum, parse_json, read_json, require_file, require_folder
from tactorch.generation.layout import (
    FORMAT,
    MANIFEST,
    MANIFEST_FORMAT,
    RECIPE,
    VERSION,
    damaged,
    read_touch,
    sample_name,
)
from tactorch.generation.sample import Sample
from tactorch.hdf5 import Hdf5Reader
from tactorch.mesh import TetMesh
from tactorch.recording import Recording
from tactorch.recording.storage import RecordingReader

_MAX_OPEN = 64  # shards
_MAX_SAMPLES = 10**8


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


class SampleSet(Summarized):
    """A finished dataset on disk. Each process opens a shard when it is first needed.

    `tactorch.learning.TouchDataset` has its samples as tensors.

    Args:
        folder: Folder of the dataset; its manifest is read, and no sample yet.

    Attributes:
        folder: Folder of the dataset.
        manifest: Content of the manifest.
        indices: Numbers of the samples, ascending, without the failed ones.

    Raises:
        FileError: There is no dataset, it is unfinished, or of a version that cannot be read.
    """

    def __init__(self, folder: str | Path) -> None:
        place = require_folder(folder, "dataset")
        if not (place / MANIFEST).is_file() and (place / RECIPE).is_file():
            raise FileError(
                f"dataset '{place}' is unfinished: it has no {MANIFEST}; run the same `tactorch"
                " generate` again, which continues."
            )
        manifest = _read_manifest(require_file(place / MANIFEST, "manifest of the dataset"))
        failed = {int(index) for index in manifest["failed"]}
        count = sum(shard["count"] for shard in manifest["shards"])
        self.folder: Path = place
        self.manifest: dict[str, Any] = manifest
        self.indices = tuple(i for i in range(count) if i not in failed)
        self._shards: dict[str, Hdf5Reader] = {}
        self._meshes: dict[str, TetMesh] = {}
        # Size and time of change of the shards whose checksum was compared.
        self._verified: dict[str, tuple[int, int]] = {}

    @staticmethod
    def load(folder: str | Path) -> "SampleSet":
        """Return the dataset of a folder; the same as `SampleSet(folder)`."""
        return SampleSet(folder)

    def summary(self) -> str:
        """Return a description of the dataset in a few lines of text."""
        failed, shards = self.manifest["failed"], self.manifest["shards"]
        return (
            f"{len(self)} samples in {len(shards)} shards of {self.folder}, {len(failed)} failed\n"
            f"{sum(shard['bytes'] for shard in shards) / 1e6:.3g} MB"
        )

    def __len__(self) -> int:
        return len(self.indices)

    def __iter__(self) -> Iterator[Sample]:
        return (self[index] for index in self.indices)

    def __getitem__(self, index: int) -> Sample:
        """Return the sample of a number.

        Raises:
            FileError: There is none of that number, or its shard is missing or damaged.
        """
        with self._reader(index) as reader:
            return Sample(
                reader.attribute("/", "index", int),
                reader.attribute("/", "object", int),
                reader.attribute("/", "label", str),
                reader.parse_json("facts", reader.attribute("/", "facts", str)),
                Recording(**reader.fields(), check_units=False),
                _reconstruction(reader),
                parse_json(reader.attribute("/", "figures", str), f"figures of '{self.folder}'"),
                read_touch(reader),
            )

    def maps(self, index: int) -> SampleMaps:
        """Return the maps of a sample without its presses, which is much faster.

        Raises:
            FileError: There is none of that number, or its shard is missing or damaged.
        """
        with self._reader(index) as reader:
            directions = reader.directions()
            return SampleMaps(
                reader.attribute("/", "index", int),
                reader.attribute("/", "object", int),
                reader.attribute("/", "label", str),
                reader.mesh(),
                reader.array("truth", "f", (reader.mesh().n_tets,)),
                _reconstruction(reader),
                None if directions is None else np.array(directions),
            )

    def verify(self) -> None:
        """Compare each shard with its checksum; those that were compared before are not read.

        Raises:
            FileError: A shard is missing, or is not what was written.
        """
        for shard in self.manifest["shards"]:
            self._verified_path(shard)

    @contextmanager
    def _reader(self, index: int) -> Iterator[RecordingReader]:
        """Provide a reader of a sample, with the mesh that it shares with others."""
        inside = (s for s in self.manifest["shards"] if 0 <= index - s["first"] < s["count"])
        shard = next(inside, None)
        if shard is None:
            raise FileError(f"dataset '{self.folder}' has no sample {index}; it has {len(self)}.")
        reason = self.manifest["failed"].get(str(index))
        if reason is not None:
            raise FileError(f"sample {index} of '{self.folder}' failed: {reason}")
        samples, path, name = self._open(shard), self.folder / shard["file"], sample_name(index)
        try:
            group = samples.group(f"samples/{name}")
            source = f"{path}, {group.name}"
            key = RecordingReader(group, source).attribute("/", "mesh_hash", str)
            reader = RecordingReader(group, source, self._meshes.get(key))
            self._meshes[key] = reader.mesh()
            yield reader
        except RecordingError as error:  # its message has the remedy
            raise FileError(str(error)) from error
        # What h5py raises on a damaged file has no common base.
        except Exception as error:
            raise damaged(path, f"sample {name}: {error}") from error

    def _verified_path(self, shard: dict[str, Any]) -> Path:
        path = require_file(self.folder / shard["file"], "shard of the dataset")
        status = path.stat()
        state = (status.st_size, status.st_mtime_ns)
        if self._verified.get(path.name) != state:
            if checksum(path) != shard["sha256"]:
                raise damaged(path, "its checksum is not that of the manifest")
            self._verified[path.name] = state
        return path

    def _open(self, shard: dict[str, Any]) -> Hdf5Reader:
        path = self._verified_path(shard)
        if path.name not in self._shards:
            if len(self._shards) >= _MAX_OPEN:
                self._shards.pop(next(iter(self._shards))).root.file.close()
            self._shards[path.name] = _open_shard(path)
        return self._shards[path.name]

    def __getstate__(self) -> dict[str, Any]:
        """Leave out open files: each worker process opens its files itself."""
        return {**self.__dict__, "_shards": {}}


def _reconstruction(reader: RecordingReader) -> Float[np.ndarray, " m"] | None:
    name = "reconstruction"
    return reader.array(name, "f", (reader.mesh().n_tets,)) if reader.has(name) else None


def _open_shard(path: Path) -> Hdf5Reader:
    import h5py

    try:
        reader = Hdf5Reader(h5py.File(path, "r"), path, "shard", "tactorch generate")
        reader.check_format(FORMAT, VERSION, "generate it again")
    except TactorchError:
        raise
    # What h5py raises on a damaged file has no common base.
    except Exception as error:
        raise damaged(path, error) from error
    return reader


def read_failures(path: Path) -> dict[int, str]:
    """Return the reason for each sample that a shard lacks, by number."""
    reader = _open_shard(path)
    with reader.root.file:
        try:
            reasons = reader.parse_json("failed", reader.attribute("/", "failed", str))
            return {int(index): str(reason) for index, reason in reasons.items()}
        except Exception as error:
            raise damaged(path, error) from error


def manifest_checksum(manifest: dict[str, Any]) -> str:
    """Return the checksum of the other content of a manifest."""
    content = {key: value for key, value in manifest.items() if key != "sha256"}
    return sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _read_manifest(path: Path) -> dict[str, Any]:
    remedy = "delete it and run the same `tactorch generate` again."
    manifest = read_json(path, "manifest", remedy)
    if manifest.get("format") != MANIFEST_FORMAT:
        raise FileError(f"'{path}' is not the manifest of a dataset of tactorch.")
    version = manifest.get("version")
    if not isinstance(version, int) or version < 1 or version > VERSION:
        raise FileError(
            f"manifest '{path}' has version {version!r}, and this tactorch reads 1 to {VERSION};"
            " generate the dataset again, or use the tactorch that made it."
        )
    if manifest.get("sha256", manifest_checksum(manifest)) != manifest_checksum(manifest):
        raise FileError(f"manifest '{path}' is damaged (its checksum differs); {remedy}")
    try:
        _check_manifest(manifest)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise FileError(f"manifest '{path}' is not complete ({error!r}); {remedy}") from error
    return manifest


def _check_manifest(manifest: dict[str, Any]) -> None:
    manifest["recipe"].items()
    for index in manifest["failed"]:
        int(index)
    for shard in manifest["shards"]:
        sizes = (shard["first"], shard["count"], shard["bytes"])
        if not all(isinstance(size, int) and size >= 0 for size in sizes):
            raise ValueError(f"shard {shard['file']!r}")
        if Path(shard["file"]).name != shard["file"] or not isinstance(shard["sha256"], str):
            raise ValueError(f"shard {shard['file']!r}")
    if sum(shard["count"] for shard in manifest["shards"]) > _MAX_SAMPLES:
        raise ValueError(f"more than {_MAX_SAMPLES} samples")
