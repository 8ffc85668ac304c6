import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tactorch.inverse import Reconstruction
from tactorch.recording import Recording


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two presses from above, which leave places to press next beside what it stands on."""
    from tactorch import PressPlan, make_phantom, simulate
    from tactorch.mesh import box_mesh

    plan = PressPlan(("z+",), (0.005, 0.01))
    path = tmp_path_factory.mktemp("live") / "case.h5"
    simulate(make_phantom("cube_sphere", radius=0.3), plan, mesh=box_mesh(10.0, 3)).save(path)
    return path


QUICK = ("pause_seconds=0", "poll_seconds=0.01", "max_iterations=2", "suggest.candidates=4")


@pytest.mark.slow
def test_a_played_recording_leaves_picture_page_and_map(
    tactorch: Callable[..., Any], recording: Path
) -> None:
    given = ("max_batch=1", "max_presses=2", "run_dir=run")
    done = tactorch("live", f"replay={recording}", *given, *QUICK)
    assert done.status == 0, done.err
    assert re.search(r"press 1: [\d.]+ s, chi2 ", done.out)
    assert "next press (" in done.out
    assert "2 presses (max_presses) were made" in done.out
    assert "pearson" in done.out  # the recording carries its truth
    run = Path("run")
    assert (run / "live.png").read_bytes()[:4] == b"\x89PNG"
    page = (run / "live.html").read_text()
    assert "data:image/png;base64," in page
    assert "http-equiv" not in page  # it is over
    assert "Press next: (" in page
    history = [json.loads(line) for line in (run / "history.jsonl").read_text().splitlines()]
    assert [entry["press"] for entry in history][:2] == [1, 2]
    assert len(Reconstruction.load(run / "reconstruction.h5").displacements) == 2
    assert len(Recording.load(run / "recording.h5").presses) == 2

    again = tactorch(
        "live", "recording=run/recording.h5", "idle_seconds=0.05", *QUICK, "run_dir=run"
    )
    assert again.status == 0, again.err
    assert "continuing a run of 2 presses" in again.out


def test_the_page_loads_itself_anew_until_the_end(
    tactorch: Callable[..., Any], recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pages: list[str] = []

    def keep(self: Any, ended: Any) -> None:
        pages.append((self._folder / "live.html").read_text())

    monkeypatch.setattr("tactorch.cli.live_view.Screen.ended", keep)
    done = tactorch("live", f"recording={recording}", "idle_seconds=0.01", *QUICK, "plots=false")
    assert done.status == 0, done.err
    assert '<meta http-equiv="refresh"' in pages[0]
    assert "<img" not in pages[0]


def test_at_a_terminal_there_is_a_table(
    tactorch: Callable[..., Any], recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "160")
    done = tactorch("live", f"recording={recording}", "idle_seconds=0.01", *QUICK, "plots=false")
    assert done.status == 0, done.err
    assert "next press" in done.out
    assert "deviation" in done.out
    assert "chi2 " not in done.out.replace("chi2 ┃", "")


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ((), "'recording' is missing"),
        (("recording=none",), "neither a folder nor a recording"),
        (("recording=a.h5", "poll_seconds=0"), "poll_seconds=0"),
        (
            ("recording=a.h5", "max_presses=1.5"),
            "max_presses=1.5: give a whole number, at least 1, or null",
        ),
        (("recording=a.h5", "idle_seconds=-2"), "idle_seconds=-2"),
        (("recording=a.h5", "pause_seconds=-2"), "pause_seconds=-2"),
        (("recording=a.h5", "suggest.rule=guess"), "rule=guess is unknown"),
        (("recording=a.h5", "suggest.radius_mm=x"), "suggest.radius_mm='x': give a number"),
        (("replay=none.h5",), "none.h5"),
    ],
)
def test_wrong_settings_are_refused(
    tactorch: Callable[..., Any], settings: tuple[str, ...], words: str
) -> None:
    done = tactorch("live", *settings, "run_dir=run")
    assert done.status == 2
    assert words in done.err
    assert len(done.err.strip().splitlines()) == 1


@pytest.mark.parametrize(
    ("settings", "words"),
    [(("optimizer=tnc",), "optimizer=tnc"), (("nuisance=material",), "nuisance")],
)
def test_inversions_that_cannot_grow_are_refused(
    tactorch: Callable[..., Any], recording: Path, settings: tuple[str, ...], words: str
) -> None:
    done = tactorch("live", f"recording={recording}", "idle_seconds=0.01", *settings)
    assert done.status == 2
    assert words in done.err
