"""A frame beside the forces over the gel's face."""

import numpy as np
from jaxtyping import Float, Int
from matplotlib.figure import Figure
from matplotlib.tri import Triangulation

from tactorch.sensor.description import SensorDescription
from tactorch.sensor.frames import Image
from tactorch.viz.sensor_frame import EDGE, blank, extent_of, frame_figure, image_axes, settle

_KPA = 1e3  # of an MPa
_LEAST_SHEAR = 0.04  # of the longest arrow: shorter ones are not drawn


class ForceView:
    """A frame, and traction over the gel's face: pressure as colour, shear as arrows.

    Args:
        sensor: The sensor.
        points: Nodes of the gel's face at rest, mm.
        triangles: Between these nodes.
        largest_mpa: Upper end of the colours, and shear of the longest arrow.
    """

    def __init__(
        self,
        sensor: SensorDescription,
        points: Float[np.ndarray, "k 3"],
        triangles: Int[np.ndarray, "t 3"],
        largest_mpa: tuple[float, float],
    ) -> None:
        self.sensor = sensor
        self._area = node_areas(points, triangles)
        pressure = _KPA * largest_mpa[0]
        self.figure: Figure = frame_figure(sensor, 2, 5.0)
        axes = self.figure.subplots(1, 2)
        extent = extent_of(sensor)
        self._image = image_axes(axes[0], sensor)
        x, y = points[:, 0], points[:, 1]
        self._mesh = axes[1].tripcolor(
            Triangulation(x, y, triangles), np.zeros(len(points)), shading="gouraud",
            cmap="cividis", vmin=0.0, vmax=pressure,
        )  # fmt: skip
        # The longest arrow is as long as three cells.
        cell = float(np.sqrt(self._area.mean()))
        self._longest = _KPA * largest_mpa[1]
        none = np.zeros(len(points))
        self._arrows = axes[1].quiver(
            x, y, none, none, angles="xy", scale_units="xy", scale=self._longest / (3.0 * cell),
            color="white", edgecolor=EDGE, linewidth=0.5, width=0.005, zorder=3,
        )  # fmt: skip
        axes[1].quiverkey(
            self._arrows, 0.86, 1.03, self._longest, f"shear {self._longest:.3g} kPa",
            labelpos="W", fontproperties={"size": 9},
        )  # fmt: skip
        axes[1].set(
            xlabel="x, mm", aspect="equal", xlim=extent[:2], ylim=extent[2:], facecolor="0.85"
        )
        self._title = axes[0].set_title("frame\n ", fontsize=10, loc="left")
        bar = self.figure.colorbar(self._mesh, ax=axes[1], extend="both", pad=0.02)
        bar.set_label("pressure, kPa")
        settle(self.figure)

    def show(
        self, image: Image | None, forces: Float[np.ndarray, "k 3"] | None, caption: str
    ) -> None:
        """Draw a frame; without forces (on the gel, N) the face is blank."""
        self._image.set_data(blank(self.sensor) if image is None else image)
        traction = np.zeros((len(self._area), 3)) if forces is None else forces
        traction = _KPA * np.nan_to_num(traction) / self._area[:, None]
        self._mesh.set_array(-traction[:, 2])
        weak = np.linalg.norm(traction[:, :2], axis=1) < _LEAST_SHEAR * self._longest
        shear = np.ma.masked_array(traction[:, :2], np.repeat(weak[:, None], 2, axis=1))
        self._arrows.set_UVC(shear[:, 0], shear[:, 1])
        self._title.set_text(caption)


def node_areas(
    points: Float[np.ndarray, "k 3"], triangles: Int[np.ndarray, "t 3"]
) -> Float[np.ndarray, " k"]:
    """Return the area that belongs to each node: a third of the triangles around it, mm^2."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return np.bincount(triangles.ravel(), np.repeat(area / 3.0, 3), len(points))
