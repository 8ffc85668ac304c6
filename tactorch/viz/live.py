"""Figure of a live run: the map through the inclusion, and the position of the next press."""

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from tactorch.mesh import TetMesh
from tactorch.viz.contact import contact_patches
from tactorch.viz.figure import CONTACT, MODULUS_LABEL, new_figure
from tactorch.viz.slices import draw_body, draw_contact
from tactorch.viz.slicing import AXES, IN_PLANE, Slice, colour_scale, slices_at

_PIXELS = 90
_NEXT, _CENTRE = "#CC3399", "white"
_ARROW = 0.2  # length of the arrow, as a fraction of the longest side


def live_figure(
    mesh: TetMesh,
    youngs: Float[np.ndarray, " m"],
    *,
    pressed: Float[np.ndarray, "n 3"],
    inclusion_mm: Float[np.ndarray, "3"] | None = None,
    next_mm: Float[np.ndarray, "3"] | None = None,
    inward: Float[np.ndarray, "3"] | None = None,
    radius_mm: float = 0.0,
    title: str = "",
) -> Figure:
    """Return a figure of three slices through the inclusion, and three through the next press.

    Args:
        mesh: Mesh of the body, mm.
        youngs: Young's modulus of each element, MPa (m,).
        pressed: External force on each node, N (n, 3), summed over presses.
        inclusion_mm: Centre of the inclusion, mm; the centre of the body if None.
        next_mm: Position of the next press, mm; the second row is omitted if None.
        inward: Unit vector of the next press, (3,).
        radius_mm: Radius of the sensor, mm.
        title: Title of the figure.
    """
    name = "the middle of the object" if inclusion_mm is None else "the inclusion"
    rows = [(f"through {name}", mesh.bounds.mean(axis=0) if inclusion_mm is None else inclusion_mm)]
    if next_mm is not None and inward is not None:
        rows.append(("through the next press", next_mm + 0.5 * radius_mm * inward))
    figure = new_figure(10.0, 3.1 * len(rows) + 0.9)
    panels = figure.subplots(len(rows), 3, squeeze=False)
    norm = colour_scale({"reconstruction": youngs}, "linear", None)
    patches = contact_patches(mesh, pressed)
    for axes_row, (label, point) in zip(panels, rows, strict=True):
        for axes, piece in zip(axes_row, slices_at(mesh, point, _PIXELS), strict=True):
            piece.draw(axes, youngs, cmap="viridis", norm=norm)
            draw_body(axes, mesh, piece)
            for patch in patches:
                draw_contact(axes, mesh, patch, piece)
            if inclusion_mm is not None and point is inclusion_mm:
                x, y = inclusion_mm[list(IN_PLANE[piece.axis])]
                axes.plot([x], [y], "+", color=_CENTRE, ms=9, mew=1.4, zorder=4)
            if next_mm is not None and inward is not None:
                _draw_next_press(axes, mesh, piece, next_mm, inward, radius_mm)
            _label(axes, mesh, piece)
        axes_row[0].set_ylabel(f"{label}\n{axes_row[0].get_ylabel()}", fontsize=9)
    figure.colorbar(panels[0, 0].images[0], ax=panels, label=MODULUS_LABEL, aspect=30, pad=0.02)
    handles = [Line2D([], [], color=CONTACT, linewidth=2.5, label="contact of the presses so far")]
    if inclusion_mm is not None:
        cross = Line2D([], [], color=_CENTRE, marker="P", ls="", mec="0.3", markersize=8)
        cross.set_label("centre of the inclusion")
        handles.append(cross)
    if len(rows) > 1:
        handles.append(Line2D([], [], color=_NEXT, linewidth=2.4, marker=">", label="next press"))
    figure.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False, fontsize=9)
    if title:
        figure.suptitle(title, fontsize=11)
    return figure


def _label(axes: Axes, mesh: TetMesh, piece: Slice) -> None:
    """Label a panel and give all panels the same size in mm, with a margin for the arrow."""
    across, up = (AXES[a] for a in IN_PLANE[piece.axis])
    axes.set_title(f"{AXES[piece.axis]} = {piece.position_mm:.3g} mm", fontsize=9)
    axes.set_xlabel(f"{across} (mm)", fontsize=9)
    axes.set_ylabel(f"{up} (mm)", fontsize=9)
    axes.tick_params(labelsize=8)
    axes.spines[["top", "right"]].set_visible(False)
    half = (0.5 + _ARROW + 0.06) * float(np.ptp(mesh.bounds, axis=0).max())
    x, y = mesh.bounds.mean(axis=0)[list(IN_PLANE[piece.axis])]
    axes.set(xlim=(x - half, x + half), ylim=(y - half, y + half))


def _draw_next_press(
    axes: Axes,
    mesh: TetMesh,
    piece: Slice,
    next_mm: np.ndarray,
    inward: np.ndarray,
    radius_mm: float,
) -> None:
    """Draw an arrow, or a ring if seen from above, in slices that cross the contact."""
    if abs(piece.position_mm - next_mm[piece.axis]) > radius_mm:
        return
    plane = list(IN_PLANE[piece.axis])
    tip, along = next_mm[plane], inward[plane]
    if np.linalg.norm(along) < 0.3:
        angle = np.linspace(0.0, 2.0 * np.pi, 49)
        ring = tip[:, None] + radius_mm * np.stack([np.cos(angle), np.sin(angle)])
        axes.plot(*ring, color=_NEXT, lw=2)
        axes.plot([tip[0]], [tip[1]], "o", color=_NEXT, markersize=4)
        return
    length = _ARROW * float(np.ptp(mesh.bounds, axis=0).max())
    start = tuple(tip - length * along / np.linalg.norm(along))
    style = {"arrowstyle": "-|>", "color": _NEXT, "linewidth": 2.4, "mutation_scale": 16}
    axes.annotate("", xy=tuple(tip), xytext=start, arrowprops=style, zorder=5)
