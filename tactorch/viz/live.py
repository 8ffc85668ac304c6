"""The picture of a live run: the map through what was found, and the place to press next."""

from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from tactorch.mesh import TetMesh
from tactorch.viz._figure import new_figure, save_figure
from tactorch.viz.contact import ContactPatch, contact_patches, cut_triangles
from tactorch.viz.sampling import IN_PLANE, Slice, slices_at
from tactorch.viz.scale import colour_scale
from tactorch.viz.slices import LABEL

_AXES = "xyz"
_PIXELS = 90
_CONTACT, _NEXT, _FOUND = "#D55E00", "#CC3399", "white"
_ARROW = 0.2  # of the longest side
_NEAR = 1.0  # radii of the sensor: from how far a slice shows the next press


def plot_live(
    mesh: TetMesh,
    youngs: Float[np.ndarray, " _"],
    path: str | Path,
    *,
    pressed: Float[np.ndarray, "_ 3"],
    found_mm: Float[np.ndarray, "3"] | None = None,
    next_mm: Float[np.ndarray, "3"] | None = None,
    inward: Float[np.ndarray, "3"] | None = None,
    radius_mm: float = 0.0,
    title: str = "",
) -> Path:
    """Draw `live_figure` to a file (png, pdf or svg), whole or not at all; returns its path."""
    figure = live_figure(
        mesh,
        youngs,
        pressed=pressed,
        found_mm=found_mm,
        next_mm=next_mm,
        inward=inward,
        radius_mm=radius_mm,
        title=title,
    )
    return save_figure(figure, path, dpi=110)


def live_figure(
    mesh: TetMesh,
    youngs: Float[np.ndarray, " _"],
    *,
    pressed: Float[np.ndarray, "_ 3"],
    found_mm: Float[np.ndarray, "3"] | None = None,
    next_mm: Float[np.ndarray, "3"] | None = None,
    inward: Float[np.ndarray, "3"] | None = None,
    radius_mm: float = 0.0,
    title: str = "",
) -> Figure:
    """Draw three slices through what was found, above three through the next press.

    Args:
        mesh: The body, mm.
        youngs: Young's modulus of each element, MPa (m,).
        pressed: External force on each node, N (n, 3), summed over presses.
        found_mm: Middle of the inclusion; the middle of the body where there is none.
        next_mm: Where to press next; without, the lower row is left out.
        inward: Unit vector of that press.
        radius_mm: Of the sensor.
        title: Printed above.
    """
    middle = mesh.bounds.mean(axis=0) if found_mm is None else found_mm
    name = "the middle of the object" if found_mm is None else "the inclusion"
    rows = [(f"through {name}", middle)]
    if next_mm is not None and inward is not None:
        # A little below the surface, where the press is felt.
        rows.append(("through the next press", next_mm + 0.5 * radius_mm * inward))
    figure = new_figure(10.0, 3.1 * len(rows) + 0.9)
    panels = figure.subplots(len(rows), 3, squeeze=False)
    norm = colour_scale({"reconstruction": youngs}, "linear", None)
    patches = contact_patches(mesh, pressed)
    for axes_row, (label, point) in zip(panels, rows, strict=True):
        for axes, piece in zip(axes_row, slices_at(mesh, point, _PIXELS), strict=True):
            _draw(axes, mesh, piece, youngs, norm, patches)
            if found_mm is not None and point is found_mm:
                _cross(axes, piece, found_mm)
            if next_mm is not None and inward is not None:
                _arrow(axes, mesh, piece, next_mm, inward, radius_mm)
            _window(axes, mesh, piece)
        axes_row[0].set_ylabel(f"{label}\n{axes_row[0].get_ylabel()}", fontsize=9)
    figure.colorbar(panels[0, 0].images[0], ax=panels, label=LABEL, aspect=30, pad=0.02)
    _legend(figure, found_mm is not None, next_mm is not None)
    if title:
        figure.suptitle(title, fontsize=11)
    return figure


