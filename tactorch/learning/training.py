"""One training: from a data module and a module to weights, a curve and a summary."""

import io
import json
import signal
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import Any, ClassVar, Literal, TypeVar
from zipfile import ZipFile

import lightning
import torch
from lightning.fabric.utilities.exceptions import MisconfigurationException
from lightning.pytorch.callbacks import EarlyStopping, ModelCheckpoint
from lightning.pytorch.loggers import TensorBoardLogger
from lightning.pytorch.plugins.io import TorchCheckpointIO

from tactorch.config import Options, option
from tactorch.errors import ConfigError, FileError
from tactorch.files import atomic_path
from tactorch.learning.order import SeededSteps

LAST, BEST, CURVE = "last.ckpt", "best.ckpt", "curve.json"
_Network = TypeVar("_Network", bound=lightning.LightningModule)


@dataclass(frozen=True)
class TrainerOptions(Options):
    """Settings of a training.

    Attributes:
        seed: Seed of weights, order, augmentation and dropout.
        show_progress: Whether to show Lightning's progress bar.
    """

    section: ClassVar[str] = "trainer"
    accelerator: Literal["cpu", "gpu", "auto"] = option("cpu", "Kind of device")
    devices: int | Literal["auto"] = option(1, "Number of devices", ge=1)
    strategy: str = option("auto", "Strategy of Lightning; ddp: several devices")
    precision: str = option("32-true", "Precision, as Lightning names it")
    max_epochs: int = option(60, "Largest number of epochs", ge=1)
    patience: int | None = option(
        None, "Epochs without a lower validation loss before stopping; null: never", ge=1
    )
    gradient_clip: float | None = option(1.0, "Largest norm of a gradient; null: any", gt=0)
    max_minutes: float | None = option(None, "Time limit; null: none", unit="min", gt=0)
    seed: int = 0
    show_progress: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.accelerator == "gpu" and not torch.cuda.is_available():
            raise ConfigError("trainer=gpu needs a CUDA device, and torch sees none here.")


class AtomicCheckpointIO(TorchCheckpointIO):
    """Writes checkpoints whole or not at all."""

    def save_checkpoint(
        self, checkpoint: dict[str, Any], path: Any, storage_options: Any = None
    ) -> None:
        """Write a checkpoint; torch itself ends a process on a full disk."""
        memory = io.BytesIO()
        torch.save(checkpoint, memory)
        with atomic_path(path) as temporary:
            temporary.write_bytes(memory.getvalue())


class Curve(lightning.Callback):
    """The losses of every epoch, kept in the checkpoint and written beside it.

    Args:
        path: Of the JSON file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.epochs: list[dict[str, float]] = []

    def on_train_epoch_end(
        self, trainer: lightning.Trainer, module: lightning.LightningModule
    ) -> None:
        """Note the losses of the epoch."""
        values = {k: float(v) for k, v in trainer.callback_metrics.items()}
        self.epochs = self.epochs[: trainer.current_epoch]
        self.epochs.append({"epoch": float(trainer.current_epoch), **values})
        with atomic_path(self.path) as temporary:
            temporary.write_text(json.dumps(self.epochs, indent=1) + "\n", encoding="utf-8")

    def state_dict(self) -> dict[str, Any]:
        """Return what the checkpoint keeps."""
        return {"epochs": self.epochs}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from a checkpoint."""
        self.epochs = list(state["epochs"])


class EpochsTold(lightning.Callback):
    """Tells at the end of each epoch how many are done, of how many, and the losses.

    Args:
        tell: Called with epochs done, their limit, and a note such as ", loss 0.1".
    """

    def __init__(self, tell: Callable[[int, int, str], None]) -> None:
        self.tell = tell

    def on_train_epoch_end(
        self, trainer: lightning.Trainer, module: lightning.LightningModule
    ) -> None:
        """Tell."""
        if not trainer.is_global_zero:
            return
        names = {"train/loss": "loss", "val/loss": "validation"}
        found = {told: trainer.callback_metrics.get(name) for name, told in names.items()}
        note = "".join(
            f", {told} {value:.4g}" for told, value in found.items() if value is not None
        )
        self.tell(trainer.current_epoch + 1, int(trainer.max_epochs or 0), note)


def fit(
    module: lightning.LightningModule,
    data: lightning.LightningDataModule,
    folder: Path,
    options: TrainerOptions | None = None,
    callbacks: Sequence[lightning.Callback] = (),
) -> dict[str, float]:
    """Train, or go on from the folder's last checkpoint; returns the scores on the test part.

    Args:
        module: What to train; its weights are the best ones afterwards.
        data: What to train on.
        folder: Gets last.ckpt, best.ckpt, curve.json and TensorBoard's files.
        options: How.
        callbacks: Lightning's, beside our own.

    Raises:
        FileError: The checkpoint is damaged or of another model.
        ConfigError: An option cannot be used.
        KeyboardInterrupt: Ctrl-C ended the training; it goes on from its last epoch.
    """
    options = options or TrainerOptions()
    folder.mkdir(parents=True, exist_ok=True)
    judged = _has_validation(data)
    if options.patience is not None and not judged:
        raise ConfigError("trainer.patience needs a validation part; give it a share of the data.")
    trainer = _trainer(folder, options, judged, callbacks)
    last, best = folder / LAST, folder / BEST
    if last.is_file():
        check_checkpoint(last, module)
    on_interrupt = signal.getsignal(signal.SIGINT)
    try:
        trainer.fit(module, datamodule=data, ckpt_path=str(last) if last.is_file() else None)
    except SystemExit as end:  # so Lightning ends a process on Ctrl-C, without a word
        if trainer.interrupted:
            signal.signal(signal.SIGINT, on_interrupt)  # which Lightning took away
            raise KeyboardInterrupt from end
        raise
    except OSError as error:
        raise FileError(
            f"cannot write into '{folder}': {error}; check its permissions and the free space."
            " Training continues from its last checkpoint."
        ) from error
    if not judged:  # there is nothing to choose by: the last is as good as any
        trainer.save_checkpoint(best)
    load_weights(module, best)
    scores = trainer.test(module, datamodule=data, verbose=False)
    return {name: float(value) for part in scores for name, value in part.items()}


