"""Display of a live run: a table at a terminal, log lines elsewhere, a figure and a page."""

import logging
import math
import sys
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tactorch.cli.live_page import page
from tactorch.cli.settings import log
from tactorch.files import atomic_path
from tactorch.findings.text import summarize_inclusion, summarize_plain
from tactorch.sampling import LoopResult, Observer, Update

if TYPE_CHECKING:
    from rich.live import Live
    from rich.table import Table

PAGE, PICTURE = "live.html", "live.png"
COLUMNS = ("press", "seconds", "chi2", "inclusion", "deviation", "next press")
_ROWS = 14  # of the table at a terminal
_NOTES = 3


class Screen(Observer):
    """Display of a live run.

    Args:
        folder: Folder of the run.
        source: Recording that is followed.
        plots: Whether to draw the figure.
    """

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
        _quieten(self._stack, everything=at_terminal)
        if at_terminal:
            from rich.live import Live

            self._live = Live(self._table(), refresh_per_second=4)
            self._stack.enter_context(self._live)
        self._write_page(refresh=True)
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
        self._status = f"continues a run of {presses} presses"
        log.info("continuing a run of %d presses in %s", presses, self._folder)
        self._write_page(refresh=True)

    def show_message(self, text: str) -> None:
        """See `Observer.show_message`."""
        self._notes.append(text)
        log.warning("%s", text)
        self._write_page(refresh=True)
        self._refresh()

    def updated(self, update: Update) -> None:
        """See `Observer.updated`."""
        self._entries.append(update.entry)
        self._finding = summarize_inclusion(update.lump, update.entry["youngs_median_mpa"])
        self._status = f"{update.entry['press']} presses; choosing the next place"
        number, seconds, chi2, lump = cells(update.entry)[:4]
        log.info("press %s: %s, chi2 %s, %s", number, seconds, chi2, lump)
        self._refresh()
        self._draw(update)
        self._write_page(refresh=True)

    def suggested(self, update: Update) -> None:
        """See `Observer.suggested`."""
        self._status = f"{update.entry['press']} presses; waiting for the next"
        row = cells(update.entry)
        log.info("  deviation %s; next press %s", row[4], row[5])
        self._refresh()
        if update.suggestion is not None and update.suggestion.patch is not None:
            self._draw(update)
        self._write_page(refresh=True)

    def ended(self, result: LoopResult) -> None:
        """Show the end; the page no longer reloads itself."""
        self._status = f"ended: {result.reason}"
        self._write_page(refresh=False)
        self._refresh()

    def _draw(self, update: Update) -> None:
        if not self._plots:
            return
        from tactorch.viz import save_figure
        from tactorch.viz.slices import live_figure

        recording = update.recording
        patch = None if update.suggestion is None else update.suggestion.patch
        figure = live_figure(
            recording.mesh,
            update.youngs,
            pressed=np.sum([np.abs(press.forces) for press in recording.presses], axis=0),
            inclusion_mm=None if update.lump is None else update.lump.center_mm,
            next_mm=None if patch is None else patch.center,
            inward=None if patch is None else patch.inward,
            radius_mm=0.0 if patch is None else float(patch.radius_mm),
            title=f"Young's modulus after {update.entry['press']} presses",
        )
        save_figure(figure, self._folder / PICTURE, dpi=110)

    def _write_page(self, refresh: bool) -> None:
        rows = [cells(entry) for entry in reversed(self._entries)]
        text = page(
            source=str(self._source),
            status=self._status,
            finding=self._finding,
            notes=self._notes[-_NOTES:],
            columns=COLUMNS,
            rows=rows,
            picture=self._folder / PICTURE if self._entries else None,
            refresh=refresh,
        )
        with atomic_path(self._folder / PAGE) as path:
            path.write_text(text, encoding="utf-8")

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
            table.add_row(*map(escape, cells(entry)))
        return table


def cells(entry: dict[str, Any]) -> tuple[str, ...]:
    """Return the cells of a history entry, in the order of `COLUMNS`."""
    return (
        str(entry["press"]) if entry["names"] else f"{entry['press']}, refined",
        f"{entry['seconds']:.1f} s",
        f"{entry['chi2']:.2g}",
        summarize_plain(entry["inclusion"], entry["youngs_median_mpa"]),
        _deviation(entry),
        _next(entry),
    )


def _deviation(entry: dict[str, Any]) -> str:
    """Standard deviation of the modulus as a factor: over the map, and over the inclusion."""
    overall, within = entry.get("deviation"), entry.get("deviation_inclusion")
    if overall is None:
        return "-"
    inside = "" if within is None else f", inclusion ×{math.exp(within):.2f}"
    return f"×{math.exp(overall):.2f}{inside}"


def _next(entry: dict[str, Any]) -> str:
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


def _quieten(stack: ExitStack, everything: bool) -> None:
    """Keep log lines off the terminal: the optimizer's, or all if there is a table."""

    def is_shown(record: logging.LogRecord) -> bool:
        return not everything and record.name != "tactorch.inverse.monitor"

    for handler in logging.getLogger().handlers:
        if not isinstance(handler, logging.FileHandler):
            handler.addFilter(is_shown)
            stack.callback(handler.removeFilter, is_shown)
