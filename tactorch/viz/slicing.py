"""Plane slices through a mesh on square pixels, their colour scale and outlines of inclusions."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Float, Int
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.ticker import MaxNLocator
from scipy.ndimage import gaussian_filter

from tactorch.errors import ConfigError, TactorchError
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
class Plane:
    """Pixels of a plane slice at a position along an axis (0, 1 or 2).

    `points` are the centres of the pixels, mm; row 0 is the lowest. The extent is left, right,
    bottom and top of the picture.
    """

    axis: int
    position_mm: float
    points: Float[np.ndarray, "rows columns 3"]
    extent_mm: tuple[float, float, float, float]

    @classmethod
    def through(
        cls, bounds_mm: Float[np.ndarray, "2 3"], axis: int, position_mm: float, pixels: int
    ) -> "Plane":
        """Return a slice of a box, whose longest side has so many pixels."""
        (left, bottom), (right, top) = bounds_mm[:, IN_PLANE[axis]].tolist()
        pixel = float(np.ptp(bounds_mm, axis=0).max()) / pixels
        columns, rows = (int(np.ceil(size / pixel - 1e-9)) for size in (right - left, top - bottom))
        points = np.full((rows, columns, 3), position_mm)
        points[..., IN_PLANE[axis][0]] = _centres(left, right, columns)
        points[..., IN_PLANE[axis][1]] = _centres(bottom, top, rows)[:, None]
        return cls(axis, float(position_mm), points, (left, right, bottom, top))

    def centres_mm(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the pixel centres along the horizontal and the vertical, mm."""
        across, up = IN_PLANE[self.axis]
        return self.points[0, :, across], self.points[:, 0, up]

    def show(self, axes: Axes, pixels: Float[np.ndarray, "rows columns"], **options: Any) -> None:
        """Draw the value of each pixel with `imshow` and its options."""
        axes.imshow(
            pixels, extent=self.extent_mm, origin="lower", interpolation="nearest", **options
        )

    def label(
        self,
        axes: Axes,
        name: str = "",
        *,
        left: bool = True,
        top: bool = True,
        bottom: bool = True,
        fontsize: int = 9,
    ) -> None:
        """Label a panel at some of its sides: the name of the map, the position and the axes."""
        across, up = (AXES[a] for a in IN_PLANE[self.axis])
        axes.tick_params(labelsize=fontsize - 1, labelbottom=bottom, labelleft=left)
        axes.xaxis.set_major_locator(MaxNLocator(4))
        axes.yaxis.set_major_locator(MaxNLocator(4))
        if top:
            position = round(self.position_mm, 6) + 0.0  # no -0, no 1e-16
            axes.set_title(f"{AXES[self.axis]} = {position:.3g} mm", fontsize=fontsize)
        if bottom:
            axes.set_xlabel(f"{across} (mm)", fontsize=fontsize)
        if left:
            axes.set_ylabel(f"{name}\n{up} (mm)" if name else f"{up} (mm)", fontsize=fontsize)


@dataclass(frozen=True, eq=False)
class Slice(Plane):
    """Slice of a mesh. `elements` are the tetrahedra under the pixels, -1 outside."""

    elements: Int[np.ndarray, "rows columns"]

    def values(self, per_element: Float[np.ndarray, " m"]) -> Float[np.ma.MaskedArray, "r c"]:
        """Return the value of each pixel; pixels outside the body are masked."""
        return np.ma.masked_where(self.elements < 0, per_element[self.elements])

    def draw(self, axes: Axes, per_element: Float[np.ndarray, " m"], **options: Any) -> None:
        """Draw the value of each element; see `show`."""
        self.show(axes, self.values(per_element), **options)


def slice_body(mesh: TetMesh, n_slices: int, pixels: int) -> list[list[Slice]]:
    """Cut a mesh by `even_planes` across x, y and z; see `cut`."""
    return [cut(mesh, even_planes(mesh, axis, n_slices), pixels) for axis in range(3)]


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
    offsets = _NUDGE * mesh.diagonal * np.eye(3)
    cuts = [Plane.through(mesh.bounds, axis, position, pixels) for axis, position in planes]
    points = [(plane.points + offsets[plane.axis]).reshape(-1, 3) for plane in cuts]
    elements = locate(mesh, np.concatenate(points))
    parts = np.split(elements, np.cumsum([len(part) for part in points])[:-1])
    return [
        Slice(**vars(plane), elements=part.reshape(plane.points.shape[:2]))
        for plane, part in zip(cuts, parts, strict=True)
    ]


def _centres(low: float, high: float, count: int) -> np.ndarray:
    """Return the midpoints of `count` equal parts of an interval."""
    return low + (np.arange(count) + 0.5) * ((high - low) / count)


def check_values(name: str, values: np.ndarray, mesh: TetMesh) -> None:
    """Refuse values other than one finite number for each element."""
    count = mesh.n_tets
    if values.shape != (count,):
        raise TactorchError(
            f"{name}: shape {values.shape} for a mesh of {count} tetrahedra; "
            f"give one modulus (MPa) per tetrahedron, shape ({count},)."
        )
    invalid = np.flatnonzero(~np.isfinite(values))
    if len(invalid):
        raise TactorchError(
            f"{name}: {len(invalid)} of {count} values are not finite, the first at element "
            f"{invalid[0]}; a map needs a number everywhere."
        )


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
