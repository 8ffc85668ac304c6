"""Networks of other packages in `tactorch train` and `tactorch evaluate-model`."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from tactorch.cli.networks import MODELS, TrainOptions
from tactorch.config import Options, options_from_arguments
from tactorch.errors import ConfigError
from tactorch.learning.recognizer.network import Recognizer
from tactorch.learning.training import DataUse


class Deep(Recognizer):
    """Recognizer with eight hidden layers."""

    data_use = DataUse("recognition", ("classes",))

    def __init__(self, classes: list[str], hidden: int = 32) -> None:
        super().__init__(classes, hidden=hidden, layers=8)


@pytest.fixture
def deep(monkeypatch: pytest.MonkeyPatch) -> type[Options]:
    options = options_from_arguments(Deep, "model", without=Deep.data_use.arguments)
    monkeypatch.setattr(MODELS, "_added", {**MODELS._added, "deep": options})
    return options


def train_options(model: Options, data: str = "recognition") -> TrainOptions:
    table = {"model": model, "data": {"name": data, "folder": "data"}}
    return TrainOptions.from_mapping(table)


def test_a_network_declares_its_data(deep: type[Options]) -> None:
    options = train_options(deep(hidden=8))
    network = options.make_model(SimpleNamespace(classes=["ball", "cube"], mean=0.3))
    assert isinstance(network, Deep)
    assert network.classes == ["ball", "cube"]
    with pytest.raises(ConfigError, match="model=deep learns from data=recognition, not from data"):
        train_options(deep(), data="warmstart").data_use()


def test_a_network_without_declared_data_is_refused() -> None:
    with pytest.raises(ConfigError, match="does not declare its data"):
        train_options(Options()).data_use()


def test_other_networks_have_no_evaluation(tactorch: Any, deep: type[Options]) -> None:
    Path("trained/.hydra").mkdir(parents=True)
    settings = "model: {name: deep}\ndata: {name: recognition, folder: nowhere}\n"
    Path("trained/.hydra/config.yaml").write_text(settings)
    done = tactorch("evaluate-model", "run=trained", "run_dir=out")
    assert done.status == 2
    assert "model=deep has no evaluation" in done.err
