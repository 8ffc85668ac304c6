"""Training of a network: settings, callbacks, checkpoints and the learning-rate schedule.

The random numbers of a training depend only on seed, epoch and step, so that a training resumed
from a checkpoint gives the same result as an uninterrupted one.
"""

import io
import json
import math
import signal
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import timedelta
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, Literal, TypeVar
from zipfile import ZipFile

import lightning
import numpy as np
import torch
from lightning.fabric.utilities.exceptions import MisconfigurationException
from lightning.pytorch.callbacks import EarlyStopping, LambdaCallback, ModelCheckpoint
from lightning.pytorch.plugins.io import TorchCheckpointIO
from torch import Tensor

from tactorch.budget import check_archive, check_memory, read_content
from tactorch.config import Options, option
from tactorch.errors import ConfigError, FileError, TactorchError
from tactorch.files import write_file
from tactorch.learning.loggers import LoggerOptions, TensorBoard, log_scores
from tactorch.learning.quantization import decompress, dequantize

LAST, BEST, CURVE = "last.ckpt", "best.ckpt", "curve.json"
_LONG = 1000  # values of a setting, and characters of each
_Network = TypeVar("_Network", bound="Network")


@dataclass(frozen=True)
class TrainerOptions(Options):
    """Settings of a training."""

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

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.accelerator == "gpu" and not torch.cuda.is_available():
            raise ConfigError("trainer=gpu needs a CUDA device, and torch sees none here.")


class AtomicCheckpointIO(TorchCheckpointIO):
    """Writes checkpoints atomically; `torch.save` to a full disk would abort the process."""

    def save_checkpoint(
        self, checkpoint: dict[str, Any], path: Any, storage_options: Any = None
    ) -> None:
        """Write a checkpoint."""
        memory = io.BytesIO()
        torch.save(checkpoint, memory)
        write_file(path, memory.getvalue())


class LossHistory(lightning.Callback):
    """Writes the losses of every epoch to a JSON file, and stores them in the checkpoint."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.epochs: list[dict[str, float]] = []

    def on_train_epoch_end(
        self, trainer: lightning.Trainer, module: lightning.LightningModule
    ) -> None:
        """Record the losses of the epoch."""
        values = {k: float(v) for k, v in trainer.callback_metrics.items()}
        self.epochs = self.epochs[: trainer.current_epoch]
        self.epochs.append({"epoch": float(trainer.current_epoch), **values})
        write_file(self.path, json.dumps(self.epochs, indent=1) + "\n")

    def state_dict(self) -> dict[str, Any]:
        """Return the state for the checkpoint."""
        return {"epochs": self.epochs}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore the state of a checkpoint."""
        self.epochs = list(state["epochs"])


class EpochProgress(lightning.Callback):
    """Calls `report` with the finished epochs, their limit, and a note such as ", loss 0.1"."""

    def __init__(self, report: Callable[[int, int, str], None]) -> None:
        self.report = report

    def on_train_epoch_end(
        self, trainer: lightning.Trainer, module: lightning.LightningModule
    ) -> None:
        """Report the epoch."""
        if trainer.is_global_zero:
            metrics = trainer.callback_metrics
            names = {"train/loss": "loss", "val/loss": "validation"}
            losses = [f", {names[key]} {metrics[key]:.4g}" for key in names if key in metrics]
            self.report(trainer.current_epoch + 1, int(trainer.max_epochs or 0), "".join(losses))


def seed_steps(seed: int) -> lightning.Callback:
    """Return a callback that seeds the random numbers of a network (dropout) at each step."""

    def seed_step(trainer: lightning.Trainer, *others: Any) -> None:
        torch.manual_seed(derive_seed(seed, trainer.global_step))

    return LambdaCallback(on_train_batch_start=seed_step)


def derive_seed(*numbers: int) -> int:
    """Return a seed derived from several integers, such as seed and step."""
    sequence = np.random.SeedSequence(list(numbers))
    return int(sequence.generate_state(1, np.uint64)[0] >> np.uint64(1))


@dataclass(frozen=True, kw_only=True)
class NetworkOptions(Options):
    """Settings of a network; calling them with a data module makes it.

    Attributes:
        data: Name of the data that it learns from.
    """

    section: ClassVar[str] = "model"
    data: ClassVar[str]
    learning_rate: float = option(2e-3, "Largest learning rate of AdamW", gt=0)
    weight_decay: float = option(1e-3, "Weight decay of AdamW", ge=0)


