"""Loggers of a training: files, pictures, hyperparameters, and packages that are missing."""

import csv
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import lightning
import pytest
from lightning.pytorch.loggers import CSVLogger
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from tactorch.errors import ConfigError
from tactorch.learning import loggers
from tactorch.learning.loggers import LOGGERS, log_figure, log_scores
from tactorch.viz.figure import new_axes


@pytest.fixture
def figure() -> Any:
    figure, axes = new_axes(2.0, 1.5)
    axes.plot([0, 1], [0, 1])
    return figure


def test_tensorboard_has_pictures_and_hyperparameters_with_scores(
    tmp_path: Path, figure: Any
) -> None:
    logger = LOGGERS.build("tensorboard").build(tmp_path)
    logger.log_metrics({"train/loss": 0.5}, 3)
    assert log_figure(logger, "val/confusion", figure, 3)
    log_scores(logger, {"hidden": 8}, {"test/loss": 0.25})
    logger.finalize("success")
    found = EventAccumulator(str(tmp_path / "tensorboard"), size_guidance={"images": 0})
    found.Reload()
    assert found.Tags()["images"] == ["val/confusion"]
    (picture,) = found.Images("val/confusion")
    assert (picture.step, picture.width) == (3, 200)
    assert found.Scalars("train/loss")[0].value == 0.5
    assert found.Scalars("test/loss")[0].value == 0.25
    assert "_hparams_/session_start_info" in found.summary_metadata


def test_csv_is_a_table_without_pictures(tmp_path: Path, figure: Any) -> None:
    logger = LOGGERS.build("csv").build(tmp_path)
    logger.log_metrics({"train/loss": 0.5}, 3)
    assert not log_figure(logger, "val/confusion", figure, 3)
    log_scores(logger, {"hidden": 8}, {"test/loss": 0.25})
    logger.save()
    with (tmp_path / "csv" / "metrics.csv").open(newline="") as file:
        (row,) = csv.DictReader(file)
    assert (row["step"], row["train/loss"]) == ("3", "0.5")


def test_none_logs_nothing(tmp_path: Path) -> None:
    assert LOGGERS.build("none").build(tmp_path) is None
    log_scores(None, {}, {})
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["wandb", "mlflow"])
def test_a_missing_package_is_named(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(loggers, "find_spec", lambda package: None)
    with pytest.raises(ConfigError, match=rf"logger={name} needs .* pip install {name}"):
        LOGGERS.build(name).build(tmp_path)


def test_wandb_gets_images(figure: Any) -> None:
    class WandbLogger:
        """Takes what the logger of Lightning takes."""

        experiment = None

        def log_image(self, key: str, images: list[Any], step: int) -> None:
            self.logged = (key, images[0].size, step)

    logger: Any = WandbLogger()
    assert log_figure(logger, "val/examples", figure, 7)
    assert logger.logged == ("val/examples", (200, 150), 7)


def test_mlflow_gets_figures(figure: Any) -> None:
    class MLFlowLogger:
        """Takes what the logger of Lightning takes."""

        run_id = "run"

        @property
        def experiment(self) -> Any:
            return self

        def log_figure(self, run: str, figure: Any, file: str) -> None:
            self.logged = (run, file)

    logger: Any = MLFlowLogger()
    assert log_figure(logger, "val/examples", figure, 7)
    assert logger.logged == ("run", "val_examples-000007.png")


@pytest.mark.parametrize(("val", "logged"), [((), ["test/confusion"]), ((3,), [])])
def test_pictures_are_of_the_test_part_where_there_is_no_validation(
    val: tuple[int, ...], logged: list[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    from tactorch.cli import train

    drawn: list[str] = []
    monkeypatch.setattr(train, "figures_of", lambda split: {"confusion": split.part})
    monkeypatch.setattr(train, "log_figure", lambda logger, name, *_: drawn.append(name) or True)
    data = SimpleNamespace(parts={"train": (0,), "val": val, "test": (1, 2)})
    trainer = lightning.Trainer(
        accelerator="cpu", logger=CSVLogger(tmp_path), enable_checkpointing=False
    )
    module = lightning.LightningModule()
    train.TrainingPictures(data, 1).on_test_epoch_end(trainer, module)
    assert drawn == logged
    train.TrainingPictures(data, 0).on_test_epoch_end(trainer, module)
    assert drawn == logged
