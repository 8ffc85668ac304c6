"""Figure of the surface of a mesh."""

import numpy as np
from jaxtyping import Float
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from tactorch.errors import ConfigError
from tactorch.mesh import TetMesh
from tactorch.viz.figure import new_figure

_LIGHT = np.array([0.4, -0.5, 0.77])


def surface_figure(
    mesh: TetMesh, *, values: Float[np.ndarray, " m"] | None = None, label: str = ""
) -> Figure:
    """Return a figure of the surface of a mesh, seen from a corner.

    Args:
        mesh: The mesh.
        values: Value of each element, shown as colour; by default the region, if there are any.
        label: Label of the values.

    Raises:
        ConfigError: there is not one value for each element.
    """
    if values is None and mesh.regions is not None:
        values, label = mesh.regions.astype(float), label or "region"
    if values is not None and len(values) != mesh.n_tets:
        raise ConfigError(f"values: {len(values)} for {mesh.n_tets} elements; give one each.")
    surface, figure = mesh.surface, new_figure(5.0, 4.2)
    axes: Axes3D = figure.add_subplot(projection="3d")
    faces = Poly3DCollection(mesh.points[surface.triangles], linewidths=0.25, edgecolors="0.3")
    shade = 0.55 + 0.45 * np.clip(surface.normals @ _LIGHT, 0.0, 1.0)
    colours = np.full((len(shade), 4), (0.72, 0.78, 0.85, 1.0))
    if values is not None:
        norm = Normalize(float(values.min()), float(values.max()))
        scale = ScalarMappable(norm, "viridis")
        colours = scale.to_rgba(values[surface.owners])
        figure.colorbar(scale, ax=axes, label=label, shrink=0.7, pad=0.12)
    colours[:, :3] *= shade[:, None]
    faces.set_facecolor(colours)
    axes.add_collection3d(faces)
    low, high = mesh.bounds
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(tuple(high - low))
    axes.set(xlabel="x (mm)", ylabel="y (mm)", zlabel="z (mm)")
    return figure
