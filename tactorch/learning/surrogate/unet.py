"""A 3-D U-Net (Ronneberger et al., 2015) behind an encoder that any number of presses share."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn import functional

from tactorch.errors import ConfigError

_LAST = torch.channels_last_3d


class PressUNet(nn.Module):
    """From fields of presses and of the object on a grid to fields on one twice as fine.

    Presses are encoded one by one with the same weights and pooled by mean and maximum (Zaheer et
    al., 2017), so their number and order do not matter.

    Args:
        press_channels: Of each press.
        shared_channels: Of the object.
        out_channels: Of the result.
        width: Channels of the widest full-size layers.
        encoded: Channels of an encoded press.
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
            raise ConfigError(f"width={width} must be even, and width and encoded={encoded} 2 up.")
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
        there: Bool[Tensor, "b k"],
        shared: Float[Tensor, "b s v v v"],
    ) -> Float[Tensor, "b out w w w"]:
        """Return the fields; `there` marks presses, as opposed to padding."""
        joined = torch.cat([self._pooled(presses, there, shared), shared], dim=1)
        wide = self.enter(joined.contiguous(memory_format=_LAST))
        wide = self.first(wide)
        deep = self.middle(self.down(wide))
        back = self.up(functional.interpolate(deep, size=wide.shape[2:], mode="nearest"))
        wide = self.second(self.join(torch.cat([wide, back], dim=1)))
        fine = _finer(self.refine(wide))
        return self.last(torch.cat([fine, _finer(shared)], dim=1))

    def _pooled(self, presses: Tensor, there: Tensor, shared: Tensor) -> Tensor:
        places = there.nonzero(as_tuple=True)
        joined = torch.cat([presses[places], shared[places[0]]], dim=1)
        codes = self.encoder(joined.contiguous(memory_format=_LAST))
        spread = codes.new_zeros((*there.shape, *codes.shape[1:]))
        spread[places] = codes
        mean = spread.sum(dim=1) / there.sum(dim=1)[:, None, None, None, None]
        lowest = torch.finfo(spread.dtype).min
        away = ~there[:, :, None, None, None, None]
        return torch.cat([mean, spread.masked_fill(away, lowest).amax(dim=1)], dim=1)


class Residual(nn.Module):
    """Two normalised convolutions and the identity (He et al., 2016).

    Args:
        channels: In and out.
    """

    def __init__(self, channels: int) -> None:
        super().__init__()
        groups = 4 if channels % 4 == 0 else 1
        self.body = nn.Sequential(
            nn.GroupNorm(groups, channels),
            nn.SiLU(),
            nn.Conv3d(channels, channels, 3, padding=1),
            nn.GroupNorm(groups, channels),
            nn.SiLU(),
            nn.Conv3d(channels, channels, 3, padding=1),
        )

    def forward(self, field: Tensor) -> Tensor:
        """Return the field, changed."""
        return field + self.body(field)


def _finer(field: Tensor) -> Tensor:
    return functional.interpolate(field, scale_factor=2, mode="trilinear", align_corners=False)
