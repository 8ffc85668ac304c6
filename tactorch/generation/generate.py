"""Generation of a dataset, or of the samples that it lacks."""

import fcntl
import json
import logging
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tactorch.errors import ConfigError, FileError
from tactorch.files import atomic_path, checksum, read_json
from tactorch.generation.layout import (
    MANIFEST,
    MANIFEST_FORMAT,
    PARTIAL,
    RECIPE,
    VERSION,
    damaged,
    sample_name,
    shard_name,
    write_shard,
)
from tactorch.generation.recipe import Recipe
from tactorch.generation.sampleset import SampleSet, failures_in, manifest_checksum
from tactorch.generation.work import check_executor, outcomes
from tactorch.versions import versions

_log = logging.getLogger(__name__)
_BAD = ".failed.json"


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

    Raises:
        ConfigError: The folder holds samples of another recipe or is in use by another process, or
            a setting has an invalid value.
        FileError: The folder cannot be written.
    """
    check_executor(executor, scheduler)
    place = Path(folder)
    with _locked(place):
        _prepare(place, recipe)
        known = _known_checksums(place)
        if retry_failed:
            for bad in (place / PARTIAL).glob(f"*{_BAD}"):
                bad.unlink()
        missing = [i for i in range(recipe.count) if not _is_done(place, recipe, i)]
        done, failed = recipe.count - len(missing), len(_all_failures(place, recipe))
        report = progress or (lambda done, failed, total: None)
        report(done, failed, recipe.count)
        _close_shards(place, recipe)
        if missing:
            for index, content, reason in outcomes(recipe, missing, executor, workers, scheduler):
                _keep(place, index, content, reason)
                done, failed = done + 1, failed + (content is None)
                report(done, failed, recipe.count)
                _close_shard(place, recipe, index // recipe.shard)
        _write_manifest(place, recipe, known)
    return SampleSet.open(place)


def _prepare(place: Path, recipe: Recipe) -> None:
    """Create the folder, or check that it belongs to this recipe."""
    wanted = json.loads(json.dumps(recipe.to_config()))
    stored = place / RECIPE
    if not stored.is_file():
        if place.is_dir() and any(place.glob("shard-*.h5")):
            raise ConfigError(f"'{place}' holds shards without a {RECIPE}; choose another folder.")
        _write_json(stored, wanted)
        (place / PARTIAL).mkdir(exist_ok=True)
        return
    (place / PARTIAL).mkdir(exist_ok=True)
    for stray in [*place.glob(".*.part.*"), *(place / PARTIAL).glob(".*.part.*")]:
        stray.unlink()  # of a killed run
    differs = _first_difference(read_json(stored, "recipe", "choose another folder."), wanted)
    if differs:
        raise ConfigError(
            f"'{place}' holds samples of another recipe: {differs}. Choose another folder, or the"
            " same settings to go on."
        )


def _first_difference(found: Any, wanted: Any, name: str = "") -> str:
    """Return the first difference of two recipes in words; empty where they agree."""
    if isinstance(found, Mapping) and isinstance(wanted, Mapping):
        for key in sorted({*found, *wanted}):
            inner = f"{name}.{key}" if name else str(key)
            text = _first_difference(found.get(key), wanted.get(key), inner)
            if text:
                return text
        return ""
    if isinstance(found, Mapping) or isinstance(wanted, Mapping):
        return f"{name} is given {'there' if wanted is None else 'here'} only"
    return "" if found == wanted else f"{name} is {found!r} there and {wanted!r} here"


@contextmanager
def _locked(place: Path) -> Iterator[None]:
    """Lock the folder against a second run until the process ends."""
    try:
        place.mkdir(parents=True, exist_ok=True)
        lock = open(place / ".lock", "w")  # noqa: SIM115
    except OSError as error:
        raise FileError(f"cannot write into '{place}': {error}; choose another folder.") from error
    with lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise ConfigError(
                f"another run is generating into '{place}'; wait for it, or choose another folder."
            ) from error
        yield


def _is_done(place: Path, recipe: Recipe, index: int) -> bool:
    partial = place / PARTIAL
    name = sample_name(index)
    return (
        (place / shard_name(index // recipe.shard)).is_file()
        or (partial / f"{name}.h5").is_file()
        or (partial / f"{name}{_BAD}").is_file()
    )


def _keep(place: Path, index: int, content: bytes | None, reason: str) -> None:
    """Store a sample or its failure until its shard is complete."""
    name = sample_name(index)
    if content is None:
        _log.warning("sample %d failed: %s", index, reason)
        _write_json(place / PARTIAL / f"{name}{_BAD}", {"index": index, "reason": reason})
        return
    with atomic_path(place / PARTIAL / f"{name}.h5") as temporary:
        temporary.write_bytes(content)


def _close_shards(place: Path, recipe: Recipe) -> None:
    for shard in range(recipe.shards):
        _close_shard(place, recipe, shard)


def _close_shard(place: Path, recipe: Recipe, shard: int) -> None:
    """Write a shard whose samples are complete, and remove their separate files."""
    target, partial = place / shard_name(shard), place / PARTIAL
    indices = recipe.indices(shard)
    files = {i: partial / f"{sample_name(i)}.h5" for i in indices}
    bad = {i: partial / f"{sample_name(i)}{_BAD}" for i in indices}
    if not target.is_file():
        if not all(files[i].is_file() or bad[i].is_file() for i in indices):
            return
        parts = {i: path.read_bytes() for i, path in files.items() if path.is_file()}
        failed = {i: _reason(path) for i, path in bad.items() if i not in parts}
        write_shard(target, parts, failed)
    for path in (*files.values(), *bad.values()):
        path.unlink(missing_ok=True)


def _reason(path: Path) -> str:
    remedy = "delete it and run the same `tactorch generate` again."
    return str(read_json(path, "record of a failed sample", remedy, "reason")["reason"])


def _all_failures(place: Path, recipe: Recipe) -> dict[int, str]:
    failures = {int(p.name[:6]): _reason(p) for p in (place / PARTIAL).glob(f"*{_BAD}")}
    for shard in range(recipe.shards):
        path = place / shard_name(shard)
        if path.is_file():
            failures |= failures_in(path)
    return failures


def _known_checksums(place: Path) -> dict[str, str]:
    """Checksums of the shards that are there, by the manifest of an earlier run.

    Raises:
        FileError: The manifest cannot be read.
    """
    if not (place / MANIFEST).is_file():
        return {}
    shards = SampleSet.open(place).manifest["shards"]
    return {s["file"]: s["sha256"] for s in shards if (place / s["file"]).is_file()}


def _write_manifest(place: Path, recipe: Recipe, known: Mapping[str, str]) -> None:
    """Write the manifest; shards that stood in an earlier one must be what they were."""
    shards = [
        {
            "file": shard_name(shard),
            "first": recipe.indices(shard).start,
            "count": len(recipe.indices(shard)),
            "bytes": (place / shard_name(shard)).stat().st_size,
            "sha256": checksum(place / shard_name(shard)),
        }
        for shard in range(recipe.shards)
    ]
    for shard in shards:
        if known.get(str(shard["file"]), shard["sha256"]) != shard["sha256"]:
            raise damaged(place / str(shard["file"]), "its checksum is not that of the manifest")
    if len(known) == len(shards):
        return
    failed = _all_failures(place, recipe)
    manifest = {
        "format": MANIFEST_FORMAT,
        "version": VERSION,
        "name": recipe.name,
        "samples": recipe.count - len(failed),
        "failed": {str(index): failed[index] for index in sorted(failed)},
        "shards": shards,
        "recipe": json.loads(json.dumps(recipe.to_config())),
        "versions": versions(),
    }
    _write_json(place / MANIFEST, {**manifest, "sha256": manifest_checksum(manifest)})
    if not any((place / PARTIAL).iterdir()):
        (place / PARTIAL).rmdir()


def _write_json(path: Path, content: Any) -> None:
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
