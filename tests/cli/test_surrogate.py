"""Training, judging and using a surrogate by commands, on data that take a moment."""

import json
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.slow  # tests/learning has the same without the command line
TINY = (
    "dataset=warmstart", "dataset.count=8", "dataset.shard=4", "dataset.samples=1",
    "dataset.mesh.relative_edge_length=0.3", "dataset.mesh.fine_relative=null",
    "dataset.presses.steps=[1]", "workers=1",
)  # fmt: skip
SMALL = (
    "model=surrogate", "data=warmstart", "model.width=4", "model.encoded=2", "data.cells=4",
    "data.shares=[0.5,0.25,0.25]", "trainer.max_epochs=1",
)  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("data") / "warmstart"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("runs") / "run"


def prepared(tactorch: Any, folder: Path, run: Path) -> Path:
    """A run that was trained, made when first asked for."""
    if not (run / "best.ckpt").is_file():
        done = tactorch("generate", *TINY, f"out={folder}")
        assert done.status == 0, done.err
        done = tactorch("train", *SMALL, f"data.folder={folder}", f"run_dir={run}")
        assert done.status == 0, done.err
    return run / "best.ckpt"


def test_a_surrogate_is_trained_and_judged(
    tactorch: Any, folder: Path, run: Path, tmp_path: Path
) -> None:
    prepared(tactorch, folder, run)
    assert "test/correlation" in json.loads((run / "scores.json").read_text())["summary"]
    judged = tactorch("evaluate-model", f"run={run}", f"run_dir={tmp_path}")
    assert judged.status == 0, judged.err
    assert "correlation" in judged.out
    scores = json.loads((tmp_path / "scores.json").read_text())
    assert scores["samples"] == 2
    assert (tmp_path / "calibration.png").is_file()
    assert (tmp_path / "examples.png").is_file()
    whole = tactorch("evaluate-model", f"run={run}", f"folder={folder}", f"run_dir={tmp_path}")
    assert whole.status == 0, whole.err
    assert json.loads((tmp_path / "scores.json").read_text())["samples"] == 8


def test_it_goes_on_from_its_last_epoch(
    tactorch: Any, folder: Path, run: Path, tmp_path: Path
) -> None:
    weights = prepared(tactorch, folder, run)
    before = weights.stat().st_mtime_ns
    done = tactorch("train", f"resume={run}", "trainer.max_epochs=2")
    assert done.status == 0, done.err
    assert len(json.loads((run / "curve.json").read_text())) == 2
    assert (run / "last.ckpt").stat().st_mtime_ns > before


@pytest.mark.parametrize("prior_mean", [False, True])
def test_an_inversion_uses_it(
    tactorch: Any, folder: Path, run: Path, tmp_path: Path, prior_mean: bool
) -> None:
    weights = prepared(tactorch, folder, run)
    coarse = ("mesh=coarse", "mesh.relative_edge_length=0.35", "mesh.fine_relative=null")
    case = tmp_path / "case.h5"
    made = tactorch("simulate", *coarse, "press=top", "press.steps=1", f"out={case}")
    assert made.status == 0, made.err
    done = tactorch(
        "invert", f"recording={case}", "initialization=surrogate", "plots=false",
        f"initialization.weights={weights}", f"initialization.prior_mean={prior_mean}",
        "optimizer.max_iterations=2", "method=map", f"run_dir={tmp_path / 'out'}",
    )  # fmt: skip
    assert done.status == 0, done.err
    summary = (tmp_path / "out" / "summary.json").read_text()
    assert '"start_mpa": "surrogate"' in summary
    taken = "surrogate's map is taken" in done.out + done.err
    assert ("sha256" in summary) == (prior_mean and taken)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("model=surrogate", "data=recognition"), ("learns from data=warmstart",)),
        (("model=recognizer", "data=warmstart"), ("learns from data=recognition",)),
        ((*SMALL, "data.folder=nowhere"), ("dataset not found: 'nowhere'",)),
        ((*SMALL, "data.cells=3"), ("cells=3", "at least 4")),
        ((*SMALL, "model.width=3"), ("width=3", "even")),
        ((*SMALL, "data.folder=null"), ("data.folder",)),
    ],
)
def test_wrong_settings(
    tactorch: Any, folder: Path, run: Path, arguments: tuple[str, ...], words: tuple[str, ...]
) -> None:
    prepared(tactorch, folder, run)
    own = () if any(a.startswith("data.folder") for a in arguments) else (f"data.folder={folder}",)
    done = tactorch("train", *own, *arguments)
    assert done.status == 2, done.out
    assert len(done.err.splitlines()) == 1, done.err
    assert all(word in done.err for word in words), done.err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("initialization=oracle",), ("oracle", "surrogate")),
        (("initialization=surrogate", "initialization.weights=none.pt"), ("'none.pt'",)),
        (("initialization=surrogate", "initialization.prior_mean=3"), ("true, false or auto",)),
        (("initialization=surrogate", "initialization.prior_share=half"), ("give a number",)),
    ],
)
def test_wrong_starts(
    tactorch: Any, tmp_path: Path, arguments: tuple[str, ...], words: tuple[str, ...]
) -> None:
    coarse = ("mesh=coarse", "mesh.relative_edge_length=0.35", "mesh.fine_relative=null")
    case = tmp_path / "case.h5"
    tactorch("simulate", *coarse, "press=top", "press.steps=1", f"out={case}")
    done = tactorch("invert", f"recording={case}", f"run_dir={tmp_path / 'out'}", *arguments)
    assert done.status == 2
    assert len(done.err.splitlines()) == 1, done.err
    assert all(word in done.err for word in words), done.err
