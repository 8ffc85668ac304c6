"""What a live run shows: a table at a terminal, lines elsewhere, a picture and a page."""

import logging
import math
import sys
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tactorch.cli.live_page import page
from tactorch.cli.outputs import finding
from tactorch.cli.settings import log
from tactorch.files import atomic_path
from tactorch.sampling.live import Ended, Seen

if TYPE_CHECKING:
    from rich.live import Live
    from rich.table import Table

PAGE, PICTURE = "live.html", "live.png"
COLUMNS = ("press", "seconds", "chi2", "inclusion", "deviation", "next press")
_ROWS = 14  # of the table at a terminal
_NOTES = 3


class Screen:
    """Shows a live run; a `tactorch.sampling.live.View`."""

    def __init__(self, folder: Path, source: Path, *, plots: bool = True) -> None:
        """Take the run's folder, what it follows, and whether to draw."""
        self._folder, self._source, self._plots = folder, source, plots
        self._entries: list[dict[str, Any]] = []
        self._notes: list[str] = []
        self._status, self._finding = "waiting for the first press", ""
        self._stack = ExitStack()
        self._live: Live | None = None

    def __enter__(self) -> "Screen":
        """Take the terminal over, if there is one."""
        at_terminal = sys.stdout.isatty()
        _quieten(self._stack, everything=at_terminal)
        if at_terminal:
            from rich.live import Live

            self._live = Live(self._table(), refresh_per_second=4)
            self._stack.enter_context(self._live)
        self._write_page(refresh=True)
        log.info("following %s; look at %s", self._source, self._folder / PAGE)
        return self

    def __exit__(self, *error: object) -> None:
        """Give the terminal back."""
        self._stack.close()

    def waiting(self, presses: int, idle_seconds: float) -> None:
        """See `View.waiting`."""
        self._status = f"{presses} presses; waiting for the next, {idle_seconds:.0f} s"
        self._refresh()

    def resumed(self, history: Sequence[Mapping[str, Any]]) -> None:
        """See `View.resumed`."""
        self._entries = [dict(entry) for entry in history]
        presses = history[-1]["press"] if history else 0
        self._status = f"continues a run of {presses} presses"
        log.info("continuing a run of %d presses in %s", presses, self._folder)
        self._write_page(refresh=True)

    def show_message(self, text: str) -> None:
        """See `View.show_message`."""
        self._notes.append(text)
        log.warning("%s", text)
        self._write_page(refresh=True)
        self._refresh()

    def updated(self, seen: Seen) -> None:
        """See `View.updated`."""
        self._entries.append(seen.entry)
        self._finding = finding(seen.inclusion, seen.entry["youngs_median_mpa"])
        self._status = f"{seen.entry['press']} presses; looking for the next place"
        number, seconds, chi2, found = cells(seen.entry)[:4]
        log.info("press %s: %s, chi2 %s, %s", number, seconds, chi2, found)
        self._refresh()
        self._draw(seen)
        self._write_page(refresh=True)

    def suggested(self, seen: Seen) -> None:
        """See `View.suggested`."""
        self._status = f"{seen.entry['press']} presses; waiting for the next"
        row = cells(seen.entry)
        log.info("  deviation %s; next press %s", row[4], row[5])
        self._refresh()
        if seen.suggestion is not None and seen.suggestion.patch is not None:
            self._draw(seen)
        self._write_page(refresh=True)

    def ended(self, ended: Ended) -> None:
        """The run is over; the page refreshes itself no more."""
        self._status = f"ended: {ended.reason}"
        self._write_page(refresh=False)
        self._refresh()

    def _draw(self, seen: Seen) -> None:
        if not self._plots:
            return
        from tactorch.viz import save_figure
        from tactorch.viz.live import live_figure

        recording = seen.recording
        patch = None if seen.suggestion is None else seen.suggestion.patch
        figure = live_figure(
            recording.mesh,
            seen.found.result.youngs,
            pressed=np.sum([np.abs(press.forces) for press in recording.presses], axis=0),
            inclusion_mm=None if seen.inclusion is None else seen.inclusion.center_mm,
            next_mm=None if patch is None else patch.center,
            inward=None if patch is None else patch.inward,
            radius_mm=0.0 if patch is None else float(patch.radius_mm),
            title=f"Young's modulus after {seen.entry['press']} presses",
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
    """Return a line of the history in words, by `COLUMNS`."""
    return (
        str(entry["press"]) if entry["names"] else f"{entry['press']}, at rest",
        f"{entry['seconds']:.1f} s",
        f"{entry['chi2']:.2g}",
        _inclusion(entry),
        _deviation(entry),
        _next(entry),
    )


def _inclusion(entry: dict[str, Any]) -> str:
    found = entry["inclusion"]
    if found is None:
        return f"none; {entry['youngs_median_mpa']:.3g} MPa"
    x, y, z = found["center_mm"]
    return (
        f"{found['side']} at ({x:.1f}, {y:.1f}, {z:.1f}) mm, radius "
        f"{found['equivalent_radius_mm']:.1f} mm: {found['mean_mpa']:.3g} MPa in "
        f"{found['background_mpa']:.3g}"
    )


def _deviation(entry: dict[str, Any]) -> str:
    """Standard deviation of the modulus as a factor: of the map, and within the inclusion."""
    whole, within = entry.get("deviation"), entry.get("deviation_inclusion")
    if whole is None:
        return "-"
    inside = "" if within is None else f", inclusion ×{math.exp(within):.2f}"
    return f"×{math.exp(whole):.2f}{inside}"


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
    """Keep lines to the log file: an optimizer's always, at a terminal with a table all."""

    def kept(record: logging.LogRecord) -> bool:
        return not everything and record.name != "tactorch.inverse.monitor"

    for handler in logging.getLogger().handlers:
        if not isinstance(handler, logging.FileHandler):
            handler.addFilter(kept)
            stack.callback(handler.removeFilter, kept)
