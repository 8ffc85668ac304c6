"""Images of the gel's face by its height: slopes, light, shadows, markers and blur, in batches."""

import math

import torch
from jaxtyping import Float
from kornia.filters import gaussian_blur2d
from kornia.geometry.transform import remap
from torch import Tensor, nn

from tactorch.sensor.camera.shading import Shading

_PENUMBRA_MM = 0.05
_MAX_SHADOW_STEPS = 60
_EDGE_PX = 0.5  # blur of a marker's edge
_MAX_EXPONENT = 40.0
_BLUR_REACH = 4.0  # of the kernel, standard deviations

Heights = Float[Tensor, "b h w"]


class GelCamera(nn.Module):
    """Camera behind the gel, differentiable in height, markers and all parameters.

    Heights are (batch, rows, columns), images (batch, 3, rows, columns) in gray values that are
    neither rounded nor limited to 0 to 255. It runs where its parameters are (`camera.to("cuda")`).

    Args:
        shading: Light and colour response.
        mm_per_px: Size of a pixel along x and y, mm.
        shadow: Fraction of a lamp's light that a shadow removes.
        blur_px: Standard deviation of the camera's blur, px; 0 for none.
        marker_diameter_mm: Diameter of the markers, mm.
        marker_darkness: Fraction of the light that a marker absorbs.

    Attributes:
        mm_per_px: Size of a pixel, a parameter, (2,).
    """

    def __init__(
        self,
        shading: Shading,
        mm_per_px: tuple[float, float],
        *,
        shadow: float = 0.0,
        blur_px: float = 0.0,
        marker_diameter_mm: float = 0.0,
        marker_darkness: float = 0.8,
    ) -> None:
        super().__init__()
        self.shading = shading
        self.mm_per_px = nn.Parameter(torch.tensor(mm_per_px, dtype=shading.ambient.dtype))
        self.shadow, self.blur_px = shadow, blur_px
        self.marker_diameter_mm, self.marker_darkness = marker_diameter_mm, marker_darkness

    def forward(
        self, height_mm: Heights, markers_px: Float[Tensor, "b n 2"] | None = None
    ) -> Float[Tensor, "b 3 h w"]:
        """Return images of faces.

        Args:
            height_mm: Height of the face, z toward the object, mm.
            markers_px: Centers of the markers (column, row); None for none.
        """
        slopes = face_slopes(height_mm, self.mm_per_px)
        lit = self._lit(height_mm) if self.shadow > 0 else None
        colours = self.shading(slopes, image_places(height_mm), lit)
        if markers_px is not None:
            radius_px = self.marker_diameter_mm / 2.0 / self.mm_per_px
            shape = height_mm.shape[1], height_mm.shape[2]
            covered = marker_coverage(markers_px, radius_px, shape)
            colours = colours * (1.0 - self.marker_darkness * covered)[..., None]
        images = colours.movedim(-1, 1)
        if self.blur_px > 0:
            size = 2 * math.ceil(_BLUR_REACH * self.blur_px) + 1
            images = gaussian_blur2d(images, size, (self.blur_px, self.blur_px), "replicate")
        return images

    def _lit(self, height_mm: Heights) -> Float[Tensor, "b h w l"]:
        lamps = zip(self.shading.azimuth, self.shading.elevation, strict=True)
        shadows = [cast_shadow(height_mm, *lamp, self.mm_per_px) for lamp in lamps]
        return 1.0 - self.shadow * torch.stack(shadows, dim=-1)


def face_slopes(height_mm: Heights, mm_per_px: Float[Tensor, "2"]) -> Float[Tensor, "b h w 2"]:
    """Return dz/dx and dz/dy by central differences, one-sided at the edges of the image."""
    by_row, by_column = torch.gradient(height_mm, dim=(-2, -1))
    return torch.stack([by_column, by_row], dim=-1) / mm_per_px


def image_places(height_mm: Float[Tensor, "*b h w"]) -> Float[Tensor, "h w 2"]:
    """Return positions from -1 to 1 across the image along x and y."""
    rows, columns = (
        torch.linspace(-1, 1, n, dtype=height_mm.dtype, device=height_mm.device)
        for n in height_mm.shape[-2:]
    )
    return torch.stack(torch.meshgrid(columns, rows, indexing="xy"), dim=-1)


def cast_shadow(
    height_mm: Heights,
    azimuth: Float[Tensor, ""],
    elevation: Float[Tensor, ""],
    mm_per_px: Float[Tensor, "2"],
) -> Heights:
    """Return the fraction of each pixel in the shadow of the face between it and a lamp.

    The face is sampled along the ray toward the lamp every two pixels, for 60 steps at most.
    """
    relief = -height_mm  # into the sensor
    rise = elevation.tan()  # of a ray per mm toward the lamp
    step = 2.0 * float(mm_per_px.detach().max())
    reach = float((relief.amax() - relief.amin()).detach() / rise.detach())
    shadow = torch.zeros_like(relief)
    rows, columns = torch.meshgrid(
        *(torch.arange(n, dtype=relief.dtype, device=relief.device) for n in relief.shape[1:]),
        indexing="ij",
    )
    across, down = azimuth.cos() / mm_per_px[0], azimuth.sin() / mm_per_px[1]
    for k in range(1, min(_MAX_SHADOW_STEPS, int(reach / step)) + 1):
        offset = k * step
        x, y = ((p + offset * s)[None] for p, s in ((columns, across), (rows, down)))
        occluder = remap(relief[:, None], x, y, padding_mode="border", align_corners=True)[:, 0]
        excess = (occluder - relief - rise * offset) / _PENUMBRA_MM
        shadow = torch.maximum(shadow, excess.clamp(0.0, 1.0))
    return shadow


def marker_coverage(
    markers_px: Float[Tensor, "b n 2"], radius_px: Float[Tensor, "2"], shape: tuple[int, int]
) -> Heights:
    """Return the fraction of each pixel that a marker covers, with blurred edges."""
    rows, columns = shape
    batch = len(markers_px)
    coverage = torch.zeros(batch, rows * columns, dtype=markers_px.dtype, device=markers_px.device)
    reach = torch.ceil(radius_px.detach() + 4 * _EDGE_PX).long().tolist()
    x, y = (torch.arange(-n, n + 1, device=markers_px.device) for n in reach)
    window = torch.stack(torch.meshgrid(x, y, indexing="xy"), dim=-1).reshape(-1, 2)
    pixels = markers_px.detach().round().long()[:, :, None] + window  # b n k 2
    distance = torch.linalg.vector_norm((pixels - markers_px[:, :, None]) / radius_px, dim=-1)
    exponent = (distance - 1.0) * radius_px.mean() / _EDGE_PX * 2
    fraction = torch.sigmoid(-exponent.clamp(-_MAX_EXPONENT, _MAX_EXPONENT))
    inside = ((pixels >= 0) & (pixels < pixels.new_tensor([columns, rows]))).all(dim=-1)
    index = torch.where(inside, pixels[..., 1] * columns + pixels[..., 0], 0).reshape(batch, -1)
    values = torch.where(inside, fraction, 0.0).reshape(batch, -1)
    return coverage.scatter_reduce(1, index, values, "amax").reshape(batch, rows, columns)
