"""Surrogate: predicts mean and deviation of log-modulus from presses (Section VII)."""

from collections.abc import Sequence
from pathlib import Path

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

from tactorch.errors import ConfigError, FileError
from tactorch.learning.surrogate.features import PRESS_CHANNELS, SHARED_CHANNELS, VERSION
from tactorch.learning.surrogate.unet import PressUNet
from tactorch.learning.training import Network, load_network, read_checkpoint, save_atomically

#: Weights of tactorch; surrogate.json states the data and settings of their training.
INCLUDED_WEIGHTS = Path(__file__).with_name("surrogate.pt")

_MIN_LOG, _MAX_LOG = -5.0, 1.0  # limits of the logarithm of the deviation
_IMAGE = SHARED_CHANNELS.index("image")


class Surrogate(Network):
    """Predicts a normal distribution of log-modulus per voxel, relative to the best uniform one.

    The loss is the negative log-likelihood, weighted per voxel by the (detached) deviation, so that
    the mean is not neglected where the deviation is large (Seitzer et al., 2022). Epochs are
    selected by the unweighted negative log-likelihood.

    Args:
        press_scale: Scale of each channel of a press; a buffer of the module.
        shared_scale: Scale of each channel of the object; a buffer of the module.
        width: Channels of the widest layers of full resolution.
        encoded: Channels of an encoded press.
        learning_rate: Largest learning rate of AdamW.
        weight_decay: Weight decay of AdamW.
        cells: Cells of the input in each direction; stored with the weights.
        frames: Load steps per press location in the input; stored with the weights.
        version: Version of the input; stored with the weights.
    """

    press_scale: Tensor
    shared_scale: Tensor

    def __init__(
        self,
        press_scale: Sequence[float] = (1.0,) * len(PRESS_CHANNELS),
        shared_scale: Sequence[float] = (1.0,) * len(SHARED_CHANNELS),
        width: int = 48,
        encoded: int = 24,
        learning_rate: float = 2e-3,
        weight_decay: float = 1e-3,
        cells: int = 8,
        frames: int = 1,
        version: int = VERSION,
    ) -> None:
        super().__init__(learning_rate, weight_decay)
        if version != VERSION:
            raise ConfigError(
                f"the weights are for version {version} of the input, and this tactorch has version"
                f" {VERSION}; train again."
            )
        self.save_hyperparameters()
        self.cells, self.frames = cells, frames
        self.register_buffer("press_scale", torch.tensor(list(press_scale)))
        self.register_buffer("shared_scale", torch.tensor(list(shared_scale)))
        self.network = PressUNet(len(PRESS_CHANNELS), len(SHARED_CHANNELS), 2, width, encoded)

    def forward(
        self,
        presses: Float[Tensor, "b k c v v v"],
        mask: Bool[Tensor, "b k"],
        shared: Float[Tensor, "b s v v v"],
    ) -> tuple[Float[Tensor, "b w w w"], Float[Tensor, "b w w w"]]:
        """Return mean and standard deviation of log E relative to the uniform modulus.

        `mask` is False for padding.
        """
        presses = presses / self.press_scale[:, None, None, None]
        scaled = shared / self.shared_scale[:, None, None, None]
        mean, raw = self.network(presses, mask, scaled).unbind(dim=1)
        image = functional.interpolate(shared, scale_factor=2, mode="trilinear")[:, _IMAGE]
        middle, half = 0.5 * (_MIN_LOG + _MAX_LOG), 0.5 * (_MAX_LOG - _MIN_LOG)
        return mean + image, torch.exp(middle + half * torch.tanh(raw))

    def training_step(self, batch: Sequence[Tensor], index: int) -> Tensor:
        """Return the weighted loss of a batch."""
        loss, deviation = self._log_likelihood(batch)
        self.log("train/loss", loss.detach().mean(), on_step=False, on_epoch=True, sync_dist=True)
        return (deviation.detach() * loss).mean()

    def predict_step(self, batch: Sequence[Tensor], index: int) -> tuple[Tensor, Tensor]:
        """Return mean and deviation."""
        mean, deviation = self(*batch[:3])
        return mean, deviation

    def _log_likelihood(self, batch: Sequence[Tensor]) -> tuple[Tensor, Tensor]:
        """Return negative log-likelihood (up to a constant) and deviation of the voxels inside."""
        *features, target, inside = batch
        mean, deviation = self(*features)
        residual = (target - mean) / deviation
        return (0.5 * residual * residual + deviation.log())[inside], deviation[inside]

    def scores(self, batch: Sequence[Tensor]) -> dict[str, Tensor]:
        """Return the unweighted loss, correlation, error and coverage of a batch."""
        *features, target, inside = batch
        mean, deviation = self(*features)
        error, sigma = (target - mean)[inside], deviation[inside]
        return {
            "loss": (0.5 * (error / sigma).square() + sigma.log()).mean(),
            "correlation": correlation(mean.exp(), target.exp(), inside).mean(),
            "rms_log": error.square().mean().sqrt(),
            "covered_90": (error.abs() < 1.6449 * sigma).double().mean(),
        }


def correlation(
    predicted: Float[Tensor, "b w w w"],
    truth: Float[Tensor, "b w w w"],
    inside: Bool[Tensor, "b w w w"],
) -> Float[Tensor, " b"]:
    """Return Pearson's correlation over the voxels inside of each object."""
    rows = []
    for a, b, mask in zip(predicted, truth, inside, strict=True):
        pair = torch.stack([a[mask], b[mask]]).double()
        rows.append(torch.corrcoef(pair)[0, 1])
    return torch.stack(rows).nan_to_num(0.0)


def load_surrogate(path: Path = INCLUDED_WEIGHTS) -> Surrogate:
    """Return a surrogate of a checkpoint, or a file of `export_weights`, in evaluation mode.

    Raises:
        FileError: The file is missing, damaged or of another model.
    """
    if path == INCLUDED_WEIGHTS and not path.is_file():
        raise FileError(
            f"the surrogate's weights are missing from this installation ('{path}'); reinstall"
            " tactorch, or make them with train/surrogate.py and give initialization.weights=FILE."
        )
    advice = "give the best.ckpt of a run of `tactorch train model=surrogate data=warmstart`"
    return load_network(Surrogate, path, "surrogate", advice)


def export_weights(checkpoint: Path, path: Path) -> None:
    """Write the weights of a checkpoint in half precision: about a fifth of its size.

    Raises:
        FileError: The checkpoint is missing or damaged.
    """
    stored = read_checkpoint(checkpoint)
    content = {
        "state_dict": {name: values.half() for name, values in stored["state_dict"].items()},
        "hyper_parameters": stored["hyper_parameters"],
    }
    save_atomically(content, path)
