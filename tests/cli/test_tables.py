"""Tables and progress: drawn at a terminal, plain and whole elsewhere."""

import io
import logging
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tactorch.cli.console import Table, is_rich, log, log_text, progress, show

LONG = "a" * 200
TABLE = Table(("what", "words", "number"), (("x", LONG, "1.5"), ("longer", "", "12.25")), 2)
COLOUR = re.compile(r"\x1b\[[0-9;]*m")


class Screen(io.StringIO):
    """A terminal."""

    def isatty(self) -> bool:
        return True


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Callable[[], Screen]:
    """Return a function that makes both streams a terminal of 80 columns."""
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.setenv("COLUMNS", "80")
    for name in ("NO_COLOR", "FORCE_COLOR", "COLORTERM"):
        monkeypatch.delenv(name, raising=False)

    def make() -> Screen:  # in the test itself: before it pytest sets the streams anew
        found = Screen()
        monkeypatch.setattr(sys, "stdout", found)
        monkeypatch.setattr(sys, "stderr", found)
        return found

    return make


def test_text_is_aligned_and_never_cut() -> None:
    assert TABLE.text().splitlines() == [
        f"what    {'words':<200}  number",
        f"x       {LONG}     1.5",
        f"longer  {'':<200}   12.25",
    ]
    assert Table(("", ""), (("a", "b"),), 2).text() == "a  b"


def test_elsewhere_than_at_a_terminal_it_is_text(capsys: pytest.CaptureFixture[str]) -> None:
    assert not is_rich()
    show(TABLE)
    assert capsys.readouterr().out == TABLE.text() + "\n"


def test_at_a_terminal_it_is_drawn_within_its_width(terminal: Callable[[], Screen]) -> None:
    screen = terminal()
    assert is_rich()
    show(TABLE)
    lines = screen.getvalue().splitlines()
    assert max(len(line) for line in lines) <= 80
    assert any("───" in line for line in lines)
    assert "12.25" in screen.getvalue()


def test_markup_in_cells_is_text(terminal: Callable[[], Screen]) -> None:
    screen = terminal()
    show(Table(("", ""), (("[red]not red[/red]", ":smile:"),), 2))
    assert "[red]not red[/red]" in screen.getvalue()
    assert ":smile:" in screen.getvalue()


def test_colour_unless_it_is_not_wanted(
    terminal: Callable[[], Screen], monkeypatch: pytest.MonkeyPatch
) -> None:
    screen = terminal()
    table = Table(("", ""), (("x", "NO"),), 2, {"NO": "red"})
    show(table)
    assert COLOUR.search(screen.getvalue())
    screen = terminal()
    monkeypatch.setenv("NO_COLOR", "1")
    show(table)
    assert "NO" in screen.getvalue()
    assert not COLOUR.search(screen.getvalue())


@pytest.mark.parametrize("kind", ["dumb", "unknown", ""])
def test_terminal_without_control_codes_gets_text(
    terminal: Callable[[], Screen], monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    screen = terminal()
    monkeypatch.setenv("TERM", kind)
    show(TABLE)
    assert screen.getvalue() == TABLE.text() + "\n"


def test_missing_rich_is_no_error(
    terminal: Callable[[], Screen], monkeypatch: pytest.MonkeyPatch
) -> None:
    screen = terminal()
    for name in [*(n for n in sys.modules if n.startswith("rich.")), "rich"]:
        monkeypatch.setitem(sys.modules, name, None)
    show(TABLE)
    assert screen.getvalue() == TABLE.text() + "\n"


def test_log_file_has_the_text_that_a_terminal_shows_drawn(
    terminal: Callable[[], Screen], tmp_path: Path
) -> None:
    screen = terminal()
    path = tmp_path / "run.log"
    handler = logging.FileHandler(path)
    logging.getLogger().addHandler(handler)
    try:
        log_text("\nfound:", TABLE, "and more")
    finally:
        logging.getLogger().removeHandler(handler)
        handler.close()
    assert path.read_text() == f"\nfound:\n{TABLE.text()}\nand more\n"
    shown = screen.getvalue()
    assert "───" in shown
    assert TABLE.text() not in shown
    assert shown.index("found:") < shown.index("12.25") < shown.index("and more")
    assert shown.count("12.25") == 1


def test_scores_are_drawn_at_a_terminal(
    finished_run: Path, tactorch: Any, terminal: Callable[[], Screen], tmp_path: Path
) -> None:
    screen = terminal()
    out = tmp_path / "scores.json"
    piped = tactorch("evaluate", f"run={finished_run}", f"out={out}", "run_dir=run")
    assert piped.status == 0
    shown = screen.getvalue()
    assert "───" in shown
    assert re.search(r"pearson +-?[0-9.]+", shown)
    logged = Path("run/evaluate.log").read_text()
    assert "───" not in logged


def test_progress_is_a_bar_at_a_terminal_and_lines_elsewhere(
    terminal: Callable[[], Screen],
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    screen = terminal()
    caplog.set_level(logging.INFO, log.name)
    for kind, drawn in (("xterm", True), ("dumb", False)):
        caplog.clear()
        screen = terminal()
        monkeypatch.setenv("TERM", kind)
        with progress("pressing", "presses") as tell_presses:
            for done in range(1, 101):
                tell_presses(done, 100, ", 2 failed")
        assert ("pressing" in screen.getvalue()) is drawn
        assert ("\x1b" in screen.getvalue()) is drawn
        assert len(caplog.messages) == (0 if drawn else 10)
    assert caplog.messages[-1] == "pressing: 100 of 100 presses, 2 failed"
