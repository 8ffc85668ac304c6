"""Lens distortion, warp and crop of a sensor's camera, differentiable in their parameters.

The lens model is that of OpenCV (Brown, "Close-range camera calibration", 1971, with rational and
thin-prism terms), the warp a homography. Both are composed to one map from rectified to raw pixels,
so that an image is interpolated once.
"""

import torch
from jaxtyping import Float
from kornia.geometry.calibration import distort_points, undistort_points
from kornia.geometry.linalg import transform_points
from kornia.geometry.transform import get_perspective_transform, remap
from torch import Tensor, nn

from tactorch.errors import ConfigError
from tactorch.sensor.description import SensorDescription

_UNDISTORTION_STEPS = 20  # of the fixed-point iteration

Positions = Float[Tensor, "*n 2"]


class Lens(nn.Module):
    """Camera geometry of a sensor.

    Positions are (column, row) in pixels, with integers at the centers of pixels. Images are
    (batch, channels, rows, columns).

    Args:
        sensor: Sensor description, with its lens, warp and crop.
        dtype: Type of the parameters.

    Attributes:
        intrinsics: fx, fy, cx, cy of the raw image, (4,), px; None without correction of the lens.
        distortion: Coefficients in OpenCV's order, (4, 5, 8, 12 or 14,).
        corners: Points of the undistorted raw image that become the corners of the warped image,
            (4, 2), px; None without a warp.
    """

    _ends: Tensor
    _left_top: Tensor

    def __init__(self, sensor: SensorDescription, dtype: torch.dtype = torch.float64) -> None:
        super().__init__()
        self._shape = sensor.shape
        width, height = sensor.raw_size_px or sensor.image_size_px
        self._raw_shape = height, width
        self.intrinsics: nn.Parameter | None = None
        self.corners: nn.Parameter | None = None
        coefficients = sensor.distortion or (0.0,) * 4
        self.distortion = nn.Parameter(torch.tensor(coefficients, dtype=dtype))
        if sensor.intrinsics_px is not None:
            self.intrinsics = nn.Parameter(torch.tensor(sensor.intrinsics_px, dtype=dtype))
        if sensor.warp_corners_px is not None:
            self.corners = nn.Parameter(torch.tensor(sensor.warp_corners_px, dtype=dtype))
        width, height = sensor.warped_size
        ends = [(0, 0), (width - 1, 0), (width - 1, height - 1), (0, height - 1)]
        self.register_buffer("_ends", torch.tensor(ends, dtype=dtype))
        left_top = (0, 0) if sensor.crop_px is None else sensor.crop_px[:2]
        self.register_buffer("_left_top", torch.tensor(left_top, dtype=dtype))

    def forward(self, images: Float[Tensor, "b c rows columns"]) -> Float[Tensor, "b c h w"]:
        """Return rectified images of raw ones, by bicubic interpolation; 0 outside of these.

        Raises:
            ConfigError: The images have another size than the sensor's raw images.
        """
        if tuple(images.shape[-2:]) != self._raw_shape:
            raise ConfigError(
                f"images are {images.shape[-1]} x {images.shape[-2]} px, but raw images of the"
                f" sensor {self._raw_shape[1]} x {self._raw_shape[0]}."
            )
        return self._sample(images, self.maps())

    def distort(self, images: Float[Tensor, "b c h w"]) -> Float[Tensor, "b c rows columns"]:
        """Return raw images, as the camera takes them, of rectified ones; 0 outside of these."""
        return self._sample(images, self.rectified_positions(self._grid(self._raw_shape)))

    def maps(self) -> Float[Tensor, "h w 2"]:
        """Return the position in the raw image of each pixel of the rectified image."""
        return self.raw_positions(self._grid(self._shape))

    def raw_positions(self, rectified: Positions) -> Positions:
        """Return positions in the raw image of positions in the rectified one."""
        points = (rectified + self._left_top).reshape(-1, 2)
        if self.corners is not None:
            warp = get_perspective_transform(self._ends[None], self.corners[None])
            points = transform_points(warp, points[None])[0]
        if self.intrinsics is not None:
            points = distort_points(points[None], self._matrix(), self.distortion[None])[0]
        return points.reshape(rectified.shape)

    def rectified_positions(self, raw: Positions) -> Positions:
        """Return positions in the rectified image of positions in the raw one."""
        points = raw.reshape(-1, 2)
        if self.intrinsics is not None:
            points = undistort_points(
                points[None], self._matrix(), self.distortion[None], num_iters=_UNDISTORTION_STEPS
            )[0]
        if self.corners is not None:
            warp = get_perspective_transform(self.corners[None], self._ends[None])
            points = transform_points(warp, points[None])[0]
        return (points - self._left_top).reshape(raw.shape)

    def _matrix(self) -> Float[Tensor, "1 3 3"]:
        assert self.intrinsics is not None
        fx, fy, cx, cy = self.intrinsics
        zero, one = torch.zeros_like(fx), torch.ones_like(fx)
        rows = [torch.stack(row) for row in ((fx, zero, cx), (zero, fy, cy), (zero, zero, one))]
        return torch.stack(rows)[None]

    def _grid(self, shape: tuple[int, int]) -> Float[Tensor, "h w 2"]:
        rows, columns = (
            torch.arange(n, dtype=self._ends.dtype, device=self._ends.device) for n in shape
        )
        return torch.stack(torch.meshgrid(columns, rows, indexing="xy"), dim=-1)

    def _sample(self, images: Tensor, positions: Float[Tensor, "h w 2"]) -> Tensor:
        x, y = (p.to(images.dtype).expand(len(images), -1, -1) for p in positions.unbind(-1))
        return remap(images, x, y, mode="bicubic", align_corners=True)
