"""`tactorch invert` and the inclusions it finds after the inversion."""

import json
from pathlib import Path
from typing import Any

import pytest

from tactorch.errors import ConvergenceError
from tactorch.inverse import Monitor
from tactorch.report import load_run

QUICK = ("plots=false", "optimizer.max_iterations=2")
FILES = {"finding.txt", "finding.json", "shapes.json", "shapes.png"}


@pytest.fixture
def failing_search(monkeypatch: pytest.MonkeyPatch) -> None:
    def search(*arguments: object, **options: object) -> None:
        raise ConvergenceError("the body collapses.")

    monkeypatch.setattr("tactorch.findings.search.find_shapes", search)


def summary_of(folder: str) -> dict[str, Any]:
    found = json.loads(Path(folder, "summary.json").read_text())
    assert isinstance(found, dict)
    return found


def files_of(folder: str) -> set[str]:
    return FILES & {path.name for path in Path(folder).iterdir()}


def test_the_finding_is_written_and_in_the_summary(tactorch: Any, recording: Path) -> None:
    done = tactorch("invert", f"recording={recording}", "run_dir=run", QUICK[1])
    assert done.status == 0, done.err
    assert files_of("run") == FILES
    finding, text = (Path("run", name).read_text() for name in ("finding.json", "finding.txt"))
    assert summary_of("run")["finding"] == json.loads(finding)
    assert Path("run/summary.txt").read_text().endswith(f"\nFinding:\n{text}")
    assert text in done.out
    run = load_run("run")
    assert run.shapes is not None
    assert text in run.text


def test_without_find_the_summary_is_of_the_map_alone(tactorch: Any, recording: Path) -> None:
    done = tactorch("invert", f"recording={recording}", "run_dir=run", "method=map", *QUICK)
    assert done.status == 0, done.err
    assert not files_of("run")
    assert "finding" not in summary_of("run")
    content = Path("run/summary.txt").read_text()
    assert "\nIn the map: " in content
    assert "Finding:" not in content


@pytest.mark.usefixtures("failing_search")
@pytest.mark.parametrize("lower", [0.001, 0.3])
def test_a_map_that_cannot_be_trusted_has_no_inclusion(
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
    is_trusted = lower < 0.2
    assert bool(summary["warnings"]) != is_trusted
    assert ("In the map: " in content) == is_trusted
    assert (summary["inclusion"] is not None) == is_trusted
    finding = summary["finding"]
    assert (finding["status"] == "cannot tell") != is_trusted
    assert finding["reasons"] == summary["warnings"]
    assert finding["lumps"] or not is_trusted
    assert "no shapes can be fitted (the body collapses)" in finding["notes"][0]
    assert ("Cannot tell whether there is a lump: " in content) != is_trusted
    assert not {"shapes.json", "shapes.png"} & files_of("run")


def test_an_interrupted_inversion_skips_the_search(
    tactorch: Any, recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    accept = Monitor.accept

    def interrupted(self: Monitor, *arguments: Any, **record: float) -> None:
        accept(self, *arguments, **record)
        if self.iteration == 1:
            raise KeyboardInterrupt

    searches: list[object] = []
    monkeypatch.setattr("tactorch.cli.invert.find_and_write", lambda *a, **k: searches.append(a))
    monkeypatch.setattr(Monitor, "accept", interrupted)
    done = tactorch("invert", f"recording={recording}", "run_dir=run", *QUICK)
    assert done.status == 130
    assert not searches
    assert summary_of("run")["stop_reason"] == "interrupted"


def test_an_interrupted_search_keeps_the_map(
    tactorch: Any, recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*arguments: object, **options: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("tactorch.findings.search.find_shapes", interrupted)
    done = tactorch("invert", f"recording={recording}", "run_dir=run", *QUICK)
    assert done.status == 130
    assert "The map is complete; tactorch find '" in done.out
    assert not files_of("run")
    assert "finding" not in summary_of("run")
    assert load_run("run").recording is not None


@pytest.mark.usefixtures("failing_search")
def test_each_job_of_a_sweep_has_its_finding(tactorch: Any, recording: Path) -> None:
    sweep = ("optimizer.tolerance=0.1,0.2", "run_dir=sweep")
    done = tactorch("invert", "-m", f"recording={recording}", *sweep, *QUICK)
    assert done.status == 0, done.err
    for folder in ("sweep/optimizer.tolerance-0.1", "sweep/optimizer.tolerance-0.2"):
        assert files_of(folder) == {"finding.json", "finding.txt"}
        assert "finding" in summary_of(folder)


@pytest.mark.usefixtures("failing_search")
def test_a_resumed_run_finds_again(tactorch: Any, recording: Path) -> None:
    start = ("invert", f"recording={recording}", "run_dir=run", *QUICK, "method=map")
    assert tactorch(*start).status == 0
    assert not files_of("run")
    done = tactorch("invert", "resume=run", "method=auto", "optimizer.max_iterations=3")
    assert done.status == 0, done.err
    assert files_of("run") == {"finding.json", "finding.txt"}
    assert summary_of("run")["iterations"] == 3
