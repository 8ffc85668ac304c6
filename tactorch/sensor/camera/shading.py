"""Light from a matt face under coloured lamps, and the response of the camera to it.

A lamp `l` with the unit direction `d` lights a face with the normal `n` in proportion to
`max(n . d, 0)` (Lambert's law) and to its proximity across the image. Light that comes from many
directions, as from diffusers and from the inside of the gel, is a quadratic form of the normal
(Ramamoorthi and Hanrahan, "An efficient representation for irradiance environment maps", 2001). The
camera mixes the colours of the light linearly and compresses them by a power.
"""

import math
from collections.abc import Sequence
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.func import jvp

from tactorch.sensor.light import COLOUR_UNIT

WHITE = 255.0  # gray value that a power of the response keeps
_MIN_LIGHT = 1e-3  # gray values, for powers
_HARMONICS = 8  # of the second order, without the constant
_PLACES = 3  # of a field that is linear over the image: constant, x, y

Pixels = Float[Tensor, "*#n 2"]  # places are those of every image of a batch
Colours = Float[Tensor, "*n 3"]
Slopes = Float[Tensor, "*n 2"]
Lit = Float[Tensor, "*n l"]


class Shading(nn.Module):
    """Gray values of pixels from the slopes of the face, differentiable in all parameters.

    Args:
        azimuths_deg: Direction of each lamp, from x (right) toward y (down), degrees.
        elevation_deg: Elevation of the lamps above the face, degrees.
        colours: Red, green and blue of each lamp on a face normal to it, gray values.
        ambient: Red, green and blue of the ambient light, gray values.
        falloff: Fraction of a lamp's light that is lost across the image.

    Attributes:
        azimuth: Azimuths, rad, (lamps,).
        elevation: Elevations, rad, (lamps,).
        colours: Colours of the lamps, (lamps, 3).
        ambient: Ambient light, (3,).
        falloff: Falloff of each lamp, (lamps,).
        diffuse: Light from all directions, (3 places, 8 harmonics, 3 colours), gray values; 0 at
            first.
        mixing: Response of each colour of the camera (row) to each colour of the light, (3, 3).
        gamma: Power of the response, (3,).
    """

    def __init__(
        self,
        azimuths_deg: Sequence[float],
        elevation_deg: float,
        colours: Sequence[Sequence[float]],
        ambient: Sequence[float] = (0.0, 0.0, 0.0),
        falloff: float = 0.0,
        dtype: torch.dtype = torch.float64,
    ) -> None:
        super().__init__()
        count = len(azimuths_deg)

        def parameter(values: Any) -> nn.Parameter:
            return nn.Parameter(torch.as_tensor(values, dtype=dtype).clone())

        self.azimuth = parameter([math.radians(azimuth) for azimuth in azimuths_deg])
        self.elevation = parameter([math.radians(elevation_deg)] * count)
        self.colours = parameter([list(colour) for colour in colours])
        self.ambient = parameter(list(ambient))
        self.falloff = parameter([falloff] * count)
        self.diffuse = parameter(torch.zeros(_PLACES, _HARMONICS, 3))
        self.mixing = parameter(torch.eye(3))
        self.gamma = parameter(torch.ones(3))

    def forward(self, slopes: Slopes, places: Pixels, lit: Lit | None = None) -> Colours:
        """Return gray values of pixels.

        Args:
            slopes: dz/dx and dz/dy of the face, z toward the object.
            places: Positions from -1 to 1 across the image along x and y.
            lit: Fraction of each lamp's light that no shadow removes; None for no shadows.
        """
        return self.respond(self.light(slopes, places, lit))

    def change(self, slopes: Slopes, places: Pixels) -> Colours:
        """Return the change of the colours from the level face, in units of 50 gray values."""
        return (self(slopes, places) - self(torch.zeros_like(slopes), places)) / COLOUR_UNIT

    def linearize(self, slopes: Slopes, places: Pixels) -> tuple[Colours, Float[Tensor, "*n 3 2"]]:
        """Return `change`, and its derivatives by both slopes."""
        derivatives = []
        for axis in torch.eye(2, dtype=slopes.dtype):
            along = (axis.expand_as(slopes),)
            changed, by_slope = jvp(lambda s: self.change(s, places), (slopes,), along)[:2]
            derivatives.append(by_slope)
        return changed, torch.stack(derivatives, dim=-1)

    def light(self, slopes: Slopes, places: Pixels, lit: Lit | None = None) -> Colours:
        """Return the light from the face before the camera's response, gray values."""
        normal = normals(slopes)
        toward = torch.stack([self.azimuth.cos(), self.azimuth.sin()])  # 2 x lamps
        direction = torch.cat([toward * self.elevation.cos(), -self.elevation.sin()[None]])
        strength = (normal @ direction).clamp_min(0.0)
        strength = strength * (1.0 - self.falloff * (1.0 - places @ toward) / 2.0)
        if lit is not None:
            strength = strength * lit
        return self.ambient + strength @ self.colours + self._diffuse(normal, places)

    def respond(self, light: Colours) -> Colours:
        """Return gray values of the camera for light, gray values."""
        mixed = light @ self.mixing.T
        return WHITE * (mixed.clamp_min(_MIN_LIGHT) / WHITE) ** self.gamma

    def _diffuse(self, normal: Float[Tensor, "*n 3"], places: Pixels) -> Colours:
        x, y, z = normal.unbind(-1)
        # Zero where the face is level, whose light is that of the lamps and the ambient light.
        second = [x * y, x * z, y * z, x * x - y * y, z * z - 1.0]
        bases = torch.stack([x, y, z + 1.0, *second], dim=-1)
        fields = bases @ self.diffuse.movedim(1, 0).flatten(1)  # of each place and colour
        constant, along_x, along_y = fields.unflatten(-1, (_PLACES, 3)).unbind(-2)
        return constant + places[..., :1] * along_x + places[..., 1:] * along_y


def normals(slopes: Slopes) -> Float[Tensor, "*n 3"]:
    """Return unit normals of the face toward the camera, which is on the side of -z."""
    toward = torch.cat([slopes, -torch.ones_like(slopes[..., :1])], dim=-1)
    return toward / torch.linalg.vector_norm(toward, dim=-1, keepdim=True)
