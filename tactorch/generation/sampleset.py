"""Reading a dataset."""

import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tactorch.errors import FileError
from tactorch.files import checksum, read_json, require_file, require_folder
from tactorch.generation.layout import (
    FORMAT,
    MANIFEST,
    MANIFEST_FORMAT,
    RECIPE,
    VERSION,
    SampleMaps,
    ShardReader,
    damaged,
)
from tactorch.generation.sample import Sample
from tactorch.hdf5 import Hdf5Reader
from tactorch.mesh import TetMesh

if TYPE_CHECKING:
    import h5py


_MAX_OPEN = 64  # shards
MAX_SAMPLES = 10**8


@dataclass(eq=False)
class SampleSet:
    """A finished dataset on disk. Each process opens a shard when it is first needed.

    Attributes:
        folder: Folder of the dataset.
        manifest: Content of the manifest.
        indices: Numbers of the samples, ascending, without the failed ones.
    """

    folder: Path
    manifest: dict[str, Any]
    indices: tuple[int, ...]
    _files: dict[str, "h5py.File"] = field(default_factory=dict, repr=False)
    _meshes: dict[str, TetMesh] = field(default_factory=dict, repr=False)
    # Size and time of change of the shards whose checksum was compared.
    _verified: dict[str, tuple[int, int]] = field(default_factory=dict, repr=False)

    @classmethod
    def open(cls, folder: str | Path) -> "SampleSet":
        """Read the manifest of a dataset; no sample yet.

        Raises:
            FileError: There is none, it is unfinished, or of a version that cannot be read.
        """
        place = require_folder(folder, "dataset")
        if not (place / MANIFEST).is_file() and (place / RECIPE).is_file():
            raise FileError(
                f"dataset '{place}' is unfinished: it has no {MANIFEST}; run the same `tactorch"
                " generate` again, which continues."
            )
        path = require_file(place / MANIFEST, "manifest of the dataset")
        manifest = _read_manifest(path)
        failed = {int(index) for index in manifest["failed"]}
        count = sum(shard["count"] for shard in manifest["shards"])
        return cls(place, manifest, tuple(i for i in range(count) if i not in failed))

    def __len__(self) -> int:
        return len(self.indices)

    def __iter__(self) -> Iterator[Sample]:
        return (self[index] for index in self.indices)

    def __getitem__(self, index: int) -> Sample:
        """Return the sample of a number.

        Raises:
            FileError: There is none of that number, or its shard is missing or damaged.
        """
        return self._reader(index).sample(index)

    def maps(self, index: int) -> SampleMaps:
        """Return the maps of a sample without its presses, which is much faster.

        Raises:
            FileError: There is none of that number, or its shard is missing or damaged.
        """
        return self._reader(index).maps(index)

    def _reader(self, index: int) -> ShardReader:
        for shard in self.manifest["shards"]:
            if shard["first"] <= index < shard["first"] + shard["count"]:
                path = self.folder / shard["file"]
                reason = self.manifest["failed"].get(str(index))
                if reason is not None:
                    raise FileError(f"sample {index} of '{self.folder}' failed: {reason}")
                return ShardReader(self._file(shard), path, self._meshes)
        raise FileError(f"dataset '{self.folder}' has no sample {index}; it has {len(self)}.")

    def verify(self) -> None:
        """Compare each shard with its checksum; those that were compared before are not read.

        Raises:
            FileError: A shard is missing, or is not what was written.
        """
        for shard in self.manifest["shards"]:
            self._verified_path(shard)

    def _verified_path(self, shard: dict[str, Any]) -> Path:
        path = require_file(self.folder / shard["file"], "shard of the dataset")
        status = path.stat()
        state = (status.st_size, status.st_mtime_ns)
        if self._verified.get(path.name) != state:
            if checksum(path) != shard["sha256"]:
                raise damaged(path, "its checksum is not that of the manifest")
            self._verified[path.name] = state
        return path

    def _file(self, shard: dict[str, Any]) -> "h5py.File":
        path = self._verified_path(shard)
        if path.name not in self._files:
            if len(self._files) >= _MAX_OPEN:
                self._files.pop(next(iter(self._files))).close()
            self._files[path.name] = open_shard(path)
        return self._files[path.name]

    def __getstate__(self) -> dict[str, Any]:
        """Leave out open files: each worker process opens its files itself."""
        return {**self.__dict__, "_files": {}}


def open_shard(path: Path) -> "h5py.File":
    """Open a shard for reading.

    Raises:
        FileError: It is missing, damaged or no shard.
    """
    import h5py

    require_file(path, "shard of the dataset")
    try:
        file = h5py.File(path, "r")
        reader = Hdf5Reader(file, path, "shard", "tactorch generate")
        kind = reader.attribute("/", "format", str)
        version = reader.attribute("/", "version", int)
    # What h5py raises on a damaged file has no common base.
    except Exception as error:
        raise damaged(path, error) from error
    if kind != FORMAT:
        raise FileError(f"'{path}' is no shard of a dataset but {kind!r}; generate it again.")
    if version > VERSION:
        raise FileError(
            f"shard '{path}' has version {version}, and this tactorch reads up to {VERSION};"
            " upgrade tactorch."
        )
    return file


def failures_in(path: Path) -> dict[int, str]:
    """Return the reason for each sample that a shard lacks, by number."""
    with open_shard(path) as file:
        try:
            reader = Hdf5Reader(file, path, "shard", "tactorch generate")
            reasons = reader.parse_json("failed", reader.attribute("/", "failed", str))
            return {int(index): str(reason) for index, reason in reasons.items()}
        except Exception as error:
            raise damaged(path, error) from error


def manifest_checksum(manifest: dict[str, Any]) -> str:
    """Return the checksum of a manifest's content but the checksum."""
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
    """Raise KeyError, TypeError or ValueError where a part is missing or of another type."""
    manifest["recipe"].items()
    for index in manifest["failed"]:
        int(index)
    for shard in manifest["shards"]:
        sizes = (shard["first"], shard["count"], shard["bytes"])
        if not all(isinstance(size, int) and size >= 0 for size in sizes):
            raise ValueError(f"shard {shard['file']!r}")
        if Path(shard["file"]).name != shard["file"] or not isinstance(shard["sha256"], str):
            raise ValueError(f"shard {shard['file']!r}")
    if sum(shard["count"] for shard in manifest["shards"]) > MAX_SAMPLES:
        raise ValueError(f"more than {MAX_SAMPLES} samples")
