"""Where the true inclusions are: a dashed line upon the map."""

from typing import Literal

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from scipy.ndimage import gaussian_filter

from tactorch.mesh import TetMesh
from tactorch.viz.sampling import Slice

# The line runs where the truth's logarithm departs from the background by this share of its
# largest departure; within the second share the truth counts as background.
_LEVEL = 0.4
_PLAIN = 0.1
# Steps of single elements are smoothed away over this share of an element's size.
_BLUR = 0.4
# Black below white dashes: seen on any colour.
_LINES: tuple[tuple[str, float, Literal["-", "--"]], ...] = (
    ("black", 1.8, "-"),
    ("white", 1.1, "--"),
)


class Outline:
    """The outline of a truth's inclusions.

    Attributes:
        departure: How far each element departs from the background, 0 to 1 (m,).
    """

    def __init__(self, mesh: TetMesh, departure: Float[np.ndarray, " m"]) -> None:
        self.departure = departure
        self._blur_mm = _BLUR * float(np.cbrt(6.0 * mesh.volumes.mean()))

    @classmethod
    def of(cls, mesh: TetMesh, truth: Float[np.ndarray, " m"]) -> "Outline | None":
        """Return the outline, or None for a truth that is uniform or varies everywhere."""
        departure = _departure(mesh, truth)
        return None if departure is None else cls(mesh, departure)

    @property
    def inside(self) -> Bool[np.ndarray, " m"]:
        """The elements within the outline, (m,)."""
        return self.departure > _LEVEL

    def draw(self, axes: Axes, piece: Slice) -> None:
        """Draw the outline in one slice, where it has any."""
        across, up = piece.centres_mm()
        left, right, _, _ = piece.extent_mm
        sigma = self._blur_mm * len(across) / (right - left)
        shown = _blurred(piece.values(self.departure), sigma)
        # contour() needs two pixels each way, and warns of levels that do not occur.
        if min(shown.shape) < 2 or shown.count() == 0:
            return
        if not float(shown.min()) < _LEVEL < float(shown.max()):
            return
        for colour, width, style in _LINES:
            axes.contour(
                across,
                up,
                shown,
                levels=[_LEVEL],
                colors=colour,
                linewidths=width,
                linestyles=style,
            )

    @staticmethod
    def handle() -> tuple[Line2D, ...]:
        """Return what stands for the outline in a legend."""
        return tuple(Line2D([], [], color=c, linewidth=w, linestyle=s) for c, w, s in _LINES)


def _departure(mesh: TetMesh, truth: np.ndarray) -> np.ndarray | None:
    """Return how far the truth departs from its background, 0 to 1.

    None where there is no background: a uniform truth, or one that varies everywhere.
    """
    order = np.argsort(truth)  # the background is the median by volume
    run = np.cumsum(mesh.volumes[order])
    background = truth[order[np.searchsorted(run, 0.5 * run[-1])]]
    floor = 1e-6 * max(float(np.abs(truth).max()), 1e-300)
    departure = np.abs(np.log(np.maximum(truth, floor) / max(float(background), floor)))
    largest = float(departure.max())
    plain = float(mesh.volumes[departure < _PLAIN * largest].sum())
    if largest <= 1e-9 or plain < 0.5 * float(mesh.volumes.sum()):
        return None
    return departure / largest


def _blurred(values: np.ma.MaskedArray, sigma: float) -> np.ma.MaskedArray:
    """Smooth over `sigma` pixels, inside the body only."""
    inside = gaussian_filter((~values.mask).astype(float), sigma)
    smooth = gaussian_filter(values.filled(0.0), sigma) / np.maximum(inside, 1e-12)
    return np.ma.masked_array(smooth, values.mask)
