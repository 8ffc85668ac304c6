"""`tactorch invert`: the one result, in its files, its summary and its texts."""

import json
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from tactorch.errors import ConvergenceError
from tactorch.inverse import Monitor
from tactorch.inverse.result.text import describe
from tactorch.report import load_run

MODULE = import_module("tactorch.inverse.invert")
QUICK = ("plots=false", "optimizer.max_iterations=2")


@pytest.fixture
def failing_search(monkeypatch: pytest.MonkeyPatch) -> None:
    def search(*arguments: object, **options: object) -> None:
        raise ConvergenceError("the body collapses.")

    monkeypatch.setattr(MODULE, "find_shapes", search)


def summary_of(folder: str) -> dict[str, Any]:
    found = json.loads(Path(folder, "summary.json").read_text())
    assert isinstance(found, dict)
    return found


def test_every_file_shows_the_same_result(tactorch: Any, recording: Path) -> None:
    import meshio

    done = tactorch("invert", f"recording={recording}", "run_dir=run", "method=inclusions")
    assert done.status == 0, done.err
    result, summary = load_run("run").result, summary_of("run")
    assert result.shapes is not None
    finding, text = (Path("run", name).read_text() for name in ("finding.json", "finding.txt"))
    assert summary["finding"] == json.loads(finding) == result.plain()
    assert summary["description"] == "inclusions"
    assert text == f"{describe(result)}\n"
    assert Path("run/summary.txt").read_text().startswith(text)
    assert text in done.out
    assert Path("run/slices.png").is_file()
    cells = meshio.read("run/reconstruction.vtu").cell_data
    assert cells["youngs_mpa"][0].max() == pytest.approx(result.youngs.max())
    assert {"youngs_90_low_mpa", "youngs_90_high_mpa", "trusted"} <= set(cells)
    scores = tactorch("evaluate", "run=run")
    assert scores.status == 0, scores.err
    assert "reconstruction: inclusions" in scores.out
    stored = json.loads(Path("run/scores.json").read_text())
    assert stored["reconstruction"]["pearson"] == summary["pearson"]
    assert stored["recording"] == str(recording.resolve())


@pytest.mark.usefixtures("failing_search")
@pytest.mark.parametrize("lower", [0.001, 0.3])
def test_a_map_that_cannot_be_trusted_says_so_everywhere(
    tactorch: Any, recording: Path, lower: float
) -> None:
    """The body has 0.2 MPa, so that a bound above it holds nearly all of the map."""
    bounds = (f"bounds.lower={lower}", "initialization.start_mpa=0.4")
    done = tactorch(
        "invert", f"recording={recording}", "run_dir=run", *bounds, "plots=false",
        "optimizer.max_iterations=5",
    )  # fmt: skip
    assert done.status == 0, done.err
    summary, content = summary_of("run"), Path("run/summary.txt").read_text()
    is_trusted, finding = lower < 0.2, summary["finding"]
    assert finding["description"] == "element map"
    assert bool(finding["reasons"]) != is_trusted
    assert (finding["status"] == "cannot tell") != is_trusted
    assert finding["lumps"] or not is_trusted
    warning = "No inclusions can be fitted (the body collapses); this is the element map."
    assert warning in finding["warnings"]
    assert warning in content
    assert tactorch("report", "run", "uncertainty=false").status == 0
    assert tactorch("evaluate", "run=run").status == 0
    untrusted = [content, done.out, Path("run/report.html").read_text()]
    assert all(("Do not trust this result" in text) != is_trusted for text in untrusted)


def test_lumps_of_an_element_map_have_intervals_unless_left_out(
    tactorch: Any, recording: Path
) -> None:
    quick = ("invert", f"recording={recording}", "run_dir=run", "method=map", *QUICK)
    for given, is_known in (((), True), (("uncertainty=false",), False)):
        done = tactorch(*quick, *given, "overwrite=true")
        assert done.status == 0, done.err
        lumps = summary_of("run")["finding"]["lumps"]
        assert lumps
        assert all(("probability" in lump) == is_known for lump in lumps)
        assert ("Given noise and prior" in Path("run/finding.txt").read_text()) == is_known


def test_an_interrupted_inversion_keeps_its_map(
    tactorch: Any, recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    accept = Monitor.accept

    def interrupted(self: Monitor, *arguments: Any, **record: float) -> None:
        accept(self, *arguments, **record)
        if self.iteration == 1:
            raise KeyboardInterrupt

    monkeypatch.setattr(Monitor, "accept", interrupted)
    done = tactorch("invert", f"recording={recording}", "run_dir=run", "method=map", *QUICK)
    assert done.status == 130
    assert summary_of("run")["stop_reason"] == "interrupted"


def test_an_interrupted_search_has_no_result(
    tactorch: Any, recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*arguments: object, **options: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(MODULE, "find_shapes", interrupted)
    done = tactorch("invert", f"recording={recording}", "run_dir=run", *QUICK)
    assert done.status == 130
    assert not Path("run/summary.json").exists()


@pytest.mark.usefixtures("failing_search")
def test_each_job_of_a_sweep_has_its_finding(tactorch: Any, recording: Path) -> None:
    sweep = ("optimizer.tolerance=0.1,0.2", "run_dir=sweep", "uncertainty=false")
    done = tactorch("invert", "-m", f"recording={recording}", *sweep, *QUICK)
    assert done.status == 0, done.err
    for folder in ("sweep/optimizer.tolerance-0.1", "sweep/optimizer.tolerance-0.2"):
        assert "finding" in summary_of(folder)


@pytest.mark.usefixtures("failing_search")
def test_a_resumed_run_searches_again(tactorch: Any, recording: Path) -> None:
    start = ("invert", f"recording={recording}", "run_dir=run", *QUICK, "method=map")
    assert tactorch(*start).status == 0
    done = tactorch("invert", "resume=run", "method=auto", "optimizer.max_iterations=3")
    assert done.status == 0, done.err
    summary = summary_of("run")
    assert summary["iterations"] == 3
    assert summary["finding"]["warnings"]