def _trainer(
    folder: Path,
    options: TrainerOptions,
    judged: bool,
    callbacks: Sequence[lightning.Callback],
) -> lightning.Trainer:
    """Make Lightning's trainer; it keeps the last epoch, and the best where that can be told."""
    kept = [ModelCheckpoint(folder, Path(LAST).stem, enable_version_counter=False)]
    if judged:
        name = Path(BEST).stem
        kept.append(ModelCheckpoint(folder, name, monitor="val/loss", enable_version_counter=False))
    limit = None if options.max_minutes is None else timedelta(minutes=options.max_minutes)
    settings: dict[str, Any] = dict(
        accelerator=options.accelerator,
        devices=options.devices,
        strategy=options.strategy,
        precision=options.precision,
        max_epochs=options.max_epochs,
        max_time=limit,
        gradient_clip_val=options.gradient_clip,
        callbacks=[
            *kept,
            Curve(folder / CURVE),
            SeededSteps(options.seed),
            *_patience(options.patience),
            *callbacks,
        ],
        logger=TensorBoardLogger(str(folder), name="", version="tensorboard"),
        enable_progress_bar=options.show_progress,
        enable_model_summary=False,
        log_every_n_steps=1,
        num_sanity_val_steps=0,
        deterministic="warn",
        plugins=[AtomicCheckpointIO()],
    )
    try:
        return lightning.Trainer(**settings)
    except (ValueError, TypeError, RuntimeError, MisconfigurationException) as error:
        raise ConfigError(f"trainer: {' '.join(str(error).split())}") from error


def _has_validation(data: lightning.LightningDataModule) -> bool:
    loader = data.val_dataloader()
    return loader is not None and len(loader) > 0


def check_checkpoint(path: Path, module: lightning.LightningModule) -> Mapping[str, Any]:
    """Read a checkpoint, and make sure that its weights fit the module.

    Raises:
        FileError: It is missing, damaged or of another model; says what differs.
    """
    content = read_checkpoint(path)
    weights, wanted = content["state_dict"], module.state_dict()
    for name in sorted({*weights, *wanted}):
        have = tuple(weights[name].shape) if name in weights else None
        want = tuple(wanted[name].shape) if name in wanted else None
        if have != want:
            there, here = ("missing" if shape is None else shape for shape in (have, want))
            raise FileError(
                f"checkpoint '{path}' is of another model: {name} is {there} there and {here} here;"
                " give the settings that it was trained with."
            )
    return content


def read_checkpoint(path: Path) -> Mapping[str, Any]:
    """Read a checkpoint; nothing in it is run.

    Raises:
        FileError: It is missing or damaged.
    """
    try:
        with ZipFile(path) as archive:  # torch does not compare the checksums
            damaged = archive.testzip()
        if damaged is not None:
            raise ValueError(f"the checksum of {damaged} differs")
        content = torch.load(path, map_location="cpu", weights_only=True)
        content["state_dict"].items()
    except FileNotFoundError as error:
        raise FileError(f"checkpoint not found: '{path}'.") from error
    except Exception as error:  # what a damaged archive raises has no common base
        reason = " ".join(f"{type(error).__name__}: {error}".split())[:120]
        raise FileError(
            f"checkpoint '{path}' is damaged or no checkpoint ({reason}); train again, or give"
            " another."
        ) from error
    assert isinstance(content, Mapping)
    return content


def rebuild(make: Callable[..., _Network], path: Path, kind: str, advice: str) -> _Network:
    """Load a network in evaluation mode from a checkpoint, which contains its settings.

    Args:
        make: The network's class.
        path: The checkpoint.
        kind: What messages call the network.
        advice: What to do where the checkpoint is another network's.

    Raises:
        FileError: The file is missing, damaged or of another network.
    """
    content = read_checkpoint(path)
    try:
        network = make(**content["hyper_parameters"])
        network.load_state_dict({k: v.float() for k, v in content["state_dict"].items()})
    except ConfigError as error:
        raise FileError(f"weights '{path}': {error}") from error
    except (KeyError, TypeError, RuntimeError, AttributeError) as error:
        reason = " ".join(str(error).split())[:120]
        raise FileError(f"weights '{path}' are not a {kind}'s ({reason}); {advice}.") from error
    return network.eval()


def load_weights(module: lightning.LightningModule, path: Path) -> None:
    """Take the weights of a checkpoint.

    Raises:
        FileError: It is missing, damaged or of another model.
    """
    module.load_state_dict(check_checkpoint(path, module)["state_dict"])


def _patience(epochs: int | None) -> list[lightning.Callback]:
    return [] if epochs is None else [EarlyStopping("val/loss", patience=epochs)]
