"""The paper's numbers, against the transcription that they were taken from."""

import json
import os
from pathlib import Path

import pytest

from tactorch.reproduce.design import CELLS, COLUMNS, METRICS
from tactorch.reproduce.models import MODELS
from tactorch.reproduce.paper import paper, row

_SHARED = Path(os.environ.get("TACTORCH_SHARED", "../shared"))
_NUMBERS = _SHARED / "reference" / "paper_numbers.json"


def test_every_model_and_cell_has_its_numbers():
    assert [line[0] for line in paper()["table1"]["rows"]] == list(MODELS)
    assert row("table1", "4a")["ssim_2500"] == 0.8019
    table = paper()["table2"]
    for name in CELLS:
        assert COLUMNS.get(name, name) in table["columns"]
    for model in ("model1", "model2"):
        assert set(table[model]) == set(METRICS)
        assert all(len(values) == len(table["columns"]) for values in table[model].values())


@pytest.mark.external
def test_the_numbers_are_those_of_the_paper():
    if not _NUMBERS.is_file():
        pytest.skip("the shared reference is not there; set TACTORCH_SHARED")
    known = json.loads(_NUMBERS.read_text())
    assert paper()["table1"]["rows"] == known["table1"]["rows"]
    for model in ("model1", "model2"):
        assert paper()["table2"][model] == known["table2"][model]
    depth = known["depth_estimation"]
    assert paper()["depth"] == {
        "accuracy": depth["accuracy"],
        "mean_error": pytest.approx(depth["mean_error_percent"] / 100),
    }
    assert paper()["recognition"]["accuracy"] == known["recognition"]["accuracy"]
    assert paper()["recognition"]["human_accuracy"] == known["recognition"]["human_accuracy"]
