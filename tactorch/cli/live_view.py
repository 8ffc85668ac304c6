"""Display of a live run: a table at a terminal, log lines elsewhere, a figure and a page."""

import logging
import math
import sys
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tactorch.cli.console import is_no_iteration, log, terminal_log
from tactorch.inverse.result.text import describe, headline, summarize_finding, summarize_plain
from tactorch.progress import without_progress
from tactorch.report import Run
from tactorch.report.content import RunReport
from tactorch.report.live import PAGE, LivePage
from tactorch.sampling import LoopResult, Observer, Patch, Update

if TYPE_CHECKING:
    from rich.live import Live
    from rich.table import Table

PICTURE = "live.png"
COLUMNS = ("press", "seconds", "chi2", "finding", "deviation", "next press")
_ROWS = 14  # of the table at a terminal
_NOTES = 3


class Screen(Observer):
    """Display of a live run."""

    def __init__(
        self, folder: Path, source: Path, *, plots: bool = True, name: str | None = None
    ) -> None:
        self._folder, self._source, self._plots = folder, source, plots
        self._name = name or source.name
        self._entries: list[dict[str, Any]] = []
        self._notes: list[str] = []
        self._status, self._finding = "waiting for the first press", ""
        self._update: Update | None = None
        self._version = 0
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
        self._status = f"{update.entry['press']} presses; choosing the next place"
        log.info("press %s: %s, chi2 %s, %s", *_cells(update.entry)[:4])
        self._present(update)

    def suggested(self, update: Update) -> None:
        """See `Observer.suggested`."""
        self._status = f"{update.entry['press']} presses; waiting for the next"
        log.info("  deviation %s; next press %s", *_cells(update.entry)[4:])
        self._present(update, draw=_next_press(update) is not None)

    def found(self, update: Update) -> None:
        """See `Observer.found`."""
        log.info("press %s, shapes: %s", update.entry["press"], finding_text(update))
        self._present(update)

    def ended(self, result: LoopResult) -> None:
        """Show the end; an open page asks for no more."""
        self._status = f"ended: {result.reason}"
        self._show(ended=True)

    def _present(self, update: Update, *, draw: bool = True) -> None:
        self._update, self._finding = update, finding_text(update)
        self._refresh()
        if draw and self._plots:
            self._draw(update)
        self._show()

    def _draw(self, update: Update) -> None:
        from tactorch.viz import save_figure
        from tactorch.viz.slices import live_figure

        lump = next(iter(update.result.lumps), None)
        figure = live_figure(
            update.recording.mesh,
            update.youngs,
            pressed=np.sum([np.abs(press.forces) for press in update.recording.presses], axis=0),
            inclusion_mm=None if lump is None else lump.inclusion.center_mm,
            next_press=_next_press(update),
            title=f"Young's modulus after {update.entry['press']} presses",
        )
        save_figure(figure, self._folder / PICTURE, dpi=110)

    def _show(self, *, ended: bool = False) -> None:
        """Update the table and the page."""
        self._refresh()
        self._version += 1
        rows = [_cells(entry) for entry in reversed(self._entries)]
        update = self._update
        following = rows[0][-1] if rows and rows[0][-1] != "-" else ""
        LivePage(
            name=self._name,
            version=self._version,
            texts={
                "status": self._status,
                "headline": "No press yet" if update is None else headline(update.result),
                "finding": self._finding,
                "next": f"Press next: {following}" if following else "",
            },
            columns=COLUMNS,
            rows=rows,
            notes=self._notes[-_NOTES:],
            report=None if update is None else _report(update, self._folder, self._name),
            next_press=_next_press(update),
            ended=ended,
        ).write(self._folder)

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


def _report(update: Update, folder: Path, name: str) -> RunReport:
    """Return the result for the viewer; the truth is not shown."""
    recording = replace(update.recording, truth=None, reference=None, check_units=False)
    return RunReport(Run(folder, name, update.result, recording))


def _next_press(update: Update | None) -> Patch | None:
    """Return the place that was chosen for the next press, if there is one."""
    return update.suggestion.patch if update and update.suggestion else None


def finding_text(update: Update) -> str:
    """Return the finding of an update, and of how many presses it is if not of all."""
    return describe(update.result, update.result_presses, update.entry["press"])


def _is_event(record: logging.LogRecord) -> bool:
    """Return whether a log record is other than a step of an inversion or a search for shapes."""
    is_step = record.name.startswith("tactorch.inverse.search") and record.levelno <= logging.INFO
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
