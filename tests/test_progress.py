"""Progress of computations at a terminal, in a notebook and elsewhere."""

import logging
import sys
import threading
import time
from collections.abc import Iterator
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from tactorch import progress
from tactorch.processes import single_thread
from tactorch.progress import progress_line, without_progress


class Terminal:
    """A line that keeps what it shows."""

    def __init__(self) -> None:
        self.shown: list[str] = []
        self.closed = False

    def show(self, text: str) -> None:
        self.shown.append(text)

    def close(self, seconds: float) -> None:
        self.closed = True


@pytest.fixture
def lines(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[Terminal]]:
    made: list[Terminal] = []

    def new_line(forced: bool) -> Terminal:
        made.append(Terminal())
        return made[-1]

    monkeypatch.setattr(progress, "_new_line", new_line)
    yield made
    assert not progress._running


def test_a_computation_inside_another_one_is_its_state(lines: list[Terminal]) -> None:
    with progress_line("inversion") as update:
        update("iteration 1")
        with progress_line("meshing") as of_mesh:
            of_mesh("2 of 3")
        update("iteration 2")
    (line,) = lines
    assert line.shown == [
        "inversion",
        "inversion: iteration 1",
        "inversion: iteration 1, meshing",
        "inversion: iteration 1, meshing, 2 of 3",
        "inversion: iteration 1",
        "inversion: iteration 2",
    ]
    assert line.closed


def test_nothing_is_shown_inside_a_hidden_computation(lines: list[Terminal]) -> None:
    with without_progress(), progress_line("inner") as update:
        update("state")
    with progress_line("outer", show=False), progress_line("inner") as update:
        update("state")
    assert not lines


def test_an_error_ends_the_line(lines: list[Terminal]) -> None:
    with pytest.raises(ValueError, match="wrong"), progress_line("outer"), progress_line("inner"):
        raise ValueError("wrong")
    assert lines[0].closed


def test_other_threads_show_nothing(lines: list[Terminal]) -> None:
    def work() -> None:
        with progress_line("in a thread") as update:
            update("state")

    thread = threading.Thread(target=work)
    with progress_line("main"):
        thread.start()
        thread.join()
    assert [line.shown for line in lines] == [["main"]]


def test_compilations_are_a_state_of_what_waits_for_them(lines: list[Terminal]) -> None:
    import numba

    import tactorch.fem.kernels  # noqa: F401

    @numba.njit
    def inner(x: float) -> float:
        return x + 1.0

    @numba.njit
    def outer(x: float) -> float:
        return inner(x) * 2.0

    assert outer(1.0) == 4.0  # where nothing is shown
    with progress_line("simulation") as update:
        update("1 of 2 presses")
        assert outer(1) == 4.0  # of another type
        assert outer(2) == 6.0
    text = "simulation: 1 of 2 presses"
    compiling = f"{text}, compiling, which is kept for later runs"
    assert lines[0].shown == ["simulation", text, compiling, text]


