"""Cases of a study: run in parallel, each stored when it is done.

The settings of a case identify its stored result, so that an interrupted run can be continued.
"""

import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from hashlib import sha256
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from tactorch.errors import FileError, TactorchError
from tactorch.files import atomic_path
from tactorch.processes import run_in_processes, single_thread
from tactorch.versions import versions

#: Called with the number of finished cases, their total and a note.
ProgressCallback = Callable[[int, int, str], None]
_FIGURES = "figures"


@dataclass(frozen=True)
class Case:
    """One unit of computation.

    Attributes:
        study: Name of the module of `tactorch.reproduce` whose `run_case` computes it.
        name: Name within the study, of letters, digits and dashes.
        settings: All settings that determine the result, as plain values.
    """

    study: str
    name: str
    settings: Mapping[str, Any]

    @property
    def key(self) -> str:
        """Stem of the file of its result."""
        content = json.dumps(dict(self.settings), sort_keys=True)
        return f"{self.name}-{sha256(content.encode()).hexdigest()[:10]}"


@dataclass(frozen=True, eq=False)
class CaseResult:
    """Result of a case.

    Attributes:
        figures: Numbers, as plain values.
        arrays: Arrays by name.
    """

    figures: Mapping[str, Any]
    arrays: Mapping[str, np.ndarray] = field(default_factory=dict)

    def save(self, path: Path) -> None:
        """Write to one file atomically."""
        content = {"figures": dict(self.figures), "versions": versions()}
        text = np.array(json.dumps(content))
        with atomic_path(path) as temporary, open(temporary, "wb") as file:
            np.savez_compressed(file, **{_FIGURES: text}, **self.arrays)  # type: ignore[arg-type]

    @staticmethod
    def load(path: Path) -> "CaseResult":
        """Read a result written by `save`.

        Raises:
            FileError: The file is damaged.
        """
        try:
            with np.load(path, allow_pickle=False) as content:
                arrays = {name: content[name] for name in content.files if name != _FIGURES}
                return CaseResult(json.loads(str(content[_FIGURES]))["figures"], arrays)
        except Exception as error:  # a damaged archive can raise anything
            raise FileError(
                f"'{path}' is damaged ({error}); delete it to compute it again."
            ) from error


def run_cases(
    cases: Sequence[Case], folder: Path, workers: int | None, progress: ProgressCallback
) -> tuple[dict[str, CaseResult], dict[str, str]]:
    """Compute the cases of a study that are not stored, and return all results.

    Args:
        cases: Cases of one study.
        folder: Folder of the results and of the state of unfinished cases.
        workers: Number of processes; the number of cores if None.
        progress: Called after each case.

    Returns:
        Results by name of the case, and the error messages of failed cases.

    Raises:
        FileError: A stored result is damaged.
        TactorchError: A worker process was killed.
    """
    paths = {case.name: folder / case.study / f"{case.key}.npz" for case in cases}
    missing = [case for case in cases if not paths[case.name].is_file()]
    stored = len(cases) - len(missing)
    failed: dict[str, str] = {}
    progress(stored, len(cases), "")
    if len(missing) > 1 and workers != 1:
        finished = run_in_processes(partial(_run_case, folder), missing, workers)
    else:
        finished = (_run_case(folder, case) for case in missing)
    for done, (case, reason) in enumerate(finished, start=1):
        if reason:
            failed[case.name] = reason
        progress(stored + done, len(cases), f", {len(failed)} failed" if failed else "")
    results = {name: CaseResult.load(path) for name, path in paths.items() if path.is_file()}
    return results, failed


def _run_case(folder: Path, case: Case) -> tuple[Case, str]:
    """Compute and store one case; return it with the error message of a failure."""
    scratch = folder / case.study / f"{case.key}.unfinished"
    try:
        with single_thread():
            result = import_module(f"tactorch.reproduce.{case.study}").run_case(case, scratch)
        result.save(folder / case.study / f"{case.key}.npz")
    except TactorchError as error:
        return case, " ".join(str(error).split())
    except Exception as error:  # a failed case must not end the others
        return case, f"{type(error).__name__}: {' '.join(str(error).split())}"
    shutil.rmtree(scratch, ignore_errors=True)
    return case, ""
