"""Display of a live run: a table at a terminal, log lines elsewhere, a figure and a page."""

import base64
import logging
import math
import sys
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jinja2 import Environment, StrictUndefined

from tactorch.cli.console import is_no_iteration, log, terminal_log
from tactorch.files import write_file
from tactorch.findings.text import describe_finding, summarize_finding, summarize_plain
from tactorch.progress import without_progress
from tactorch.sampling import LoopResult, Observer, Update

if TYPE_CHECKING:
    from rich.live import Live
    from rich.table import Table

PAGE, PICTURE = "live.html", "live.png"
COLUMNS = ("press", "seconds", "chi2", "finding", "deviation", "next press")
_ROWS = 14  # of the table at a terminal
_NOTES = 3
_PAGE_TEMPLATE = """\
<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8">
{%- if refresh %}<meta http-equiv="refresh" content="2">{% endif %}
<title>tactorch live: {{ source.name }}</title><style>
body { font: 15px/1.45 system-ui, sans-serif; color: #1b1f24; margin: 1.5rem auto; max-width: 66rem;
       padding: 0 1rem; }
h1 { font-size: 1.25rem; margin: 0; }
.status { color: #57606a; margin: 0.2rem 0 1rem; }
.finding { font-size: 1.1rem; font-weight: 600; margin: 0.4rem 0; white-space: pre-line; }
.next { font-size: 1.1rem; margin: 0.4rem 0 1rem; color: #8a1f63; }
.note { background: #fff4e5; border-left: 4px solid #d55e00; padding: 0.3rem 0.7rem; }
img { width: 100%; height: auto; }
table { border-collapse: collapse; width: 100%; font-size: 13px; margin-top: 1rem; }
th, td { text-align: left; padding: 0.25rem 0.6rem; border-bottom: 1px solid #d0d7de; }
th { color: #57606a; font-weight: 600; }
</style></head>
<body><h1>{{ source }}</h1>
<p class="status">{{ status }}</p>
{% if finding %}<p class="finding">{{ finding }}</p>{% endif %}
{% if rows and rows[0][-1] != "-" %}<p class="next">Press next: {{ rows[0][-1] }}</p>{% endif %}
{% for note in notes %}<p class="note">{{ note }}</p>{% endfor %}
{% if picture %}
<img alt="slices of the map" src="data:image/png;base64,{{ picture }}">
{% endif %}
{% if rows %}
<table><tr>{% for name in columns %}<th>{{ name }}</th>{% endfor %}</tr>
{% for row in rows %}
<tr>{% for cell in row %}<td>{{ cell }}</td>{% endfor %}</tr>
{% endfor %}
</table>
{% endif %}
</body></html>
"""