class Clock:
    def __init__(self) -> None:
        self.now = 100.0

    def monotonic(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(progress, "time", clock)
    monkeypatch.setattr(progress.Silence, "until", -1e9)
    return clock


def test_a_script_without_a_terminal_gets_a_line_now_and_then(
    clock: Clock, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(progress, "is_terminal", lambda _: False)
    monkeypatch.setattr(logging.getLogger("tactorch"), "level", logging.WARNING)
    logging.getLogger("tactorch").manager._clear_cache()  # type: ignore[attr-defined]
    with progress_line("inversion") as update:
        for second in range(25):
            clock.now = 100.0 + second
            update(f"iteration {second}")
    assert capsys.readouterr().err.splitlines() == [
        "inversion: iteration 8 (8 s)",
        "inversion: iteration 16 (16 s)",
        "inversion: iteration 24 (24 s)",
    ]


@pytest.mark.parametrize(("pause", "silent"), [(2.0, 1.0), (60.0, 8.0)])
def test_computations_that_follow_each_other_are_not_silent_together(
    clock: Clock, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
    pause: float, silent: float,
) -> None:  # fmt: skip
    monkeypatch.setattr(progress, "is_terminal", lambda _: False)
    monkeypatch.setattr(progress._log, "isEnabledFor", lambda level: False)
    with progress_line("meshing"):
        clock.now += 7.0
    clock.now += pause
    with progress_line("inversion") as update:
        clock.now += silent - 0.1
        update("1")
        assert not capsys.readouterr().err
        clock.now += 0.2
        update("2")
    assert capsys.readouterr().err == f"inversion: 2 ({silent:.0f} s)\n"


def test_where_messages_are_logged_silence_is_broken_in_the_log(
    clock: Clock, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(progress, "is_terminal", lambda _: False)
    caplog.set_level(logging.INFO, "tactorch")
    handlers = list(logging.getLogger("tactorch").handlers)
    with progress_line("inversion") as update:
        clock.now += 6.0
        logging.getLogger("tactorch.inverse").info("iteration 1")
        clock.now += 6.0
        update("iteration 2")
        clock.now += 6.0
        update("iteration 3")
    assert caplog.messages == ["iteration 1", "inversion: iteration 3 (18 s)"]
    assert logging.getLogger("tactorch").handlers == handlers


def test_silence_is_broken_while_messages_are_not_logged(
    clock: Clock, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    """As in the main process where it computes what processes of one thread would."""
    monkeypatch.setattr(progress, "is_terminal", lambda _: False)
    caplog.set_level(logging.INFO, "tactorch")
    with progress_line("cases") as update, single_thread():
        clock.now += 9.0
        update("1 of 2")
    assert not caplog.messages
    assert capsys.readouterr().err == "cases: 1 of 2 (9 s)\n"


def test_a_computation_without_a_new_state_gives_signs_of_life(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(progress, "is_terminal", lambda _: False)
    monkeypatch.setattr(progress._log, "isEnabledFor", lambda level: False)
    monkeypatch.setattr(progress._PlainLine, "period_s", 0.05)
    monkeypatch.setattr(progress, "_TICK_S", 0.01)
    with progress_line("inversion"):
        time.sleep(0.5)
    count = capsys.readouterr().err.count("inversion (0 s)")
    assert count >= 2
    time.sleep(0.2)
    assert not capsys.readouterr().err


def test_a_line_of_the_log_may_end_while_it_is_written(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A handler of logging has attributes of its own, which its `close` sets."""
    faults: list[Any] = []
    monkeypatch.setattr(threading, "excepthook", faults.append)
    monkeypatch.setattr(progress._PlainLine, "period_s", 0.05)
    monkeypatch.setattr(progress, "_TICK_S", 0.01)
    monkeypatch.setattr(progress._LogLine, "_write", lambda line, text: line.close())
    before = set(threading.enumerate())
    progress._LogLine()
    for thread in set(threading.enumerate()) - before:
        thread.join(5.0)
        assert not thread.is_alive()
    assert not faults


@pytest.fixture
def notebook(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """A notebook whose output has the texts that were shown, the last one of each place."""
    outputs: list[str] = []

    def display(shown: str, display_id: bool) -> Any:
        outputs.append(shown)
        place = len(outputs) - 1
        return SimpleNamespace(update=lambda new: outputs.__setitem__(place, new))

    kernel = SimpleNamespace(kernel=object())
    ipython, parts = ModuleType("IPython"), ModuleType("IPython.display")
    ipython.get_ipython = lambda: kernel  # type: ignore[attr-defined]
    parts.HTML, parts.display = str, display  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "IPython", ipython)
    monkeypatch.setitem(sys.modules, "IPython.display", parts)
    return outputs


def test_a_notebook_has_one_output_that_is_replaced(clock: Clock, notebook: list[str]) -> None:
    with progress_line("inversion") as update:
        assert notebook == ["<pre>inversion (0 s)</pre>"]
        clock.now += 0.1
        update("too soon")
        assert notebook == ["<pre>inversion (0 s)</pre>"]
        clock.now += 4.0
        update("chi2 < 1")
        assert notebook == ["<pre>inversion: chi2 &lt; 1 (4 s)</pre>"]
    assert notebook == ["<pre>inversion: chi2 &lt; 1 (4.1 s)</pre>"]


def test_brief_computations_leave_nothing_in_a_notebook(clock: Clock, notebook: list[str]) -> None:
    with progress_line("meshing"):
        clock.now += 0.5
    assert notebook == [""]


def test_a_terminal_shows_text_that_looks_like_markup(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with progress_line("ball at [1.0, 2.0]", show=True) as update:
        update("[bold]state")
        time.sleep(progress._BRIEF_S)
    assert "ball at [1.0, 2.0]: [bold]state" in capsys.readouterr().err