class Network(lightning.LightningModule):
    """Network that is trained by AdamW with a linear warm-up and cosine decay."""

    def __init__(self, options: NetworkOptions) -> None:
        super().__init__()
        self.save_hyperparameters(vars(options))
        self.options = options

    @abstractmethod
    def scores(self, batch: Sequence[Tensor]) -> dict[str, Tensor]:
        """Return the loss and other scores of a batch by name."""

    def validation_step(self, batch: Sequence[Tensor], index: int) -> None:
        """Log the scores of a batch."""
        self._log_scores("val", batch)

    def test_step(self, batch: Sequence[Tensor], index: int) -> None:
        """Log the scores of a batch."""
        self._log_scores("test", batch)

    def _log_scores(self, part: str, batch: Sequence[Tensor]) -> None:
        values = {f"{part}/{name}": value for name, value in self.scores(batch).items()}
        self.log_dict(values, batch_size=len(batch[-1]), sync_dist=True)

    def configure_optimizers(self) -> Any:
        """Return the optimizer and its schedule."""
        rate, decay = self.options.learning_rate, self.options.weight_decay
        optimizer = torch.optim.AdamW(self.parameters(), lr=rate, weight_decay=decay)
        factor = warmup_cosine(int(self.trainer.estimated_stepping_batches))
        schedule = torch.optim.lr_scheduler.LambdaLR(optimizer, factor)
        return [optimizer], [{"scheduler": schedule, "interval": "step"}]


def warmup_cosine(steps: int, warmup: float = 0.1) -> Callable[[int], float]:
    """Return the learning-rate factor by step: linear warm-up, then cosine decay to 0."""
    first = max(1, round(warmup * max(1, steps)))

    def factor(step: int) -> float:
        if step < first:
            return (step + 1) / first
        return 0.5 * (1.0 + math.cos(math.pi * min(1.0, (step - first) / max(1, steps - first))))

    return factor


def fit(
    module: lightning.LightningModule,
    data: lightning.LightningDataModule,
    folder: Path,
    options: TrainerOptions | None = None,
    callbacks: Sequence[lightning.Callback] = (),
    *,
    logger: LoggerOptions | None = None,
) -> dict[str, float]:
    """Train a network, from the last checkpoint of the folder if there is one.

    Args:
        module: Network; it has the best weights afterwards.
        data: Data module.
        folder: Folder for last.ckpt, best.ckpt, curve.json and the files of the logger.
        options: Settings of the training.
        callbacks: Additional callbacks of Lightning.
        logger: Logger; TensorBoard by default.

    Returns:
        Scores on the test part by name.

    Raises:
        FileError: The checkpoint is damaged or of another model.
        ConfigError: An option is not valid.
        KeyboardInterrupt: Ctrl-C ended the training; the next call continues after its last epoch.
    """
    options = options or TrainerOptions()
    folder.mkdir(parents=True, exist_ok=True)
    validation = data.val_dataloader()
    has_validation = validation is not None and len(validation) > 0
    last, best = folder / LAST, folder / BEST
    make_checkpoint = partial(ModelCheckpoint, folder, enable_version_counter=False)
    checkpoints = [make_checkpoint(filename=last.stem)]
    if has_validation:
        checkpoints.append(make_checkpoint(filename=best.stem, monitor="val/loss"))
    if options.patience is not None:
        if not has_validation:
            raise ConfigError(
                "trainer.patience needs a validation part; give it a share of the data."
            )
        callbacks = [EarlyStopping("val/loss", patience=options.patience), *callbacks]
    own = [*checkpoints, LossHistory(folder / CURVE), seed_steps(options.seed)]
    trainer = _make_trainer(folder, options, [*own, *callbacks], logger or TensorBoard())
    if last.is_file():
        epochs = int(check_checkpoint(last, module).get("epoch", -1)) + 1
        if epochs > options.max_epochs:
            raise ConfigError(
                f"trainer.max_epochs={options.max_epochs}: the training in '{folder}' has {epochs} "
                "epochs; give more, or train in another folder (run_dir)."
            )
    on_interrupt = signal.getsignal(signal.SIGINT)
    try:
        trainer.fit(module, datamodule=data, ckpt_path=str(last) if last.is_file() else None)
    except SystemExit as end:  # Lightning exits on Ctrl-C without a message
        if trainer.interrupted:
            signal.signal(signal.SIGINT, on_interrupt)  # Lightning removed it
            raise KeyboardInterrupt from end
        raise
    except OSError as error:
        raise FileError(
            f"cannot write into '{folder}': {error}; check its permissions and the free space."
            " Training continues from its last checkpoint."
        ) from error
    if not has_validation:  # no loss to select an epoch by: take the last
        trainer.save_checkpoint(best)
    module.load_state_dict(check_checkpoint(best, module)["state_dict"])
    scores = trainer.test(module, datamodule=data, verbose=False)
    values = {name: float(value) for part in scores for name, value in part.items()}
    log_scores(trainer.logger, module.hparams_initial, values)
    return values


