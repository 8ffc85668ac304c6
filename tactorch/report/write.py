"""Rendering of runs to one HTML file."""

import logging
from collections.abc import Sequence
from datetime import datetime
from importlib.resources import files
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from tactorch.errors import ConfigError
from tactorch.files import write_file
from tactorch.inverse import Reconstruction
from tactorch.recording import Recording
from tactorch.report.assessment import ProgressCallback, assess
from tactorch.report.content import (
    RunReport,
    difference_table,
    history_table,
    score_table,
    versions_table,
)
from tactorch.report.figure_data import COLOURS, figure_data, script_json
from tactorch.report.runs import Run
from tactorch.text import printable
from tactorch.versions import versions

_SCRIPTS = (
    "core.js", "mesh.js", "slices.js", "solid.js", "charts.js", "controls.js", "main.js",
)  # fmt: skip
_LARGE_BYTES = 10_000_000

_log = logging.getLogger("tactorch")


def write_report(
    runs: Sequence[Run],
    out: str | Path,
    *,
    uncertainty: bool = True,
    colours: str = "viridis",
    progress: ProgressCallback | None = None,
) -> Path:
    """Write a self-contained HTML file that needs no server or network; return its path.

    Args:
        runs: One inversion, or several to compare; see `load_run`.
        out: Path of the file.
        uncertainty: Whether the presses are solved again for credibility and posterior.
        colours: Initial colour map: "viridis", "cividis" or "ultrasound" (grey); the page has a
            control for it.
        progress: Called before each step of a long computation.
    """
    if not runs:
        raise ConfigError("write_report: no run given; pass at least one.")
    if colours not in COLOURS:
        raise ConfigError(f"colours={colours} is unknown; choose one of {', '.join(COLOURS)}.")
    reports = [assess(run, uncertainty=uncertainty, progress=progress) for run in runs]
    page = _render(reports, colours)
    write_file(out, page)
    if len(page) > _LARGE_BYTES:
        _log.warning("the report has %.0f MB because its meshes are large", len(page) / 1e6)
    return Path(out)


def report_of(
    result: Reconstruction,
    path: str | Path,
    recording: Recording | None = None,
    **options: Any,
) -> Path:
    """Write the report of a result that is in no folder of a run; return its path.

    Args:
        result: The result of `invert`.
        path: Path of the file.
        recording: Its presses.
        options: Options of `write_report`.
    """
    missing = "" if recording is not None else "no recording was given"
    place, text = Path(path), result.summary()
    run = Run(place.parent, place.stem, result, recording, missing, text=text)
    return write_report([run], path, **options)


def _render(reports: Sequence[RunReport], colours: str) -> str:
    """Return the page as HTML; all text is escaped."""
    runs = [report.run for report in reports]
    recordings = [run.recording for run in runs if run.recording is not None]
    title = f"{runs[0].name}: {reports[0].headline}"
    now = datetime.now().astimezone()
    return render(
        "page.html",
        _SCRIPTS,
        figure_data(reports, colours),
        title=title if len(runs) == 1 else f"{len(runs)} runs compared",
        created=f"{now:%d %B %Y, %H:%M} by tactorch {versions()['tactorch']}",
        reports=reports,
        has_truth=any(recording.truth is not None for recording in recordings),
        scores=score_table(runs),
        histories=[history_table(run) for run in runs],
        differences=difference_table(runs),
        versions=versions_table(runs),
    )


def render(template: str, scripts: Sequence[str], data: Any, **content: Any) -> str:
    """Return a page as HTML, with its scripts and their data; all text is escaped."""
    environment = Environment(
        loader=PackageLoader("tactorch.report", "page"), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True, finalize=_printable,
    )  # fmt: skip
    return environment.get_template(template).render(
        style=Markup(_asset("style.css")),
        script=Markup("\n".join(map(_asset, scripts))),
        data=Markup(script_json(data)),
        **content,
    )


def _printable(value: Any) -> Any:
    return printable(value) if isinstance(value, str) and not isinstance(value, Markup) else value


def _asset(name: str) -> str:
    """Return the text of a file of the page."""
    return (files("tactorch.report") / "page" / name).read_text(encoding="utf-8")
