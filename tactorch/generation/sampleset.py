"""Reading a dataset."""

import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tactorch.errors import FileError
from tactorch.files import checksum, require_file, require_folder
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
from tactorch.mesh import TetMesh

if TYPE_CHECKING:
    import h5py


_MOST_OPEN = 64  # shards


@dataclass(eq=False)
class SampleSet:
    """A finished dataset on disk. Each process opens a shard on first access.

    Attributes:
        folder: Where it lies.
        manifest: What its manifest says.
        indices: Numbers of the samples that are there, ascending: those that failed are not.
    """

    folder: Path
    manifest: dict[str, Any]
    indices: tuple[int, ...]
    _files: dict[str, "h5py.File"] = field(default_factory=dict, repr=False)
    _meshes: dict[str, TetMesh] = field(default_factory=dict, repr=False)

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
                " generate` again, which goes on where it stopped."
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
        """Return what the sample of a number shows, without its presses: much faster.

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
                return ShardReader(self._file(path), path, self._meshes)
        raise FileError(f"dataset '{self.folder}' has no sample {index}; it has {len(self)}.")

    def verify(self) -> None:
        """Compare each shard with its checksum.

        Raises:
            FileError: A shard is missing, or is not what was written.
        """
        for shard in self.manifest["shards"]:
            path = require_file(self.folder / shard["file"], "shard of the dataset")
            if checksum(path) != shard["sha256"]:
                raise damaged(path, "its checksum is not that of the manifest")

    def _file(self, path: Path) -> "h5py.File":
        if path.name not in self._files:
            if len(self._files) >= _MOST_OPEN:
                self._files.pop(next(iter(self._files))).close()
            self._files[path.name] = open_shard(path)
        return self._files[path.name]

    def __getstate__(self) -> dict[str, Any]:
        """Leave open files behind: each worker process opens its own."""
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
        kind, version = file.attrs["format"], int(file.attrs["version"])
    # What h5py raises on a damaged file has no common base.
    except Exception as error:
        raise damaged(path, error) from error
    kind = kind.decode() if isinstance(kind, bytes) else kind
    if kind != FORMAT:
        raise FileError(f"'{path}' is no shard of a dataset but {kind!r}; generate it again.")
    if version > VERSION:
        raise FileError(
            f"shard '{path}' has version {version}, and this tactorch reads up to {VERSION};"
            " upgrade tactorch."
        )
    return file


def failures_in(path: Path) -> dict[int, str]:
    """Return the samples that a shard lacks, and why."""
    with open_shard(path) as file:
        try:
            text = file.attrs["failed"]
            found = json.loads(text.decode() if isinstance(text, bytes) else text)
        except Exception as error:
            raise damaged(path, error) from error
    return {int(index): str(reason) for index, reason in found.items()}


def _read_manifest(path: Path) -> dict[str, Any]:
    try:
        manifest = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise FileError(
            f"manifest '{path}' cannot be read ({error}); delete it and run the same `tactorch"
            " generate` again."
        ) from error
    if not isinstance(manifest, dict) or manifest.get("format") != MANIFEST_FORMAT:
        raise FileError(f"'{path}' is not the manifest of a dataset of tactorch.")
    version = manifest.get("version")
    if not isinstance(version, int) or version < 1 or version > VERSION:
        raise FileError(
            f"manifest '{path}' has version {version!r}, and this tactorch reads 1 to {VERSION};"
            " generate the dataset again, or use the tactorch that made it."
        )
    for key in ("shards", "failed", "recipe"):
        if key not in manifest:
            raise FileError(f"manifest '{path}' lacks '{key}'; generate the dataset again.")
    return manifest