def _make_trainer(
    folder: Path,
    options: TrainerOptions,
    callbacks: list[lightning.Callback],
    logger: LoggerOptions,
) -> lightning.Trainer:
    limit = None if options.max_minutes is None else timedelta(minutes=options.max_minutes)
    try:
        return lightning.Trainer(
            accelerator=options.accelerator,
            devices=options.devices,
            strategy=options.strategy,
            precision=options.precision,  # type: ignore[arg-type]
            max_epochs=options.max_epochs,
            max_time=limit,
            gradient_clip_val=options.gradient_clip,
            callbacks=callbacks,
            logger=logger.build(folder) or False,
            enable_progress_bar=False,
            enable_model_summary=False,
            log_every_n_steps=1,
            num_sanity_val_steps=0,
            deterministic="warn",
            plugins=[AtomicCheckpointIO()],
        )
    except (ValueError, TypeError, RuntimeError, MisconfigurationException) as error:
        raise ConfigError(f"trainer: {' '.join(str(error).split())}") from error


def check_checkpoint(path: Path, module: lightning.LightningModule) -> Mapping[str, Any]:
    """Return the content of a checkpoint whose weights fit the module.

    Raises:
        FileError: The file is missing, damaged or of another model; the message names a difference.
    """
    content = read_checkpoint(path)
    weights, expected = content["state_dict"], module.state_dict()
    for name in sorted({*weights, *expected}):
        there, here = (
            tuple(part[name].shape) if name in part else "missing" for part in (weights, expected)
        )
        if there != here:
            raise FileError(
                f"checkpoint '{path}' is of another model: {name} is {there} there and {here} here;"
                " give the settings that it was trained with."
            )
    return content


def read_checkpoint(path: Path) -> Mapping[str, Any]:
    """Return the content of a checkpoint, without executing code in it.

    Raises:
        FileError: The file is missing or damaged.
    """
    try:
        archive = io.BytesIO(read_content(path))
        with ZipFile(archive) as entries:
            check_archive(path, entries, 3.0)
        content = torch.load(decompress(archive), map_location="cpu", weights_only=True)
        _check_values(path, content)
    except TactorchError:
        raise
    except FileNotFoundError as error:
        raise FileError(f"checkpoint not found: '{path}'.") from error
    except Exception as error:  # errors of damaged archives have no common base class
        reason = " ".join(f"{type(error).__name__}: {error}".split())[:120]
        raise FileError(
            f"checkpoint '{path}' is damaged or no checkpoint ({reason}); train again, or give"
            " another."
        ) from error
    assert isinstance(content, Mapping)
    return content


def _check_values(path: Path, content: Mapping[str, Any]) -> None:
    """Refuse weights that are not real and finite, and settings that are not plain and short."""
    state, scales = content["state_dict"], content.get("scales", {})
    # A tensor may repeat one number; the network has all of them.
    check_memory(path, "its weights", 3.0 * 4.0 * (_count(state) + _count(scales)))
    for name, values in [*scales.items(), *state.items()]:
        if values.layout != torch.strided or values.is_complex() or not values.isfinite().all():
            raise ValueError(f"{name} has values that are not real and finite")
    for name, value in content.get("hyper_parameters", {}).items():
        items = value if isinstance(value, list | tuple) else (value,)
        plain = (isinstance(x, str | float | int | None) and len(repr(x)) <= _LONG for x in items)
        if len(items) > _LONG or not all(plain):  # lists within others may be shared
            raise ValueError(f"its setting {name} is no value or short list of values")


def load_network(
    network_class: Callable[..., _Network], path: Path, kind: str, advice: str
) -> _Network:
    """Return a network in evaluation mode, with the settings and weights of a checkpoint.

    Messages name the `kind` of the network, and end with `advice` if it is another.

    Raises:
        FileError: The file is missing, damaged or of another network.
    """
    content = read_checkpoint(path)
    try:
        _check_sizes(network_class, content)
        network = network_class(**content["hyper_parameters"])
        network.load_state_dict(dequantize(content["state_dict"], content.get("scales", {})))
    except ConfigError as error:
        raise FileError(f"weights '{path}': {error}") from error
    except (KeyError, TypeError, RuntimeError, AttributeError) as error:
        reason = " ".join(str(error).split())[:120]
        raise FileError(f"weights '{path}' are not a {kind}'s ({reason}); {advice}.") from error
    return network.eval()


def _check_sizes(network_class: Callable[..., _Network], content: Mapping[str, Any]) -> None:
    """Refuse settings of a network that is larger than the weights of the checkpoint."""
    settings, stored = content["hyper_parameters"], _count(content["state_dict"])
    sizes = (value for value in settings.values() if isinstance(value, int))
    if (largest := max(sizes, default=0)) <= stored:
        with torch.device("meta"):  # without memory for the weights
            largest = _count(network_class(**settings).state_dict())
    if largest > stored:
        raise RuntimeError(f"its settings describe {largest} weights, and it holds {stored}")


def _count(state: Mapping[str, Any]) -> int:
    return sum(values.numel() for values in state.values())
