"""Killed at any step, a training goes on to the same curve."""

import json
import signal
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import lightning
import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader, TensorDataset

from tactorch.errors import ConfigError, FileError
from tactorch.learning.data import AugmentedSamples, EpochSampler, SplitData, symmetries
from tactorch.learning.recognizer import RecognitionData, RecognitionOptions, Recognizer
from tactorch.learning.training import (
    BEST,
    CURVE,
    LAST,
    EpochProgress,
    TrainerOptions,
    check_checkpoint,
    derive_seed,
    fit,
    warmup_cosine,
)


class Blobs(RecognitionData):
    """Two classes of random maps that differ in their mean."""

    def __init__(self) -> None:
        options = RecognitionOptions(folder="blobs", batch=5)
        SplitData.__init__(self, options, 3, {"shards": []}, range(24), ["blob"] * 24)
        self.brightness = 0.1
        rng = torch.Generator().manual_seed(0)
        self.labels = torch.arange(24) % 2
        self.maps = (
            torch.randn(24, 1, 6, 6, 6, generator=rng) + self.labels[:, None, None, None, None]
        )
        self.allowed = symmetries(np.array([[0.0, 0.0, -1.0]]))

    def train_dataloader(self) -> DataLoader:
        data = AugmentedSamples(self, range(24), augment=True)
        return DataLoader(data, 5, sampler=EpochSampler(len(data), 3))

    def val_dataloader(self) -> DataLoader:
        return DataLoader(TensorDataset(self.maps, self.labels), 12)

    def test_dataloader(self) -> DataLoader:
        return self.val_dataloader()


class Stop(lightning.Callback):
    """Kills the training at a step, as an exception that nothing catches."""

    def __init__(self, step: int) -> None:
        self.step = step

    def on_train_batch_end(self, trainer: lightning.Trainer, *others: object) -> None:
        if trainer.global_step == self.step:
            raise RuntimeError("killed")


def trained(folder: Path, callbacks: tuple = (), **options: object) -> list[dict[str, float]]:
    lightning.seed_everything(1, verbose=False)
    model = Recognizer(["a", "b"], hidden=4, layers=2, dropout=0.5)
    fit(model, Blobs(), folder, TrainerOptions(max_epochs=4, **options), callbacks)
    curve: list[dict[str, float]] = json.loads((folder / CURVE).read_text())
    return curve


def test_fewer_epochs_than_trained_are_refused(tmp_path: Path) -> None:
    trained(tmp_path)
    model = Recognizer(["a", "b"], hidden=4, layers=2, dropout=0.5)
    with pytest.raises(ConfigError, match=r"max_epochs=3: the training in .* has 4 epochs"):
        fit(model, Blobs(), tmp_path, TrainerOptions(max_epochs=3))


class PressCtrlC(lightning.Callback):
    """Interrupts the training at the end of an epoch."""

    def __init__(self, epoch: int) -> None:
        self.epoch = epoch

    def on_train_epoch_end(self, trainer: lightning.Trainer, *others: object) -> None:
        if trainer.current_epoch == self.epoch:
            raise KeyboardInterrupt


def test_ctrl_c_is_an_interruption_and_can_be_pressed_again(tmp_path: Path) -> None:
    before = signal.getsignal(signal.SIGINT)
    try:
        with pytest.raises(KeyboardInterrupt):
            trained(tmp_path, (PressCtrlC(2),))
        assert signal.getsignal(signal.SIGINT) is before
    finally:
        signal.signal(signal.SIGINT, before)
    assert (tmp_path / LAST).is_file()


def test_epochs_are_reported_with_their_losses(tmp_path: Path) -> None:
    reports: list[tuple[int, int, str]] = []
    curve = trained(tmp_path, (EpochProgress(lambda *report: reports.append(report)),))
    assert [report[:2] for report in reports] == [(done, 4) for done in range(1, 5)]
    for (*_, note), epoch in zip(reports, curve, strict=True):
        losses = f", loss {epoch['train/loss']:.4g}, validation {epoch['val/loss']:.4g}"
        assert note == losses


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, float]]:
    return trained(tmp_path_factory.mktemp("whole"))


