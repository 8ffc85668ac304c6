"""Sweeps: names of the folders of their jobs, and a table and a picture of all of them."""

import csv
import io
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tactorch.cli import console
from tactorch.errors import FileError
from tactorch.files import read_json, write_file

if TYPE_CHECKING:
    from tactorch.inverse import Reconstruction

TABLE, PICTURE = "runs.csv", "runs.png"
_RESOLVER = "tactorch_job"
#: Folder of a job below that of the sweep.
SUBFOLDER = f"${{{_RESOLVER}:${{hydra.job.num}},${{hydra:job.override_dirname}}}}"
_MAX_LENGTH = 100  # of a folder's name
# Numbers of a summary that the table has, where a run has them, and their format.
_NUMBERS = {
    "chi2": ".3g", "iterations": "d", "seconds": ".1f", "rmse_mpa": ".3g", "pearson": ".3f",
    "position_error_mm": ".2f", "contrast_recovery": ".2f", "dice": ".2f",
}  # fmt: skip


@dataclass(frozen=True)
class Job:
    """A job of a sweep."""

    folder: Path  # of its results
    settings: Mapping[str, str]  # values of those that differ between jobs
    failed: bool

    @property
    def name(self) -> str:
        """What differs from other jobs."""
        return ", ".join(f"{key}={value}" for key, value in self.settings.items())

    def summary(self) -> dict[str, Any]:
        """Return the content of `summary.json`; empty where there is none."""
        with suppress(FileError):
            if not self.failed:
                return read_json(self.folder / "summary.json", "summary", "run the job again.")
        return {}


def register_names() -> None:
    """Let Hydra name the folder of each job by the settings that differ."""
    from omegaconf import OmegaConf

    used: dict[str, int] = {}

    def name(number: Any, differing: Any) -> str:
        # Without "=" and ",", which would have to be quoted in settings.
        text = re.sub(r"[^\w.+]+", "-", str(differing).replace(",", "_")).strip("-_.")
        if not text or text == "None":
            return str(number)
        if len(text) > _MAX_LENGTH or used.setdefault(text, int(number)) != int(number):
            return f"{text[:_MAX_LENGTH]}-{number}"
        return text

    OmegaConf.register_new_resolver(_RESOLVER, name, replace=True)


def summarize(jobs: Sequence[Job]) -> None:
    """Print a table of the jobs, and write it, and a picture of their maps, into their folder."""
    if len(jobs) < 2:
        return
    folder = jobs[0].folder.parent
    table = make_table(jobs)
    console.show(table)
    buffer = io.StringIO()
    csv.writer(buffer).writerows([table.header, *table.rows])
    write_file(folder / TABLE, buffer.getvalue())
    print(f"table: {folder / TABLE}")
    maps = _maps(jobs)
    if len(maps) > 1:
        from tactorch.viz import comparison_figure, save_figure

        save_figure(comparison_figure(maps), folder / PICTURE)
        print(f"picture: {folder / PICTURE}")


def make_table(jobs: Sequence[Job]) -> console.Table:
    """Return the settings that differ, and the numbers of each job."""
    keys = list(dict.fromkeys(key for job in jobs for key in job.settings))
    summaries = [job.summary() for job in jobs]
    numbers = [name for name in _NUMBERS if any(name in summary for summary in summaries)]
    rows = []
    for job, summary in zip(jobs, summaries, strict=True):
        cells = [_format(summary.get(name), _NUMBERS[name]) for name in numbers]
        state = "failed" if job.failed else _finding(summary)
        rows.append([*(job.settings.get(key, "") for key in keys), state, *cells])
    return console.Table([*keys, "result", *numbers], rows, words=len(keys) + 1)


def _format(value: int | float | None, style: str) -> str:
    return "-" if value is None else format(value, style)


def _finding(summary: Mapping[str, Any]) -> str:
    """Return the finding in a word or two."""
    if "finding" not in summary:
        return "done"
    status, count = summary["finding"]["status"], len(summary["finding"]["lumps"])
    found = "1 lump" if count == 1 else f"{count} lumps"
    return found if status == "found" else str(status)


def _maps(jobs: Sequence[Job]) -> "dict[str, Reconstruction]":
    from tactorch.inverse import Reconstruction

    paths = {job.name: job.folder / "reconstruction.h5" for job in jobs if not job.failed}
    return {name: Reconstruction.load(path) for name, path in paths.items() if path.is_file()}
