"""`tactorch find`: what a run's map shows, in words and numbers."""

import json
from pathlib import Path
from typing import Any

import pytest
import torch

from tactorch.learning.recognizer import Recognizer


def test_lumps_are_told_with_how_sure_they_are(tactorch: Any, finished_run: Path) -> None:
    done = tactorch("find", finished_run)
    assert done.status == 0, done.err
    text = (finished_run / "finding.txt").read_text()
    assert text.strip() in done.out
    values = json.loads((finished_run / "finding.json").read_text())
    for lump in values["lumps"]:
        assert 0.0 <= lump["probability"] <= 1.0
        assert lump["depth_mm"] > 0
    assert "Given noise and prior" in text or "No lump" in text


def test_without_uncertainty_nothing_is_said_of_it(tactorch: Any, finished_run: Path) -> None:
    done = tactorch("find", f"run={finished_run}", "uncertainty=false", "out=elsewhere")
    assert done.status == 0, done.err
    assert "Given noise and prior" not in Path("elsewhere/finding.txt").read_text()


def test_a_recognizer_names_the_shape(tactorch: Any, finished_run: Path) -> None:
    network = Recognizer(["cake", "cone"], hidden=2)
    content = {"state_dict": network.state_dict(), "hyper_parameters": dict(network.hparams)}
    torch.save(content, "best.ckpt")
    done = tactorch("find", finished_run, "uncertainty=false", "recognizer=best.ckpt", "out=.")
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
        (("run=RUN", "uncertainty=false", "recognizer=gone.ckpt"), "gone.ckpt"),
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
