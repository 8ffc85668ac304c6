"""Generation of a dataset, or of the samples that it lacks, in parallel."""

import fcntl
import json
import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from threading import Lock
from typing import Any

from tactorch.errors import ConfigError, FileError
from tactorch.files import checksum, read_json, write_file, write_json
from tactorch.generation.layout import (
    MANIFEST,
    MANIFEST_FORMAT,
    PARTIAL,
    RECIPE,
    VERSION,
    damaged,
    sample_name,
    to_bytes,
    write_shard,
)
from tactorch.generation.recipe import Recipe
from tactorch.generation.sample import make_sample
from tactorch.generation.sampleset import SampleSet, manifest_checksum, read_failures
from tactorch.processes import run_in_processes, single_thread
from tactorch.versions import versions

_log = logging.getLogger(__name__)
_EXECUTORS = ("processes", "dask")
_FAILED = ".failed.json"
_SAMPLE_LOCK = Lock()


def generate(
    recipe: Recipe,
    folder: str | Path,
    *,
    executor: str = "processes",
    workers: int | None = None,
    scheduler: str | None = None,
    retry_failed: bool = False,
    progress: Callable[[int, int, int], None] | None = None,
) -> SampleSet:
    """Make the samples of a recipe that a folder lacks, and the manifest.

    May be killed at any time: finished samples are kept, and the next call continues. The files
    depend neither on interruptions nor on the number of workers.

    Args:
        recipe: Recipe of the samples.
        folder: Folder of the dataset; created if it does not exist.
        executor: "processes" on this machine, or "dask".
        workers: Number of processes; None for the number of cores.
        scheduler: Address of the Dask scheduler.
        retry_failed: Whether to repeat failed samples of incomplete shards.
        progress: Called with the number of finished samples, of failed ones among them, and of all.

    Returns:
        The dataset.

    Raises:
        ConfigError: The folder holds samples of another recipe or is in use by another process, or
            a setting has an invalid value.
        FileError: The folder cannot be written.
    """
    if executor not in _EXECUTORS:
        raise ConfigError(f"executor={executor!r}: choose one of {', '.join(_EXECUTORS)}.")
    if executor == "dask" and scheduler is None:
        raise ConfigError(
            "executor=dask needs scheduler=ADDRESS, such as tcp://127.0.0.1:8786; start one with"
            " `dask scheduler`, and workers with `dask worker ADDRESS --nthreads 1`."
        )
    dataset = _Dataset(Path(folder), recipe)
    with _locked(dataset.folder):
        dataset.prepare()
        known = dataset.known_checksums()
        if retry_failed:
            for failure in dataset.partial.glob(f"*{_FAILED}"):
                failure.unlink()
        missing = [index for index in range(recipe.count) if not dataset.is_done(index)]
        done, failed = recipe.count - len(missing), len(dataset.failures())
        report = progress or (lambda done, failed, total: None)
        report(done, failed, recipe.count)
        for shard in range(recipe.shards):
            dataset.close_shard(shard)
        if missing:
            if executor == "dask":
                outcomes = _run_on_dask(recipe, missing, scheduler)
            else:
                outcomes = run_in_processes(partial(_make, recipe), missing, workers)
            for index, content, reason in outcomes:
                dataset.keep(index, content, reason)
                done, failed = done + 1, failed + (content is None)
                report(done, failed, recipe.count)
                dataset.close_shard(index // recipe.shard)
        dataset.write_manifest(known)
    return SampleSet(folder)


@dataclass(frozen=True)
class _Dataset:
    folder: Path
    recipe: Recipe

    @property
    def partial(self) -> Path:
        """Folder of the samples of unfinished shards."""
        return self.folder / PARTIAL

    @cached_property
    def shards(self) -> list[Path]:
        return [self.folder / f"shard-{shard:05d}.h5" for shard in range(self.recipe.shards)]

    def prepare(self) -> None:
        """Create the folder, or check that it belongs to this recipe."""
        config = json.loads(json.dumps(self.recipe.to_config()))
        stored = self.folder / RECIPE
        if not stored.is_file():
            if any(self.folder.glob("shard-*.h5")):
                raise ConfigError(
                    f"'{self.folder}' holds shards without a {RECIPE}; choose another folder."
                )
            write_json(stored, config)
        self.partial.mkdir(exist_ok=True)
        for stray in [*self.folder.glob(".*.part.*"), *self.partial.glob(".*.part.*")]:
            stray.unlink()  # of a killed run
        differs = _first_difference(read_json(stored, "recipe", "choose another folder."), config)
        if differs:
            raise ConfigError(
                f"'{self.folder}' holds samples of another recipe: {differs}. Choose another"
                " folder, or the same settings to go on."
            )

    def known_checksums(self) -> dict[str, str]:
        """Return the checksums of existing shards by the manifest of an earlier run."""
        if not (self.folder / MANIFEST).is_file():
            return {}
        shards = SampleSet(self.folder).manifest["shards"]
        return {s["file"]: s["sha256"] for s in shards if (self.folder / s["file"]).is_file()}

    def _sample_files(self, index: int) -> tuple[Path, Path]:
        """Return the file of a sample until its shard is complete, and of its failure."""
        name = sample_name(index)
        return self.partial / f"{name}.h5", self.partial / f"{name}{_FAILED}"

    def is_done(self, index: int) -> bool:
        files = (self.shards[index // self.recipe.shard], *self._sample_files(index))
        return any(path.is_file() for path in files)

    def keep(self, index: int, content: bytes | None, reason: str) -> None:
        """Store a sample or its failure until its shard is complete."""
        path, failure = self._sample_files(index)
        if content is None:
            _log.warning("sample %d failed: %s", index, reason)
            write_json(failure, {"index": index, "reason": reason})
        else:
            write_file(path, content)

    def close_shard(self, shard: int) -> None:
        """Write a shard whose samples are complete, and remove their separate files."""
        target = self.shards[shard]
        files = {index: self._sample_files(index) for index in self.recipe.indices(shard)}
        if not target.is_file():
            if not all(any(path.is_file() for path in pair) for pair in files.values()):
                return
            parts = {i: path.read_bytes() for i, (path, _) in files.items() if path.is_file()}
            failed = {i: _reason(path) for i, (_, path) in files.items() if i not in parts}
            write_shard(target, parts, failed)
        for pair in files.values():
            for path in pair:
                path.unlink(missing_ok=True)

    def failures(self) -> dict[int, str]:
        failures = {int(p.name[:6]): _reason(p) for p in self.partial.glob(f"*{_FAILED}")}
        for path in self.shards:
            failures |= read_failures(path) if path.is_file() else {}
        return failures

    def write_manifest(self, known: Mapping[str, str]) -> None:
        """Write the manifest; shards of an earlier manifest must be unchanged."""
        shards = []
        for shard, path in enumerate(self.shards):
            indices, digest = self.recipe.indices(shard), checksum(path)
            if known.get(path.name, digest) != digest:
                raise damaged(path, "its checksum is not that of the manifest")
            place = {"file": path.name, "first": indices.start, "count": len(indices)}
            shards.append({**place, "bytes": path.stat().st_size, "sha256": digest})
        if len(known) == len(shards):
            return
        failed = self.failures()
        manifest = {
            "format": MANIFEST_FORMAT,
            "version": VERSION,
            "name": self.recipe.name,
            "samples": self.recipe.count - len(failed),
            "failed": {str(index): failed[index] for index in sorted(failed)},
            "shards": shards,
            "recipe": json.loads(json.dumps(self.recipe.to_config())),
            "versions": versions(),
        }
        write_json(self.folder / MANIFEST, {**manifest, "sha256": manifest_checksum(manifest)})
        if not any(self.partial.iterdir()):
            self.partial.rmdir()


def _first_difference(stored: Any, given: Any, name: str = "") -> str:
    """Return the first difference of two recipes in words; empty where they agree."""
    if isinstance(stored, Mapping) and isinstance(given, Mapping):
        for key in sorted({*stored, *given}):
            inner = f"{name}.{key}" if name else str(key)
            text = _first_difference(stored.get(key), given.get(key), inner)
            if text:
                return text
        return ""
    if isinstance(stored, Mapping) or isinstance(given, Mapping):
        return f"{name} is given {'there' if given is None else 'here'} only"
    return "" if stored == given else f"{name} is {stored!r} there and {given!r} here"


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Lock the folder against a second run until the process ends."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = open(folder / ".lock", "w")  # noqa: SIM115
    except OSError as error:
        raise FileError(f"cannot write into '{folder}': {error}; choose another folder.") from error
    with lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise ConfigError(
                f"another run is generating into '{folder}'; wait for it, or choose another folder."
            ) from error
        yield


def _reason(path: Path) -> str:
    remedy = "delete it and run the same `tactorch generate` again."
    return str(read_json(path, "record of a failed sample", remedy, "reason")["reason"])


def _make(recipe: Recipe, index: int) -> tuple[int, bytes | None, str]:
    """Return the number of a sample, its content, and the reason of a failure."""
    try:
        # A cluster may run several tasks in one process, whose thread counts are common to all.
        with _SAMPLE_LOCK, single_thread():
            return index, to_bytes(make_sample(recipe, index)), ""
    except Exception as error:  # a failed sample must not end the others
        return index, None, f"{type(error).__name__}: {' '.join(str(error).split())}"


def _run_on_dask(
    recipe: Recipe, indices: Sequence[int], scheduler: str | None
) -> Iterator[tuple[int, bytes | None, str]]:
    """Make samples on a cluster and yield each as it is finished, in any order."""
    try:
        from distributed import Client, as_completed
    except ImportError as error:
        raise ConfigError(
            "executor=dask needs Dask: pip install 'tactorch[dask]' or 'dask[distributed]'."
        ) from error
    try:
        client = Client(scheduler, timeout="10s")
    except (OSError, TimeoutError, ValueError) as error:
        raise ConfigError(
            f"No Dask scheduler answers at {scheduler} ({error}); check the address, and that"
            " `dask scheduler` runs there."
        ) from error
    with client:
        if not client.scheduler_info()["workers"]:
            raise ConfigError(
                f"The Dask scheduler at {scheduler} has no workers; start some with `dask worker"
                f" {scheduler} --nthreads 1`."
            )
        shared = client.scatter(recipe, broadcast=True)
        futures = client.map(lambda i, r: _make(r, i), indices, r=shared, pure=False)
        for future in as_completed(futures):
            yield future.result()
            future.release()
