"""Surrogate: predicts mean and deviation of log-modulus from presses (Section VII).

Its network is a 3-D U-Net (Ronneberger et al., 2015) with a shared encoder of the presses.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn import functional

from tactorch.config import option
from tactorch.errors import ConfigError, FileError
from tactorch.files import write_file
from tactorch.learning.quantization import compress, quantize
from tactorch.learning.surrogate.data import SurrogateData
from tactorch.learning.surrogate.features import PRESS_CHANNELS, SHARED_CHANNELS, VERSION
from tactorch.learning.training import Network, NetworkOptions, load_network

#: Weights of tactorch; surrogate.json states the data and settings of their training.
INCLUDED_WEIGHTS = Path(__file__).with_name("surrogate.pt")
#: Bits of the exported weights of layers of the coarse grid, two thirds of all, and of others.
WEIGHT_BITS = {"coarse grid": 4, "others": 8}

_MIN_LOG, _MAX_LOG = -5.0, 1.0  # limits of the logarithm of the deviation
_IMAGE = SHARED_CHANNELS.index("image")
_LAST = torch.channels_last_3d


class PressUNet(nn.Module):
    """Maps fields of the presses and the object to fields on a grid twice as fine.

    Presses are encoded one by one with the same weights and pooled by mean and maximum (Zaheer et
    al., 2017), so their number and order do not matter.

    Layers of full resolution have up to `width` channels, an encoded press has `encoded`.
    """

    def __init__(
        self, press_channels: int, shared_channels: int, out_channels: int, width: int, encoded: int
    ) -> None:
        super().__init__()
        fine = width // 2
        self.encoder = nn.Sequential(
            nn.Conv3d(press_channels + shared_channels, encoded, 3, padding=1),
            nn.SiLU(),
            nn.Conv3d(encoded, encoded, 3, padding=1),
            nn.SiLU(),
        )
        self.enter = nn.Conv3d(2 * encoded + shared_channels, width, 3, padding=1)
        self.first = Residual(width)
        self.down = nn.Conv3d(width, 2 * width, 2, stride=2)
        self.middle = nn.Sequential(Residual(2 * width), Residual(2 * width))
        self.up = nn.Conv3d(2 * width, width, 1)
        self.join = nn.Conv3d(2 * width, width, 3, padding=1)
        self.second = Residual(width)
        self.refine = nn.Conv3d(width, fine, 1)
        self.last = nn.Sequential(
            nn.Conv3d(fine + shared_channels, fine, 3, padding=1),
            nn.SiLU(),
            nn.Conv3d(fine, out_channels, 3, padding=1),
        )
        # Channels last is three times as fast on a CPU.
        self.to(memory_format=_LAST)  # type: ignore[call-overload]

    def forward(
        self,
        presses: Float[Tensor, "b k c v v v"],
        mask: Bool[Tensor, "b k"],
        shared: Float[Tensor, "b s v v v"],
    ) -> Float[Tensor, "b out w w w"]:
        """Return the fields; `mask` is False for padding."""
        joined = torch.cat([self._pooled(presses, mask, shared), shared], dim=1)
        wide = self.first(self.enter(joined.contiguous(memory_format=_LAST)))
        deep = self.middle(self.down(wide))
        back = self.up(functional.interpolate(deep, size=wide.shape[2:], mode="nearest"))
        wide = self.second(self.join(torch.cat([wide, back], dim=1)))
        return self.last(torch.cat([_upsample(self.refine(wide)), _upsample(shared)], dim=1))

    def _pooled(self, presses: Tensor, mask: Tensor, shared: Tensor) -> Tensor:
        indices = mask.nonzero(as_tuple=True)
        joined = torch.cat([presses[indices], shared[indices[0]]], dim=1)
        codes = self.encoder(joined.contiguous(memory_format=_LAST))
        padded = codes.new_zeros((*mask.shape, *codes.shape[1:]))
        padded[indices] = codes
        mean = padded.sum(dim=1) / mask.sum(dim=1)[:, None, None, None, None]
        lowest = torch.finfo(padded.dtype).min
        padding = ~mask[:, :, None, None, None, None]
        return torch.cat([mean, padded.masked_fill(padding, lowest).amax(dim=1)], dim=1)


class Residual(nn.Module):
    """Residual block of two normalised convolutions (He et al., 2016)."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        groups = 4 if channels % 4 == 0 else 1
        layers: list[nn.Module] = []
        for _ in range(2):
            convolution = nn.Conv3d(channels, channels, 3, padding=1)
            layers += [nn.GroupNorm(groups, channels), nn.SiLU(), convolution]
        self.body = nn.Sequential(*layers)

    def forward(self, field: Tensor) -> Tensor:
        """Return the output, of the shape of the input."""
        return field + self.body(field)


