"""`tactorch find`: what a run's map shows, in words and numbers."""

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
import torch

from tactorch.errors import FileError
from tactorch.findings import build_shape_finding
from tactorch.learning.recognizer import Recognizer
from tactorch.report import load_run
from tactorch.report.assessment import assess


def test_lumps_are_told_with_how_sure_they_are(tactorch: Any, finished_run: Path) -> None:
    before = (finished_run / "summary.json").read_bytes()
    done = tactorch("find", finished_run, "shapes=false", "out=.")
    assert done.status == 0, done.err
    assert (finished_run / "summary.json").read_bytes() == before  # another folder has the finding
    text = Path("finding.txt").read_text()
    assert text.strip() in done.out
    values = json.loads(Path("finding.json").read_text())
    for lump in values["lumps"]:
        assert 0.0 <= lump["probability"] <= 1.0
        assert lump["depth_mm"] > 0
    assert ("Given noise and prior" in text) == (values["status"] == "found")


def test_shapes_are_fitted_and_shown_by_the_report(tactorch: Any, finished_run: Path) -> None:
    folder = Path("run")
    shutil.copytree(finished_run, folder)
    done = tactorch("find", folder)
    assert done.status == 0, done.err
    values = json.loads((folder / "finding.json").read_text())
    assert values["status"] in {"found", "nothing found", "cannot tell"}
    assert 0.0 <= values["probability"] <= 1.0
    for lump in values["lumps"]:
        low, high = lump["mean_90_mpa"]
        assert low < lump["mean_mpa"] < high
    run = load_run(folder)
    assert run.shapes is not None
    assert run.recording is not None
    finding = build_shape_finding(run.recording, run.shapes)
    assert finding.plain() == values
    assert assess(run, uncertainty=False).finding.plain() == values
    assert run.summary["finding"] == values
    before = json.loads((finished_run / "summary.json").read_text())
    assert {**before, "finding": values} == run.summary
    assert finding.text() in run.text
    (folder / "shapes.json").write_text("{}")
    with pytest.raises(FileError, match="tactorch find"):
        load_run(folder)


def test_regions_replace_the_shapes_of_an_earlier_search(tactorch: Any, finished_run: Path) -> None:
    folder = Path("run")
    shutil.copytree(finished_run, folder)
    for name in ("shapes.json", "shapes.png"):
        (folder / name).write_text("{}")
    done = tactorch("find", folder, "shapes=false", "uncertainty=false")
    assert done.status == 0, done.err
    assert not list(folder.glob("shapes.*"))
    assert load_run(folder).shapes is None


def test_without_uncertainty_nothing_is_said_of_it(tactorch: Any, finished_run: Path) -> None:
    done = tactorch(
        "find", f"run={finished_run}", "shapes=false", "uncertainty=false", "out=elsewhere"
    )
    assert done.status == 0, done.err
    assert "Given noise and prior" not in Path("elsewhere/finding.txt").read_text()


def test_a_recognizer_names_the_shape(tactorch: Any, finished_run: Path) -> None:
    network = Recognizer(["cake", "cone"], hidden=2)
    content = {"state_dict": network.state_dict(), "hyper_parameters": dict(network.hparams)}
    torch.save(content, "best.ckpt")
    done = tactorch(
        "find", finished_run, "shapes=false", "uncertainty=false", "recognizer=best.ckpt", "out=."
    )
    assert done.status == 0, done.err
    shapes = json.loads(Path("finding.json").read_text())["shapes"]
    assert set(shapes) == {"cake", "cone"}
    assert "it looks like: " in done.out


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ((), "'run' is missing"),
        (("nowhere",), "nowhere"),
        (("run=RUN", "max_lumps=0"), "max_lumps=0"),
        (("run=RUN", "max_lumps=x"), "max_lumps='x': give a whole number"),
        (("run=RUN", "recording=gone.h5"), "gone.h5"),
        (("run=RUN", "shapes=false", "uncertainty=false", "recognizer=gone.ckpt"), "gone.ckpt"),
    ],
)
def test_wrong_input(
    tactorch: Any, finished_run: Path, settings: tuple[str, ...], words: str
) -> None:
    given = [word.replace("RUN", str(finished_run)) for word in settings]
    done = tactorch("find", *given)
    assert done.status == 2
    assert words in done.err
    assert not Path("finding.json").exists()
