"""Outline of the true inclusions, a dashed line over the map."""

from typing import Literal

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from scipy.ndimage import gaussian_filter

from tactorch.mesh import TetMesh
from tactorch.metrics.segment import weighted_median
from tactorch.viz.slicing import Slice

# Contour level, as a fraction of the largest departure of the logarithm from the background.
_LEVEL = 0.4
# Elements below this fraction are background.
_BACKGROUND_LEVEL = 0.1
# Width of the smoothing, as a fraction of the element size.
_BLUR = 0.4
# White dashes over a black line are visible on any colour.
_LINES: tuple[tuple[str, float, Literal["-", "--"]], ...] = (
    ("black", 1.8, "-"),
    ("white", 1.1, "--"),
)


class Outline:
    """Outline of the inclusions of a true map.

    Attributes:
        departure: Relative departure of each element from the background, 0 to 1 (m,).
    """

    def __init__(self, mesh: TetMesh, departure: Float[np.ndarray, " m"]) -> None:
        self.departure = departure
        self._blur_mm = _BLUR * float(np.cbrt(6.0 * mesh.volumes.mean()))

    @classmethod
    def of(cls, mesh: TetMesh, truth: Float[np.ndarray, " m"]) -> "Outline | None":
        """Return the outline, or None if the truth is uniform or varies everywhere."""
        departure = _departure(mesh, truth)
        return None if departure is None else cls(mesh, departure)

    @property
    def inside(self) -> Bool[np.ndarray, " m"]:
        """Elements within the outline, (m,)."""
        return self.departure > _LEVEL

    def draw(self, axes: Axes, piece: Slice) -> None:
        """Draw the outline in one slice."""
        across, up = piece.centres_mm()
        left, right, _, _ = piece.extent_mm
        sigma = self._blur_mm * len(across) / (right - left)
        shown = _blurred(piece.values(self.departure), sigma)
        # contour() needs two pixels in each direction and warns about levels out of range.
        if min(shown.shape) < 2 or shown.count() == 0:
            return
        if not float(shown.min()) < _LEVEL < float(shown.max()):
            return
        for colour, width, style in _LINES:
            axes.contour(
                across, up, shown, levels=[_LEVEL], colors=colour, linewidths=width,
                linestyles=style,
            )  # fmt: skip

    @staticmethod
    def handle() -> tuple[Line2D, ...]:
        """Return the legend handle of an outline."""
        return tuple(Line2D([], [], color=c, linewidth=w, linestyle=s) for c, w, s in _LINES)


def _departure(mesh: TetMesh, truth: np.ndarray) -> np.ndarray | None:
    """Return the relative departure from the background, 0 to 1, or None without a background."""
    background = weighted_median(truth, mesh.volumes)
    floor = 1e-6 * max(float(np.abs(truth).max()), 1e-300)
    departure = np.abs(np.log(np.maximum(truth, floor) / max(background, floor)))
    largest = float(departure.max())
    background_volume = float(mesh.volumes[departure < _BACKGROUND_LEVEL * largest].sum())
    if largest <= 1e-9 or background_volume < 0.5 * float(mesh.volumes.sum()):
        return None
    return departure / largest


def _blurred(values: np.ma.MaskedArray, sigma: float) -> np.ma.MaskedArray:
    """Smooth over `sigma` pixels within the body."""
    inside = gaussian_filter((~values.mask).astype(float), sigma)
    smooth = gaussian_filter(values.filled(0.0), sigma) / np.maximum(inside, 1e-12)
    return np.ma.masked_array(smooth, values.mask)