def _draw(
    axes: Axes,
    mesh: TetMesh,
    piece: Slice,
    youngs: np.ndarray,
    norm: Normalize,
    patches: list[ContactPatch],
) -> None:
    """One slice: colours, outline and what was pressed so far."""
    axes.imshow(
        piece.values(youngs),
        extent=piece.extent_mm,
        origin="lower",
        interpolation="nearest",
        cmap="viridis",
        norm=norm,
    )
    outline = cut_triangles(mesh.points, mesh.surface.triangles, piece.axis, piece.position_mm)
    axes.add_collection(LineCollection(list(outline), colors="0.4", linewidths=0.6))
    for patch in patches:
        lines = cut_triangles(mesh.points, patch.triangles, piece.axis, piece.position_mm)
        axes.add_collection(LineCollection(list(lines), colors=_CONTACT, linewidths=2.5, zorder=3))
    across, up = (_AXES[a] for a in IN_PLANE[piece.axis])
    axes.set_title(f"{_AXES[piece.axis]} = {piece.position_mm:.3g} mm", fontsize=9)
    axes.set_xlabel(f"{across} (mm)", fontsize=9)
    axes.set_ylabel(f"{up} (mm)", fontsize=9)
    axes.tick_params(labelsize=8)
    axes.spines[["top", "right"]].set_visible(False)


def _window(axes: Axes, mesh: TetMesh, piece: Slice) -> None:
    """As wide and high in mm in every panel, with room for the arrow."""
    half = (0.5 + _ARROW + 0.06) * float(np.ptp(mesh.bounds, axis=0).max())
    across, up = mesh.bounds.mean(axis=0)[list(IN_PLANE[piece.axis])]
    axes.set_xlim(across - half, across + half)
    axes.set_ylim(up - half, up + half)


def _cross(axes: Axes, piece: Slice, found_mm: np.ndarray) -> None:
    across, up = found_mm[list(IN_PLANE[piece.axis])]
    axes.plot([across], [up], "+", color=_FOUND, markersize=9, markeredgewidth=1.4, zorder=4)


def _arrow(
    axes: Axes,
    mesh: TetMesh,
    piece: Slice,
    next_mm: np.ndarray,
    inward: np.ndarray,
    radius_mm: float,
) -> None:
    """The next press, in slices that pass through its patch: an arrow, or a ring from above."""
    if abs(piece.position_mm - next_mm[piece.axis]) > _NEAR * radius_mm:
        return
    plane = list(IN_PLANE[piece.axis])
    tip, along = next_mm[plane], inward[plane]
    if np.linalg.norm(along) < 0.3:
        turn = np.linspace(0.0, 2.0 * np.pi, 49)
        axes.plot(
            tip[0] + radius_mm * np.cos(turn), tip[1] + radius_mm * np.sin(turn), color=_NEXT, lw=2
        )
        axes.plot([tip[0]], [tip[1]], "o", color=_NEXT, markersize=4)
        return
    length = _ARROW * float(np.ptp(mesh.bounds, axis=0).max())
    axes.annotate(
        "",
        xy=tuple(tip),
        xytext=tuple(tip - length * along / np.linalg.norm(along)),
        arrowprops={"arrowstyle": "-|>", "color": _NEXT, "linewidth": 2.4, "mutation_scale": 16},
        zorder=5,
    )


def _legend(figure: Figure, found: bool, following: bool) -> None:
    handles = [Line2D([], [], color=_CONTACT, linewidth=2.5)]
    labels = ["pressed so far"]
    if found:
        style = {"marker": "P", "linestyle": "", "markeredgecolor": "0.3", "markersize": 8}
        handles.append(Line2D([], [], color=_FOUND, **style))  # type: ignore[arg-type]
        labels.append("middle of the inclusion")
    if following:
        handles.append(Line2D([], [], color=_NEXT, linewidth=2.4, marker=">"))
        labels.append("press here next")
    figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False, fontsize=9)
