"""Networks of other packages in `tactorch train` and `tactorch evaluate-model`."""

from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from tactorch.cli.train import MODELS, TrainOptions
from tactorch.config import Options, option
from tactorch.errors import ConfigError
from tactorch.learning.recognizer import Recognizer
from tactorch.learning.training import NetworkOptions


@dataclass(frozen=True, kw_only=True)
class Deep(NetworkOptions):
    """Recognizer with eight hidden layers."""

    data = "recognition"
    hidden: int = option(32, "Channels of the hidden layers", ge=1)

    def __call__(self, data: Any) -> Recognizer:
        return Recognizer(data.classes, layers=8, **vars(self))


@pytest.fixture
def deep(monkeypatch: pytest.MonkeyPatch) -> type[Options]:
    monkeypatch.setattr(MODELS, "_added", {**MODELS._added, "deep": Deep})
    return Deep


def train_options(model: Options, data: str = "recognition") -> TrainOptions:
    table = {"model": model, "data": {"name": data, "folder": "data"}}
    return TrainOptions.from_mapping(table)


def test_a_network_declares_its_data(deep: type[Options]) -> None:
    options = train_options(deep(hidden=8))
    network = options.model(SimpleNamespace(classes=["ball", "cube"]))
    assert network.classes == ["ball", "cube"]
    assert network.options.hidden == 8
    with pytest.raises(ConfigError, match="model=deep learns from data=recognition, not from data"):
        train_options(deep(), data="warmstart").make_data(0)


def test_a_network_without_declared_data_is_refused() -> None:
    with pytest.raises(ConfigError, match="does not declare its data"):
        train_options(Options()).make_data(0)


def test_other_networks_have_no_evaluation(tactorch: Any, deep: type[Options]) -> None:
    Path("trained/.hydra").mkdir(parents=True)
    settings = "model: {name: deep}\ndata: {name: recognition, folder: nowhere}\n"
    Path("trained/.hydra/config.yaml").write_text(settings)
    done = tactorch("evaluate-model", "run=trained", "run_dir=out")
    assert done.status == 2
    assert "model=deep has no evaluation" in done.err
