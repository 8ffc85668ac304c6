"""`tactorch report`: runs named plainly or by key, and what it says where something is wrong."""

import shutil
from pathlib import Path
from typing import Any

import pytest

from tactorch.cli.overrides import named
from tactorch.report import Run


@pytest.mark.parametrize(
    ("given", "taken"),
    [
        (["runs/a"], ["run='runs/a'"]),
        (["a", "b c", "d", "out=x.html"], ["run='a'", "compare=['b c','d']", "out=x.html"]),
        (["run=a", "compare=[b]"], ["run=a", "compare=[b]"]),
        (["it's"], [r"run='it\'s'"]),
        (["--help"], ["--help"]),
        ([], []),
    ],
)
def test_bare_paths_become_settings(given: list[str], taken: list[str]) -> None:
    assert named("report", given) == taken


def test_commands_that_take_one_value_alone_take_no_more() -> None:
    assert named("reproduce", ["table1", "size=full"]) == ["exhibit='table1'", "size=full"]
    assert named("find", ["a", "b"]) == ["run='a'", "b"]
    assert named("invert", ["a.h5"]) == ["a.h5"]


def test_a_run_is_told_in_a_file_beside_it(tactorch: Any, finished_run: Path) -> None:
    done = tactorch("report", finished_run)
    assert done.status == 0, done.err
    assert (finished_run / "report.html").is_file()
    assert "uncertainty=false" in done.out  # what takes long is told, and how to do without
    assert "steps" in done.out
    assert "report.html" in done.out


def test_runs_side_by_side(tactorch: Any, finished_run: Path, tmp_path: Path) -> None:
    other = Path(shutil.copytree(finished_run, tmp_path / "other, 'quoted'"))
    done = tactorch("report", finished_run, other, "out=both.html", "uncertainty=false")
    assert done.status == 0, done.err
    assert "2 runs compared" in Path("both.html").read_text(encoding="utf-8")


def test_all_runs_are_read_before_a_surrogate_predicts(
    tactorch: Any, finished_run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    predicted: list[Run] = []
    monkeypatch.setattr("tactorch.cli.report.with_settings", predicted.append)
    done = tactorch("report", finished_run, "nowhere")
    assert done.status == 2
    assert "run not found: 'nowhere'" in done.err
    assert not predicted


@pytest.mark.slow
def test_a_prior_about_a_surrogates_map_is_made_again(tactorch: Any, recording_file: Path) -> None:
    """The result holds the checksum of that map only."""
    about = ("initialization=surrogate", "initialization.prior_mean=true")
    quick = ("plots=false", "method=map", "optimizer.max_iterations=1", "run_dir=run")
    done = tactorch("invert", f"recording={recording_file}", *about, *quick)
    assert "The surrogate's map is the mean of the prior" in done.out
    assert tactorch("report", "run").status == 0
    page = Path("run/report.html").read_text(encoding="utf-8")
    assert "Omitted: " not in page
    shutil.rmtree("run/.hydra")
    assert tactorch("report", "run").status == 0
    page = Path("run/report.html").read_text(encoding="utf-8")
    assert "Omitted: credibility and uncertainty (the mean of the prior is a map" in page


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ((), "'run' is missing"),
        (("nowhere",), "run not found: 'nowhere'"),
        (("{run}", "{run}"), "named twice"),
        (("{run}", "colours=jet"), "colours='jet'"),
        (("{run}", "uncertainty=perhaps"), "true or false"),
        (("{run}", "recording=gone.h5"), "gone.h5"),
    ],
)
def test_wrong_input(
    tactorch: Any, finished_run: Path, settings: tuple[str, ...], words: str
) -> None:
    done = tactorch("report", *(word.format(run=finished_run) for word in settings))
    assert done.status == 2
    assert words in done.err
    assert len(done.err.strip().splitlines()) == 1
