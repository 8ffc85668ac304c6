"""Cases of a study: run in parallel, each stored when it is done; and exhibits of their results.

The settings of a case identify its stored result, so that an interrupted run can be continued.
"""

import csv
import json
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from hashlib import sha256
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from tactorch.errors import FileError, TactorchError
from tactorch.files import atomic_path, read_arrays, write_arrays
from tactorch.mesh import TetMesh
from tactorch.processes import run_in_processes, single_thread
from tactorch.versions import versions
from tactorch.viz import save_figure

#: Plain values that determine the result of a case, or the cases of a study.
CaseSettings = Mapping[str, Any]
#: Called with the number of finished cases, their total and a note.
ProgressCallback = Callable[[int, int, str], None]
_FIGURES = "figures"
_REMEDY = "delete it to compute it again."


@dataclass(frozen=True, eq=False)
class CaseResult:
    """Result of a case: numbers, as plain values, and arrays by name."""

    figures: Mapping[str, Any]
    arrays: Mapping[str, np.ndarray] = field(default_factory=dict)

    @classmethod
    def on_mesh(
        cls, mesh: TetMesh, figures: Mapping[str, Any], **arrays: np.ndarray
    ) -> "CaseResult":
        """Return a result whose arrays include those of the mesh."""
        return cls(figures, {"points": mesh.points, "tets": mesh.tets, **arrays})

    @property
    def mesh(self) -> TetMesh:
        """Mesh of a result made by `on_mesh`."""
        return TetMesh.create(self.arrays["points"], self.arrays["tets"])

    def save(self, path: Path) -> None:
        """Write to one file atomically."""
        text = np.array(json.dumps({"figures": dict(self.figures), "versions": versions()}))
        write_arrays(path, {_FIGURES: text, **self.arrays}, compressed=True)

    @staticmethod
    def load(path: Path) -> "CaseResult":
        """Read a result written by `save`."""
        arrays = read_arrays(path, "stored case", _REMEDY)
        try:
            figures = json.loads(str(arrays.pop(_FIGURES)))["figures"]
        except (KeyError, ValueError) as error:
            raise FileError(f"stored case '{path}' is damaged ({error!r}); {_REMEDY}") from error
        return CaseResult(figures, arrays)


Results = Mapping[str, CaseResult]


def run_cases(
    study: str,
    cases: Mapping[str, CaseSettings],
    folder: Path,
    workers: int | None,
    progress: ProgressCallback,
) -> tuple[dict[str, CaseResult], dict[str, str]]:
    """Compute the cases of a study that are not stored, and return all results.

    A study is a module of `tactorch.reproduce`, whose `run_case` computes a case. Results and the
    error messages of failed cases are by name of the case. Its folder also has the state of
    unfinished cases.
    """
    paths = {name: folder / study / _file_name(name, cases[name]) for name in cases}
    missing = [name for name in cases if not paths[name].is_file()]
    stored = len(cases) - len(missing)
    failed: dict[str, str] = {}
    progress(stored, len(cases), "")
    tasks = [(name, cases[name], paths[name]) for name in missing]
    run = partial(_run_case, study)
    parallel = len(missing) > 1 and workers != 1
    finished = run_in_processes(run, tasks, workers) if parallel else map(run, tasks)
    for done, (name, reason) in enumerate(finished, start=1):
        if reason:
            failed[name] = reason
        progress(stored + done, len(cases), f", {len(failed)} failed" if failed else "")
    return {name: CaseResult.load(path) for name, path in paths.items() if path.is_file()}, failed


def _file_name(name: str, settings: CaseSettings) -> str:
    content = json.dumps(dict(settings), sort_keys=True)
    return f"{name}-{sha256(content.encode()).hexdigest()[:10]}.npz"


def _run_case(study: str, task: tuple[str, CaseSettings, Path]) -> tuple[str, str]:
    """Compute and store one case; return its name and the error message of a failure."""
    name, settings, path = task
    scratch = path.with_suffix(".unfinished")
    try:
        with single_thread():
            result = import_module(f"tactorch.reproduce.{study}").run_case(settings, scratch)
        result.save(path)
    except Exception as error:  # a failed case must not end the others
        kind = "" if isinstance(error, TactorchError) else f"{type(error).__name__}: "
        return name, kind + " ".join(str(error).split())
    shutil.rmtree(scratch, ignore_errors=True)
    return name, ""


class Table:
    """Table; None is an empty cell.

    Args:
        columns: Names of the columns with units, and the number of decimals in Markdown of the
            floating-point numbers in each; 4 if None.
    """

    def __init__(self, columns: Mapping[str, int | None]) -> None:
        self.columns = columns
        self.rows: list[tuple[Any, ...]] = []

    def add(self, *values: Any) -> None:
        """Append a row with one value per column."""
        if len(values) != len(self.columns):
            raise ValueError(f"{len(values)} values for {len(self.columns)} columns")
        self.rows.append(values)

    def write_csv(self, path: Path) -> None:
        """Write the table with all digits."""
        with atomic_path(path) as temporary, open(temporary, "w", newline="") as file:
            csv.writer(file).writerows([self.columns, *self.rows])

    def markdown(self) -> str:
        """Return the table as Markdown."""
        lines = [list(self.columns), ["---"] * len(self.columns)]
        lines += [list(map(_format, row, self.columns.values())) for row in self.rows]
        return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _format(value: Any, digits: int | None) -> str:
    if isinstance(value, float):
        return f"{value:.{4 if digits is None else digits}f}"
    return "" if value is None else str(value)


@dataclass(frozen=True)
class Exhibit:
    """Paragraphs of an exhibit, its table for a CSV file, and its picture with a caption."""

    paragraphs: list[str]
    table: Table | None = None
    figure: Figure | None = None
    caption: str = ""

    def write(self, folder: Path, name: str) -> str:
        """Write the table and the picture, and return the text as Markdown."""
        paragraphs = [text for text in self.paragraphs if text]
        if self.table is not None:
            self.table.write_csv(folder / f"{name}.csv")
        if self.figure is not None:
            save_figure(self.figure, folder / f"{name}.png")
            paragraphs.append(f"![{self.caption}]({name}.png)")
        return "\n\n".join(paragraphs)
