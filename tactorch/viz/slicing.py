"""Plane slices through a mesh on square pixels, their colour scale and outlines of inclusions."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Float, Int
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.image import AxesImage
from scipy.ndimage import gaussian_filter

from tactorch.errors import ConfigError
from tactorch.mesh import TetMesh, locate
from tactorch.metrics.segment import weighted_median

AXES = "xyz"
#: Axes along the horizontal and the vertical of a picture, for slices across x, y and z.
IN_PLANE = ((1, 2), (0, 2), (0, 1))
# Planes through the nodes of a regular mesh would show elements of both sides alternately; an
# offset by this fraction of the diagonal selects one side.
_NUDGE = 1e-6
# Elements above this multiple of the 99.5th percentile do not extend the colour scale.
_OUTLIER_FACTOR = 4.0
# Contour level, as a fraction of the largest departure of the logarithm from the background.
OUTLINE_LEVEL = 0.4
# Elements below this fraction are background.
_BACKGROUND_LEVEL = 0.1
# Width of the smoothing of outlines, as a fraction of the element size.
_BLUR = 0.4
#: Colour, width and style of outlines: white dashes over a black line are visible on any colour.
OUTLINE_STYLES: tuple[tuple[str, float, Literal["-", "--"]], ...] = (
    ("black", 1.8, "-"),
    ("white", 1.1, "--"),
)


@dataclass(frozen=True, eq=False)
class Slice:
    """Slice by the plane at a position along an axis (0, 1 or 2).

    `elements` are the tetrahedra under the pixels, -1 outside; row 0 is the lowest. The extent is
    left, right, bottom and top of the picture.
    """

    axis: int
    position_mm: float
    elements: Int[np.ndarray, "rows columns"]
    extent_mm: tuple[float, float, float, float]

    def values(self, per_element: Float[np.ndarray, " m"]) -> Float[np.ma.MaskedArray, "r c"]:
        """Return the value of each pixel; pixels outside the body are masked."""
        return np.ma.masked_where(self.elements < 0, per_element[self.elements])

    def centres_mm(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the pixel centres along the horizontal and the vertical, mm."""
        rows, columns = self.elements.shape
        left, right, bottom, top = self.extent_mm
        return _centres(left, right, columns), _centres(bottom, top, rows)

    def draw(self, axes: Axes, per_element: Float[np.ndarray, " m"], **options: Any) -> AxesImage:
        """Draw the value of each element with `imshow` and its options."""
        return axes.imshow(
            self.values(per_element), extent=self.extent_mm, origin="lower",
            interpolation="nearest", **options,
        )  # fmt: skip


def slice_body(mesh: TetMesh, n_slices: int, pixels: int) -> list[list[Slice]]:
    """Cut a mesh by `even_planes` across x, y and z; see `cut`."""
    planes = [plane for axis in range(3) for plane in even_planes(mesh, axis, n_slices)]
    slices = cut(mesh, planes, pixels)
    return [slices[axis * n_slices : (axis + 1) * n_slices] for axis in range(3)]


def slices_at(mesh: TetMesh, point_mm: Float[np.ndarray, "3"], pixels: int) -> list[Slice]:
    """Cut a mesh through a point by planes across x, y and z; see `cut`.

    A plane on the surface is moved into the body by one pixel.
    """
    low, high = mesh.bounds
    pixel = float((high - low).max()) / pixels
    return cut(mesh, list(enumerate(np.clip(point_mm, low + pixel, high - pixel))), pixels)


def even_planes(mesh: TetMesh, axis: int, count: int = 1) -> list[tuple[int, float]]:
    """Return planes in the middle of `count` equal slabs, so that none is on the surface."""
    low, high = mesh.bounds[:, axis]
    return [(axis, position) for position in _centres(low, high, count)]


def cut(mesh: TetMesh, planes: Sequence[tuple[int, float]], pixels: int) -> list[Slice]:
    """Cut a mesh by planes, each given by its normal axis and its position along it, mm.

    The longest side of the bounding box has `pixels` pixels.
    """
    low, high = mesh.bounds
    counts = [int(np.ceil(part * pixels - 1e-9)) for part in (high - low) / (high - low).max()]
    centres = [_centres(low[a], high[a], counts[a]) for a in range(3)]
    grids = []
    for axis, position in planes:
        across, up = IN_PLANE[axis]
        points = np.empty((counts[up], counts[across], 3))
        points[..., axis] = position + _NUDGE * mesh.diagonal
        points[..., across] = centres[across]
        points[..., up] = centres[up][:, None]
        grids.append(points)
    elements = locate(mesh, np.concatenate([points.reshape(-1, 3) for points in grids]))
    parts = np.split(elements, np.cumsum([points[..., 0].size for points in grids])[:-1])
    slices = []
    for (axis, position), points, part in zip(planes, grids, parts, strict=True):
        (left, bottom), (right, top) = mesh.bounds[:, IN_PLANE[axis]].tolist()
        shape = points.shape[:2]
        slices.append(Slice(axis, float(position), part.reshape(shape), (left, right, bottom, top)))
    return slices


