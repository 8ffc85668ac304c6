import html
import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tactorch.cli.live_view import Screen
from tactorch.inverse import IncrementalResult, Lump, Reconstruction
from tactorch.inverse.result import Confidence
from tactorch.inverse.result.text import describe
from tactorch.metrics import Inclusion
from tactorch.recording import Recording
from tactorch.sampling import Update


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two presses from above, which leave places to press next beside what it stands on."""
    from tactorch import PressPlan, make_phantom, simulate
    from tactorch.mesh import box_mesh

    plan = PressPlan(("z+",), (0.005, 0.01))
    path = tmp_path_factory.mktemp("live") / "case.h5"
    simulate(make_phantom("cube_sphere", radius=0.3), plan, mesh=box_mesh(10.0, 3)).save(path)
    return path


QUICK = (
    *("pause_seconds=0", "poll_seconds=0.01", "max_iterations=2", "suggest.candidates=4"),
    "method=map",
)


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
    assert '"ended":true' in page.replace(" ", "")
    assert "Press next: (" in page
    assert "http://" not in page
    assert "https://" not in page
    script = (run / "live-data.js").read_text()
    assert script.startswith("window.tactorchLive({")
    content = json.loads(script.removeprefix("window.tactorchLive(").removesuffix(");\n"))
    assert content["ended"]
    assert content["run"]["fields"]["youngs"]["dtype"] == "uint16"
    assert "points" not in content["run"]
    assert "truth" not in content["run"]["fields"]
    history = [json.loads(line) for line in (run / "history.jsonl").read_text().splitlines()]
    assert [entry["press"] for entry in history][:2] == [1, 2]
    assert len(Reconstruction.load(run / "reconstruction.h5").displacements) == 2
    assert len(Recording.load(run / "recording.h5").presses) == 2

    again = tactorch(
        "live", "recording=run/recording.h5", "idle_seconds=0.05", *QUICK, "run_dir=run"
    )
    assert again.status == 0, again.err
    assert "continuing a run of 2 presses" in again.out


@pytest.mark.slow
def test_a_replay_ends_with_its_last_press(tactorch: Callable[..., Any], recording: Path) -> None:
    done = tactorch("live", f"replay={recording}", "run_dir=run", *QUICK, "plots=false")
    assert done.status == 0, done.err
    assert f"all 2 presses of {recording} were replayed" in done.out
    page = Path("run/live.html").read_text()
    assert f"ended: all 2 presses of {recording} were replayed" in html.unescape(page)
    assert "<title>case.h5: live session</title>" in page


def test_shapes_are_found_and_shown(tactorch: Callable[..., Any], recording_file: Path) -> None:
    given = ("idle_seconds=0.01", "method=auto", "suggest.rule=none", "plots=false", "run_dir=run")
    done = tactorch("live", f"recording={recording_file}", *QUICK, *given)
    assert done.status == 0, done.err
    history = [json.loads(line) for line in Path("run/history.jsonl").read_text().splitlines()]
    finding = history[-1]["finding"]
    assert history[-1]["finding_presses"] == 2
    assert finding["probability"] is not None
    assert "press 2, shapes: " in done.out
    page = Path("run/live.html").read_text()
    forms = [lump["form"] for lump in finding["lumps"]]  # of so coarse a mesh, any
    texts = {
        "found": f" {' '.join(forms[:1])} at (",
        "nothing found": "Nothing found",
        "cannot tell": "Do not trust this result",
    }
    text = texts[finding["status"]]
    assert text in page
    assert text in done.out.split("The run ended: ")[0]
    assert text in done.out.split("The run ended: ")[1]
    assert (Path("run") / "shapes.json").is_file()
    assert "log-evidence" not in done.out  # the steps of the search are in the log file
    assert "log-evidence" in Path("run/live.log").read_text()


class Screens:
    """Updates of two presses with a ball, shown on a page."""

    def __init__(self, folder: Path, recording: Recording) -> None:
        self.folder, self._recording = folder, recording
        self.screen = Screen(folder, Path("session.h5"), plots=False)

    def update(self, presses: int, result: Reconstruction, total: int = 2) -> Update:
        entry = {
            "press": total, "names": ["x"], "seconds": 1.0, "chi2": 1.0, "inclusion": None,
            "youngs_median_mpa": 0.2, "finding": result.plain(), "finding_presses": presses,
        }  # fmt: skip
        nothing: Any = None
        solution = IncrementalResult(result, nothing, 0.0, True)
        return Update(self._recording, solution, result, presses, entry)

    def result(self, **found: Any) -> Reconstruction:
        mesh = self._recording.mesh
        history = [{"iteration": 0, "seconds": 0.0, "misfit": 1.0, "chi2": 1.0}]
        youngs, moved = np.full(mesh.n_tets, 0.2), np.zeros((2, mesh.n_points, 3))
        return Reconstruction(mesh, youngs, moved, history, "x", 1.0, background_mpa=0.2, **found)

    def page(self) -> str:
        return html.unescape((self.folder / "live.html").read_text())


@pytest.fixture
def screens(tmp_path: Path, recording: Path) -> Screens:
    return Screens(tmp_path, Recording.load(recording))


def a_ball(screens: Screens) -> Reconstruction:
    inside = np.zeros(screens._recording.mesh.n_tets, dtype=bool)
    inside[:3] = True
    center, interval = np.array([5.0, 5.0, 6.0]), (1.9, 2.1)
    inclusion = Inclusion(center, 33.5, 2.0, 0.94, 0.2, inside, "stiff")
    confidence = Confidence(0.9999, (3.7, 6.0), np.full(3, 0.01), interval, (0.74, 1.2))
    return screens.result(lumps=(Lump(inclusion, np.full(3, 4.0), None, confidence),))


def test_the_finding_is_shown_with_its_intervals_and_of_how_many_presses_it_is(
    screens: Screens,
) -> None:
    finding = a_ball(screens)
    screens.screen.updated(screens.update(1, finding))
    page = screens.page()
    assert f"Of the first 1 of 2 presses:\n{describe(finding)}" in page
    cell = "radius 2.0 (1.9 to 2.1) mm: 0.94 (0.74 to 1.2) MPa in 0.2"
    assert f"{cell}; of the first 1 presses</td>" in page
    screens.screen.found(screens.update(2, replace(finding, probability=1.0)))
    page = screens.page()
    assert "Of the first" not in page
    assert describe(finding) in page
    assert "90 % intervals are 1.9 to 2.1 mm" in page


def test_the_page_says_that_the_presses_cannot_tell(screens: Screens) -> None:
    finding = screens.result(reasons=("40% of the map is at a bound.",))
    screens.screen.updated(screens.update(2, finding))
    page = screens.page()
    assert "Do not trust this result: 40% of the map is at a bound." in page
    assert "<td>cannot tell</td>" in page


def test_a_continued_run_shows_its_last_finding(screens: Screens) -> None:
    entry = screens.update(2, a_ball(screens)).entry
    older = {name: entry[name] for name in entry if not name.startswith("finding")}
    screens.screen.resumed([older | {"press": 1}, entry])
    page = screens.page()
    assert page.count("stiff at (5.0, 5.0, 6.0) mm, radius 2.0 (1.9 to 2.1) mm") == 2
    assert "<td>none; 0.2 MPa</td>" in page  # the entry of an earlier version


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
