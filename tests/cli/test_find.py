"""`tactorch find`: inclusions under the presses of an earlier run."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from tactorch.errors import FileError
from tactorch.inverse import Reconstruction
from tactorch.inverse.result.text import describe
from tactorch.learning.recognizer import Recognizer
from tactorch.report import load_run
from tactorch.report.assessment import assess


@pytest.fixture(scope="module")
def searched(tactorch_module: Any, finished_run: Path, tmp_path_factory: Any) -> Path:
    """A run of method=map, whose presses were searched for inclusions afterwards."""
    folder = Path(shutil.copytree(finished_run, tmp_path_factory.mktemp("find") / "run"))
    assert tactorch_module("find", folder) == 0
    return folder


def test_inclusions_become_the_result_and_the_map_stays_beside_them(
    searched: Path, finished_run: Path
) -> None:
    before = Reconstruction.load(finished_run / "reconstruction.h5")
    run = load_run(searched)
    assert before.shapes is None
    assert run.result.shapes is not None
    assert run.result.other is not None
    np.testing.assert_array_equal(run.result.other.youngs, before.youngs)
    values = json.loads((searched / "finding.json").read_text())
    assert values == run.result.plain() == run.summary["finding"]
    assert values["status"] in {"found", "nothing found", "cannot tell"}
    assert 0.0 <= values["probability"] <= 1.0
    for lump in values["lumps"]:
        low, high = lump["mean_90_mpa"]
        assert low < lump["mean_mpa"] < high
    assert assess(run, uncertainty=False).result.plain() == values
    assert describe(run.result) in run.text
    assert (searched / "finding.txt").read_text() == f"{describe(run.result)}\n"


def test_a_run_with_inclusions_keeps_them(tactorch: Any, searched: Path) -> None:
    before = (searched / "reconstruction.h5").read_bytes()
    assert tactorch("find", searched).status == 0
    assert (searched / "reconstruction.h5").read_bytes() == before


def test_the_inclusions_of_an_earlier_version_are_read(
    searched: Path, finished_run: Path, tmp_path: Path
) -> None:
    """It kept them in a file of their own."""
    shapes = load_run(searched).result.shapes
    assert shapes is not None
    folder = Path(shutil.copytree(finished_run, tmp_path / "old"))
    from h5py import File

    with File(folder / "reconstruction.h5", "r+") as file:
        file.attrs["version"] = 1
        del file["finding"], file["residuals"]
    assert load_run(folder).result.shapes is None
    (folder / "shapes.json").write_text(json.dumps(shapes.plain()))
    run = load_run(folder)
    assert run.result.shapes is not None
    np.testing.assert_array_equal(run.result.shapes.z, shapes.z)
    assert run.result.other is not None
    (folder / "shapes.json").write_text("{}")
    with pytest.raises(FileError, match="tactorch find"):
        load_run(folder)


def test_a_recognizer_names_the_shape(tactorch: Any, searched: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(searched, tmp_path / "named"))
    network = Recognizer(["cake", "cone"], hidden=2)
    content = {"state_dict": network.state_dict(), "hyper_parameters": dict(network.hparams)}
    torch.save(content, "best.ckpt")
    done = tactorch("find", folder, "recognizer=best.ckpt")
    assert done.status == 0, done.err
    shapes = json.loads((folder / "finding.json").read_text())["shapes"]
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
        (("run=RUN", "recognizer=gone.ckpt"), "gone.ckpt"),
    ],
)
def test_wrong_input(
    tactorch: Any, finished_run: Path, settings: tuple[str, ...], words: str
) -> None:
    given = [word.replace("RUN", str(finished_run)) for word in settings]
    before = (finished_run / "finding.json").read_bytes()
    done = tactorch("find", *given)
    assert done.status == 2
    assert words in done.err
    assert (finished_run / "finding.json").read_bytes() == before