@pytest.mark.parametrize(
    "step",
    [1, pytest.param(7, marks=pytest.mark.slow), 12, pytest.param(19, marks=pytest.mark.slow)],
)
def test_a_killed_training_ends_with_the_same_curve(
    undisturbed: list[dict[str, float]], tmp_path: Path, step: int
) -> None:
    with pytest.raises(RuntimeError, match="killed"):
        trained(tmp_path, (Stop(step),))
    resumed = trained(tmp_path)
    assert len(resumed) == 4
    for found, expected in zip(resumed, undisturbed, strict=True):
        assert found == pytest.approx(expected, rel=1e-6)
    assert undisturbed[-1]["val/loss"] < undisturbed[0]["val/loss"]


class Rising(lightning.Callback):
    """Makes the validation loss rise from epoch to epoch."""

    def on_validation_epoch_end(
        self, trainer: lightning.Trainer, module: lightning.LightningModule
    ) -> None:
        module.log("val/loss", float(trainer.current_epoch))


def test_the_last_epoch_is_kept_even_if_the_first_was_the_best(tmp_path: Path) -> None:
    trained(tmp_path, (Rising(),))
    epochs = [torch.load(tmp_path / name)["epoch"] for name in (LAST, BEST)]
    assert epochs == [3, 0]


class WithoutValidation(Blobs):
    """Has no validation part."""

    def val_dataloader(self) -> DataLoader:
        return DataLoader(TensorDataset(self.maps[:0], self.labels[:0]), 12)


def test_without_validation_the_last_weights_are_the_result(tmp_path: Path) -> None:
    model = Recognizer(["a", "b"], hidden=4, layers=2)
    fit(model, WithoutValidation(), tmp_path, TrainerOptions(max_epochs=2))
    weights = [torch.load(tmp_path / name)["state_dict"] for name in (LAST, BEST)]
    torch.testing.assert_close(*weights)
    with pytest.raises(ConfigError, match="needs a validation part"):
        fit(model, WithoutValidation(), tmp_path, TrainerOptions(patience=3))
    with pytest.raises(ConfigError, match="trainer: "):
        fit(model, Blobs(), tmp_path / "x", TrainerOptions(precision="7-bit"))


def test_order_and_augmentation_depend_on_seed_and_epoch_alone() -> None:
    sampler = EpochSampler(10, seed=1)
    first = list(sampler)
    sampler.set_epoch(1)
    second = list(sampler)
    assert sorted(place for _, place in first) == list(range(10))
    assert [place for _, place in first] != [place for _, place in second]
    assert {epoch for epoch, _ in second} == {1}
    maps = AugmentedSamples(Blobs(), range(24), augment=True)
    torch.testing.assert_close(maps[(2, 5)][0], maps[(2, 5)][0])
    assert not torch.equal(maps[(2, 5)][0], maps[(3, 5)][0])
    assert len({derive_seed(1, 2), derive_seed(2, 1), derive_seed(1, 3)}) == 3


def test_learning_rate_rises_and_falls_to_nothing() -> None:
    factor = warmup_cosine(100)
    values = [factor(step) for step in range(101)]
    assert max(values) == values[9] == 1.0
    assert values[100] == pytest.approx(0.0, abs=1e-12)
    assert all(later <= former for former, later in pairwise(values[10:]))


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda path: path.unlink(), "checkpoint not found"),
        (lambda path: path.write_bytes(b"x" * 500), "is damaged or no checkpoint"),
        (lambda path: path.write_bytes(path.read_bytes()[:2000]), "is damaged or no checkpoint"),
        (
            lambda path: torch.save({"state_dict": {}}, path),
            "of another model: deviation is missing there",
        ),
    ],
)
def test_a_wrong_checkpoint_is_refused(
    tmp_path: Path, spoil: Callable[[Path], object], message: str
) -> None:
    trained(tmp_path)
    spoil(tmp_path / LAST)
    with pytest.raises(FileError, match=message):
        check_checkpoint(tmp_path / LAST, Recognizer(["a", "b"], hidden=4, layers=2))


def test_the_message_names_a_weight_of_another_shape(tmp_path: Path) -> None:
    trained(tmp_path)
    with pytest.raises(FileError, match=r"hidden\.0\.weight is \(4, 1, 3, 3, 3\) there"):
        check_checkpoint(tmp_path / LAST, Recognizer(["a", "b"], hidden=8, layers=2))


def test_wrong_options_are_refused() -> None:
    with pytest.raises(ConfigError, match="max_epochs=0"):
        TrainerOptions(max_epochs=0)
    if not torch.cuda.is_available():
        with pytest.raises(ConfigError, match="needs a CUDA device"):
            TrainerOptions(accelerator="gpu")
