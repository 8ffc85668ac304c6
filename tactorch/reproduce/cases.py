"""Cases of a study: made side by side, each stored when it is done, so that a killed run goes on.

A case is told from others by all of its settings: what was made by other settings is not used.
"""

import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from hashlib import sha256
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from tactorch.errors import FileError, TactorchError
from tactorch.files import atomic_path
from tactorch.versions import versions

Told = Callable[[int, int, str], None]
_FIGURES = "figures"


@dataclass(frozen=True)
class Case:
    """One piece of work.

    Attributes:
        study: Name of the module of `tactorch.reproduce` whose `work` makes it.
        name: Within the study; of letters, digits and dashes.
        settings: All that its outcome depends on, as plain values.
    """

    study: str
    name: str
    settings: Mapping[str, Any]

    @property
    def key(self) -> str:
        """Name of its file."""
        content = json.dumps(dict(self.settings), sort_keys=True)
        return f"{self.name}-{sha256(content.encode()).hexdigest()[:10]}"


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a case gave: figures, as plain values, and arrays."""

    figures: Mapping[str, Any]
    arrays: Mapping[str, np.ndarray] = field(default_factory=dict)

    def save(self, path: Path) -> None:
        """Write to one file, whole or not at all."""
        content = {"figures": dict(self.figures), "versions": versions()}
        text = np.array(json.dumps(content))
        with atomic_path(path) as temporary, open(temporary, "wb") as file:
            np.savez_compressed(file, **{_FIGURES: text}, **self.arrays)  # type: ignore[arg-type]

    @staticmethod
    def load(path: Path) -> "Outcome":
        """Read what `save` wrote.

        Raises:
            FileError: The file is damaged.
        """
        try:
            with np.load(path, allow_pickle=False) as content:
                arrays = {name: content[name] for name in content.files if name != _FIGURES}
                return Outcome(json.loads(str(content[_FIGURES]))["figures"], arrays)
        except Exception as error:  # whatever a damaged archive leads to
            raise FileError(f"'{path}' is damaged ({error}); delete it to make it anew.") from error


def make_cases(
    cases: Sequence[Case], folder: Path, workers: int | None, tell: Told
) -> tuple[dict[str, Outcome], dict[str, str]]:
    """Return the outcomes of cases, by name; what is not stored yet is made.

    Args:
        cases: Of one study.
        folder: Where outcomes are stored, and what unfinished cases need to go on.
        workers: Processes; as many as there are cores by default.
        tell: Called with the cases done, their total, and a note.

    Returns:
        Outcomes, and what went wrong with the cases that have none.

    Raises:
        FileError: A stored outcome is damaged.
        TactorchError: A worker process was killed.
    """
    paths = {case.name: folder / case.study / f"{case.key}.npz" for case in cases}
    missing = [case for case in cases if not paths[case.name].is_file()]
    failed: dict[str, str] = {}
    tell(len(cases) - len(missing), len(cases), "")
    for done, (case, reason) in enumerate(_made(missing, folder, workers), start=1):
        if reason:
            failed[case.name] = reason
        note = f", {len(failed)} failed" if failed else ""
        tell(len(cases) - len(missing) + done, len(cases), note)
    found = {name: Outcome.load(path) for name, path in paths.items() if path.is_file()}
    return found, failed


def _made(cases: Sequence[Case], folder: Path, workers: int | None) -> Iterator[tuple[Case, str]]:
    """Make cases in processes of one thread each; yields each as it is done."""
    count = min(workers or os.cpu_count() or 1, len(cases))
    if count <= 1:
        yield from (_make(case, folder) for case in cases)
        return
    from joblib import Parallel, delayed, parallel_config

    with parallel_config(backend="loky", inner_max_num_threads=1):
        pool = Parallel(n_jobs=count, return_as="generator_unordered")
        try:
            yield from pool(delayed(_make)(case, folder) for case in cases)
        except BrokenProcessPool as error:
            raise TactorchError(
                "A worker process was killed, most likely for want of memory; give fewer workers."
                " What is done is kept: the same command goes on."
            ) from error


def _make(case: Case, folder: Path) -> tuple[Case, str]:
    """Make and store one case; what goes wrong with it is told, and hinders no other."""
    from tactorch.generation.work import alone

    scratch = folder / case.study / f"{case.key}.unfinished"
    try:
        with alone():
            outcome = import_module(f"tactorch.reproduce.{case.study}").work(case, scratch)
        outcome.save(folder / case.study / f"{case.key}.npz")
    except TactorchError as error:
        return case, " ".join(str(error).split())
    except Exception as error:  # one bad case must not end the rest
        return case, f"{type(error).__name__}: {' '.join(str(error).split())}"
    for path in sorted(scratch.rglob("*"), reverse=True) if scratch.is_dir() else ():
        path.rmdir() if path.is_dir() else path.unlink()
    if scratch.is_dir():
        scratch.rmdir()
    return case, ""