def _centres(low: float, high: float, count: int) -> np.ndarray:
    """Return the midpoints of `count` equal parts of an interval."""
    return low + (np.arange(count) + 0.5) * ((high - low) / count)


def colour_scale(
    maps: dict[str, np.ndarray], scale: str, limits: tuple[float, float] | None
) -> Normalize:
    """Return a colour scale, "linear" or "log", of a "reconstruction" and, if known, its "truth".

    Limits, MPa, are computed from the values if None.
    """
    if scale not in ("linear", "log"):
        raise ConfigError(f"scale '{scale}' is not known; choose linear or log.")
    low, high = limits if limits is not None else _limits(maps, scale)
    if not low < high:
        raise ConfigError(f"limits_mpa ({low}, {high}): the first must be less than the second.")
    if scale == "linear":
        return Normalize(low, high)
    if low <= 0:
        raise ConfigError(f"scale 'log' needs moduli above zero, but the lowest is {low} MPa.")
    return LogNorm(low, high)


def _limits(maps: dict[str, np.ndarray], scale: str) -> tuple[float, float]:
    """Return the range of the truth and of nearly all of the reconstruction."""
    values = maps["reconstruction"]
    lower, upper = (float(v) for v in np.percentile(values, (0.5, 99.5)))
    if "truth" in maps:
        high = max(upper, float(maps["truth"].max()))
        low = min(lower, float(maps["truth"].min()))
    else:
        high = min(float(values.max()), _OUTLIER_FACTOR * upper)
        low = float(values.min())
        low = max(low, lower / _OUTLIER_FACTOR) if low > 0 else low
    if scale == "linear":
        low = min(low, 0.0)
    return (low, high) if high > low else (0.5 * low, 1.5 * low or 1.0)


def departure_from_background(
    mesh: TetMesh, truth: Float[np.ndarray, " m"]
) -> Float[np.ndarray, " m"] | None:
    """Return the departure of the logarithm from the background, relative to the largest, (m,).

    None if the truth is uniform or varies everywhere. Inclusions are above `OUTLINE_LEVEL`.
    """
    background = weighted_median(truth, mesh.volumes)
    floor = 1e-6 * max(float(np.abs(truth).max()), 1e-300)
    departure = np.abs(np.log(np.maximum(truth, floor) / max(background, floor)))
    largest = float(departure.max())
    background_volume = float(mesh.volumes[departure < _BACKGROUND_LEVEL * largest].sum())
    if largest <= 1e-9 or background_volume < 0.5 * float(mesh.volumes.sum()):
        return None
    return departure / largest


def draw_outline(axes: Axes, mesh: TetMesh, piece: Slice, departure: np.ndarray) -> None:
    """Draw the outline of inclusions in a slice; see `departure_from_background`."""
    across, up = piece.centres_mm()
    left, right, _, _ = piece.extent_mm
    blur_mm = _BLUR * float(np.cbrt(6.0 * mesh.volumes.mean()))
    shown = _blurred(piece.values(departure), blur_mm * len(across) / (right - left))
    # contour() needs two pixels in each direction and warns about levels out of range.
    if min(shown.shape) < 2 or shown.count() == 0:
        return
    if not float(shown.min()) < OUTLINE_LEVEL < float(shown.max()):
        return
    for colour, width, style in OUTLINE_STYLES:
        axes.contour(
            across, up, shown, levels=[OUTLINE_LEVEL], colors=colour, linewidths=width,
            linestyles=style,
        )  # fmt: skip


def _blurred(values: np.ma.MaskedArray, sigma: float) -> np.ma.MaskedArray:
    """Smooth over `sigma` pixels within the body."""
    inside = gaussian_filter((~values.mask).astype(float), sigma)
    smooth = gaussian_filter(values.filled(0.0), sigma) / np.maximum(inside, 1e-12)
    return np.ma.masked_array(smooth, values.mask)