def _upsample(field: Tensor) -> Tensor:
    return functional.interpolate(field, scale_factor=2, mode="trilinear", align_corners=False)


@dataclass(frozen=True, kw_only=True)
class SurrogateOptions(NetworkOptions):
    """Predicts a normal distribution of log-modulus per voxel, relative to the best uniform one."""

    data: ClassVar[str] = "warmstart"
    width: int = option(48, "Channels of the widest layers of full resolution, even", ge=2)
    encoded: int = option(24, "Channels of an encoded press", ge=2)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.width % 2:
            raise ConfigError(f"model.width={self.width}: give an even number.")

    def __call__(self, data: SurrogateData) -> "Surrogate":
        """Return the network for some data."""
        scales = data.press_scale, data.shared_scale
        return Surrogate(*scales, cells=data.cells, frames=data.frames, **vars(self))


class Surrogate(Network):
    """Predicts a normal distribution of log-modulus per voxel, relative to the best uniform one.

    The loss is the negative log-likelihood, weighted per voxel by the (detached) deviation, so that
    the mean is not neglected where the deviation is large (Seitzer et al., 2022). Epochs are
    selected by the unweighted negative log-likelihood.

    Args:
        press_scale: Scale of each channel of a press; a buffer of the module.
        shared_scale: Scale of each channel of the object; a buffer of the module.
        cells: Cells of the input in each direction; stored with the weights.
        frames: Load steps per press location in the input; stored with the weights.
        version: Version of the input; stored with the weights.
        options: Settings, see `SurrogateOptions`.
    """

    press_scale: Tensor
    shared_scale: Tensor

    def __init__(
        self,
        press_scale: Sequence[float] = (1.0,) * len(PRESS_CHANNELS),
        shared_scale: Sequence[float] = (1.0,) * len(SHARED_CHANNELS),
        cells: int = 8,
        frames: int = 1,
        version: int = VERSION,
        **options: Any,
    ) -> None:
        if version != VERSION:
            raise ConfigError(
                f"the weights are for version {version} of the input, and this tactorch has version"
                f" {VERSION}; train again."
            )
        settings = SurrogateOptions(**options)
        super().__init__(settings)
        self.save_hyperparameters()
        self.cells, self.frames = cells, frames
        self.register_buffer("press_scale", torch.tensor(list(press_scale)))
        self.register_buffer("shared_scale", torch.tensor(list(shared_scale)))
        channels = len(PRESS_CHANNELS), len(SHARED_CHANNELS), 2
        self.network = PressUNet(*channels, settings.width, settings.encoded)

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
        return self(*batch[:3])

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
    objects = zip(predicted, truth, inside, strict=True)
    pairs = [torch.stack([a[mask], b[mask]]).double() for a, b, mask in objects]
    return torch.stack([torch.corrcoef(pair)[0, 1] for pair in pairs]).nan_to_num(0.0)


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
    """Write the weights of a checkpoint as compressed integers: about a fifteenth of its size.

    The number of bits is that of `WEIGHT_BITS`.

    Raises:
        FileError: The checkpoint is missing, damaged or of another model.
    """
    network = load_surrogate(checkpoint)
    state, scales = quantize(
        network.state_dict(),
        lambda name: WEIGHT_BITS["coarse grid" if "middle" in name else "others"],
    )
    content = {"state_dict": state, "scales": scales, "hyper_parameters": dict(network.hparams)}
    write_file(path, compress(content))
