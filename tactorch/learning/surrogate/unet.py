"""3-D U-Net (Ronneberger et al., 2015) with a shared encoder of the presses."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn import functional

from tactorch.errors import ConfigError

_LAST = torch.channels_last_3d


class PressUNet(nn.Module):
    """Maps fields of the presses and the object to fields on a grid twice as fine.

    Presses are encoded one by one with the same weights and pooled by mean and maximum (Zaheer et
    al., 2017), so their number and order do not matter.

    Layers of full resolution have up to `width` channels, an encoded press has `encoded`.
    """

    def __init__(
        self,
        press_channels: int,
        shared_channels: int,
        out_channels: int,
        width: int = 48,
        encoded: int = 24,
    ) -> None:
        super().__init__()
        if min(width, encoded) < 2 or width % 2:
            raise ConfigError(
                f"width={width} must be even, and width and encoded={encoded} at least 2."
            )
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
        fine = _upsample(self.refine(wide))
        return self.last(torch.cat([fine, _upsample(shared)], dim=1))

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
