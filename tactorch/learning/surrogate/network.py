"""The surrogate: from presses on a grid to log Young's modulus and how sure it is (Section VII)."""

from collections.abc import Sequence
from typing import Any

import lightning
import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

from tactorch.errors import ConfigError
from tactorch.learning.order import scheduled_adam
from tactorch.learning.surrogate.touch import PRESS_CHANNELS, SHARED_CHANNELS, VERSION
from tactorch.learning.surrogate.unet import PressUNet

_MIN_LOG, _MAX_LOG = -5.0, 1.0  # of the standard deviation
_IMAGE = SHARED_CHANNELS.index("image")


class Surrogate(lightning.LightningModule):
    """Predicts a normal distribution of each voxel's log-modulus over the best uniform one.

    The loss is the negative log-likelihood, weighted per voxel by the (detached) deviation, so that
    the mean is not neglected where the deviation is large (Seitzer et al., 2022). Epochs are
    selected by the unweighted negative log-likelihood.

    Args:
        press_scale: Typical size of each of a press's channels; a buffer among the weights.
        shared_scale: The same of the object's channels.
        width: See `PressUNet`.
        encoded: See `PressUNet`.
        learning_rate: Largest learning rate of AdamW.
        weight_decay: Weight decay of AdamW.
        cells: Cells of its input in each direction; stored with the weights.
        frames: Load steps of each place in its input; likewise.
        version: Version of its input; likewise.
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
        super().__init__()
        if not (learning_rate > 0 and weight_decay >= 0):
            raise ConfigError("learning_rate must be above 0, and weight_decay not below.")
        if version != VERSION:
            raise ConfigError(
                f"these weights are for version {version} of a surrogate's input, and this tactorch"
                f" has version {VERSION}; train it again."
            )
        self.save_hyperparameters()
        self.cells, self.frames = cells, frames
        self.register_buffer("press_scale", torch.tensor(list(press_scale)))
        self.register_buffer("shared_scale", torch.tensor(list(shared_scale)))
        self.learning_rate, self.weight_decay = learning_rate, weight_decay
        self.network = PressUNet(len(PRESS_CHANNELS), len(SHARED_CHANNELS), 2, width, encoded)

    def forward(
        self,
        presses: Float[Tensor, "b k c v v v"],
        there: Bool[Tensor, "b k"],
        shared: Float[Tensor, "b s v v v"],
    ) -> tuple[Float[Tensor, "b w w w"], Float[Tensor, "b w w w"]]:
        """Return mean and standard deviation of log E over the uniform modulus."""
        scaled = presses / self.press_scale[:, None, None, None]
        mean, rough = self.network(
            scaled, there, shared / self.shared_scale[:, None, None, None]
        ).unbind(dim=1)
        image = functional.interpolate(shared, scale_factor=2, mode="trilinear")[:, _IMAGE]
        middle, half = 0.5 * (_MIN_LOG + _MAX_LOG), 0.5 * (_MAX_LOG - _MIN_LOG)
        return mean + image, torch.exp(middle + half * torch.tanh(rough))

    def training_step(self, batch: Sequence[Tensor], index: int) -> Tensor:
        """Return the weighted loss of a batch."""
        each, deviation = self._log_likelihood(batch)
        values = {"train/loss": each.detach().mean()}
        self.log_dict(values, on_step=False, on_epoch=True, sync_dist=True)
        return (deviation.detach() * each).mean()

    def validation_step(self, batch: Sequence[Tensor], index: int) -> None:
        """Log the loss and the correlation with the truth."""
        self._log("val", batch)

    def test_step(self, batch: Sequence[Tensor], index: int) -> None:
        """Log the loss and the correlation with the truth."""
        self._log("test", batch)

    def predict_step(self, batch: Sequence[Tensor], index: int) -> tuple[Tensor, Tensor]:
        """Return mean and deviation."""
        presses, there, shared, *_ = batch
        mean, deviation = self(presses, there, shared)
        return mean, deviation

    def configure_optimizers(self) -> Any:
        """Return AdamW with a linear warm-up and cosine decay."""
        return scheduled_adam(self, self.learning_rate, self.weight_decay)

    def _log_likelihood(self, batch: Sequence[Tensor]) -> tuple[Tensor, Tensor]:
        """Of each voxel inside, negative and but for a constant; and the deviations there."""
        presses, there, shared, target, inside = batch
        mean, deviation = self(presses, there, shared)
        off = (target - mean) / deviation
        return (0.5 * off * off + deviation.log())[inside], deviation[inside]

    def _log(self, part: str, batch: Sequence[Tensor]) -> None:
        presses, there, shared, target, inside = batch
        mean, deviation = self(presses, there, shared)
        off = (target - mean)[inside]
        wide = deviation[inside]
        values = {
            f"{part}/loss": (0.5 * (off / wide).square() + wide.log()).mean(),
            f"{part}/correlation": correlation(mean.exp(), target.exp(), inside).mean(),
            f"{part}/rms_log": off.square().mean().sqrt(),
            f"{part}/covered_90": (off.abs() < 1.6449 * wide).double().mean(),
        }
        self.log_dict(values, batch_size=len(target), sync_dist=True)


def correlation(
    predicted: Float[Tensor, "b w w w"],
    truth: Float[Tensor, "b w w w"],
    inside: Bool[Tensor, "b w w w"],
) -> Float[Tensor, " b"]:
    """Return Pearson's correlation of each object's voxels inside."""
    rows = []
    for a, b, where in zip(predicted, truth, inside, strict=True):
        pair = torch.stack([a[where], b[where]]).double()
        rows.append(torch.corrcoef(pair)[0, 1])
    return torch.stack(rows).nan_to_num(0.0)