class Screen(Observer):
    """Display of a live run."""

    def __init__(self, folder: Path, source: Path, *, plots: bool = True) -> None:
        self._folder, self._source, self._plots = folder, source, plots
        self._entries: list[dict[str, Any]] = []
        self._notes: list[str] = []
        self._status, self._finding = "waiting for the first press", ""
        self._stack = ExitStack()
        self._live: Live | None = None

    def __enter__(self) -> "Screen":
        """Start the table, at a terminal."""
        at_terminal = sys.stdout.isatty()
        # A table replaces all log lines.
        is_shown = (lambda record: False) if at_terminal else _is_event
        self._stack.enter_context(terminal_log(is_shown))
        self._stack.enter_context(without_progress())
        if at_terminal:
            from rich.live import Live

            self._live = self._stack.enter_context(Live(self._table(), refresh_per_second=4))
        self._show()
        log.info("following %s; open %s", self._source, self._folder / PAGE)
        return self

    def __exit__(self, *error: object) -> None:
        """End the table."""
        self._stack.close()

    def waiting(self, presses: int, idle_seconds: float) -> None:
        """See `Observer.waiting`."""
        self._status = f"{presses} presses; waiting for the next, {idle_seconds:.0f} s"
        self._refresh()

    def resumed(self, history: Sequence[Mapping[str, Any]]) -> None:
        """See `Observer.resumed`."""
        self._entries = [dict(entry) for entry in history]
        presses = history[-1]["press"] if history else 0
        self._finding = _summarize(history[-1]) if history else ""
        self._status = f"continues a run of {presses} presses"
        log.info("continuing a run of %d presses in %s", presses, self._folder)
        self._show()

    def show_message(self, text: str) -> None:
        """See `Observer.show_message`."""
        self._notes.append(text)
        log.warning("%s", text)
        self._show()

    def updated(self, update: Update) -> None:
        """See `Observer.updated`."""
        self._entries.append(update.entry)
        self._finding = finding_text(update)
        self._status = f"{update.entry['press']} presses; choosing the next place"
        number, seconds, chi2, finding = _cells(update.entry)[:4]
        log.info("press %s: %s, chi2 %s, %s", number, seconds, chi2, finding)
        self._refresh()
        self._draw(update)
        self._show()

    def suggested(self, update: Update) -> None:
        """See `Observer.suggested`."""
        self._status = f"{update.entry['press']} presses; waiting for the next"
        log.info("  deviation %s; next press %s", *_cells(update.entry)[4:])
        if update.suggestion is not None and update.suggestion.patch is not None:
            self._draw(update)
        self._show()

    def found(self, update: Update) -> None:
        """See `Observer.found`."""
        self._finding = finding_text(update)
        log.info("press %s, shapes: %s", update.entry["press"], self._finding)
        self._draw(update)
        self._show()

    def ended(self, result: LoopResult) -> None:
        """Show the end; the page no longer reloads itself."""
        self._status = f"ended: {result.reason}"
        self._show(reload=False)

    def _draw(self, update: Update) -> None:
        if not self._plots:
            return
        from tactorch.viz import save_figure
        from tactorch.viz.slices import live_figure

        patch = None if update.suggestion is None else update.suggestion.patch
        lump = next(iter(update.finding.lumps), None)
        figure = live_figure(
            update.recording.mesh,
            update.youngs,
            pressed=np.sum([np.abs(press.forces) for press in update.recording.presses], axis=0),
            inclusion_mm=None if lump is None else lump.inclusion.center_mm,
            next_mm=None if patch is None else patch.center,
            inward=None if patch is None else patch.inward,
            radius_mm=0.0 if patch is None else float(patch.radius_mm),
            title=f"Young's modulus after {update.entry['press']} presses",
        )
        save_figure(figure, self._folder / PICTURE, dpi=110)

    def _show(self, *, reload: bool = True) -> None:
        """Update the table and write the page, which may reload itself."""
        self._refresh()
        path = self._folder / PICTURE
        picture = path.read_bytes() if self._entries and path.is_file() else b""
        environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True)
        text = environment.from_string(_PAGE_TEMPLATE).render(
            source=self._source,
            status=self._status,
            finding=self._finding,
            notes=self._notes[-_NOTES:],
            columns=COLUMNS,
            rows=[_cells(entry) for entry in reversed(self._entries)],
            picture=base64.b64encode(picture).decode("ascii"),
            refresh=reload,
        )
        write_file(self._folder / PAGE, text)

    def _refresh(self) -> None:
        if self._live is not None:
            self._live.update(self._table())

    def _table(self) -> "Table":
        from rich.markup import escape
        from rich.table import Table

        lines = [self._finding, self._status, *(f"! {note}" for note in self._notes[-_NOTES:])]
        table = Table(caption="\n".join(escape(line) for line in lines if line))
        table.caption_justify = "left"
        for name in COLUMNS:
            table.add_column(name, justify="right" if name in COLUMNS[:3] else "left")
        for entry in self._entries[-_ROWS:]:
            table.add_row(*map(escape, _cells(entry)))
        return table


def finding_text(update: Update) -> str:
    """Return the finding of an update, and of how many presses it is if not of all."""
    return describe_finding(update.finding, update.finding_presses, update.entry["press"])


def _is_event(record: logging.LogRecord) -> bool:
    """Return whether a log record is other than a step of an inversion or a search for shapes."""
    is_step = record.name.startswith("tactorch.inverse.shapes") and record.levelno <= logging.INFO
    return is_no_iteration(record) and not is_step


def _cells(entry: dict[str, Any]) -> tuple[str, ...]:
    """Return the cells of a history entry, in the order of `COLUMNS`."""
    return (
        str(entry["press"]) if entry["names"] else f"{entry['press']}, refined",
        f"{entry['seconds']:.1f} s",
        f"{entry['chi2']:.2g}",
        _summarize(entry),
        _format_deviation(entry),
        _format_suggestion(entry),
    )


def _summarize(entry: Mapping[str, Any]) -> str:
    """Return the finding of an entry; of runs of earlier versions, the inclusion of its map."""
    if "finding" not in entry:
        return summarize_plain(entry["inclusion"], entry["youngs_median_mpa"])
    presses = entry["finding_presses"]
    fewer = "" if presses == entry["press"] else f"; of the first {presses} presses"
    return summarize_finding(entry["finding"]) + fewer


def _format_deviation(entry: dict[str, Any]) -> str:
    """Return the standard deviation of the modulus as a factor: of the map and the inclusion."""
    overall, within = entry.get("deviation"), entry.get("deviation_inclusion")
    if overall is None:
        return "-"
    inside = "" if within is None else f", inclusion ×{math.exp(within):.2f}"
    return f"×{math.exp(overall):.2f}{inside}"


def _format_suggestion(entry: dict[str, Any]) -> str:
    if "next" not in entry:
        return "-"
    place = entry["next"]
    if place is None:
        return f"none: {entry['next_why_not']}"
    point, normal = (
        ", ".join(f"{value + 0.0:.{digits}f}" for value in place[key])
        for key, digits in (("center_mm", 1), ("inward", 2))
    )
    return f"({point}) mm along ({normal})"
