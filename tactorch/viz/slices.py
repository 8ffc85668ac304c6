"""Slices through a map of Young's modulus along three axes, in one picture."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator, ScalarFormatter

from tactorch.errors import ConfigError, TactorchError
from tactorch.mesh import TetMesh
from tactorch.viz._figure import new_figure, save_figure
from tactorch.viz.contact import ContactPatch, arrow_places, contact_patches, cut_triangles
from tactorch.viz.outline import Outline
from tactorch.viz.sampling import IN_PLANE, Slice, slice_body
from tactorch.viz.scale import colour_scale

LABEL = "Young's modulus (MPa)"
_AXES = "xyz"
_CONTACT = "#D55E00"  # vermilion: apart from every colour of viridis and cividis
_ARROW = 0.13  # length of arrows as a share of the longest side
_PANEL_INCHES = 1.7


@dataclass(frozen=True, eq=False)
class _Look:
    """What all panels share."""

    norm: Normalize
    cmap: str
    window_mm: np.ndarray
    arrow_mm: float
    patches: list[ContactPatch]
    outline: Outline | None


def plot_slices(
    mesh: TetMesh,
    youngs: Float[np.ndarray, " _"],
    path: str | Path,
    *,
    truth: Float[np.ndarray, " _"] | None = None,
    pressed: Float[np.ndarray, "_ 3"] | Sequence[str] | None = None,
    n_slices: int = 5,
    scale: str = "linear",
    limits_mpa: tuple[float, float] | None = None,
    cmap: str = "viridis",
    title: str = "",
    truth_rows: bool = True,
    pixels: int = 120,
) -> Path:
    """Draw `slice_figure` to a file (png, pdf or svg) and return its path."""
    figure = slice_figure(
        mesh,
        youngs,
        truth=truth,
        pressed=pressed,
        n_slices=n_slices,
        scale=scale,
        limits_mpa=limits_mpa,
        cmap=cmap,
        title=title,
        truth_rows=truth_rows,
        pixels=pixels,
    )
    return save_figure(figure, path)


def slice_figure(
    mesh: TetMesh,
    youngs: Float[np.ndarray, " _"],
    *,
    truth: Float[np.ndarray, " _"] | None = None,
    pressed: Float[np.ndarray, "_ 3"] | Sequence[str] | None = None,
    n_slices: int = 5,
    scale: str = "linear",
    limits_mpa: tuple[float, float] | None = None,
    cmap: str = "viridis",
    title: str = "",
    truth_rows: bool = True,
    pixels: int = 120,
) -> Figure:
    """Draw slices across x, y and z with one colour scale.

    Args:
        mesh: The body, mm.
        youngs: Young's modulus of each element, MPa (m,).
        truth: True modulus, MPa (m,): its inclusions are outlined by a dashed line.
        pressed: External force on each node, N (n, 3), summed over presses; or face names.
            Where the surface is touched is drawn thick, with arrows along the force.
        n_slices: Slices across each axis, evenly spaced.
        scale: "linear" or "log" colours.
        limits_mpa: Ends of the colour scale; chosen by the values when not given.
        cmap: A matplotlib colour map.
        title: Printed above.
        truth_rows: Show the truth in rows of its own too.
        pixels: Pixels along the longest side of the body.

    Raises:
        TactorchError: Values that do not fit the mesh or are not finite.
        ConfigError: A setting that cannot be used.
    """
    _check_settings(n_slices, pixels, cmap)
    maps = {"reconstruction": _checked("youngs", youngs, mesh)}
    if truth is not None:
        maps["truth"] = _checked("truth", truth, mesh)
    patches = [] if pressed is None else contact_patches(mesh, pressed)
    arrow = _ARROW * float(np.ptp(mesh.bounds, axis=0).max())
    look = _Look(
        norm=colour_scale(maps, scale, limits_mpa),
        cmap=cmap,
        window_mm=_window(mesh, patches, arrow),
        arrow_mm=arrow,
        patches=patches,
        outline=None if truth is None else Outline.of(mesh, maps["truth"]),
    )
    if not truth_rows:
        maps.pop("truth", None)
    figure, panels = _panels(np.ptp(look.window_mm, axis=0), n_slices, len(maps))
    slices = slice_body(mesh, n_slices, pixels)
    for row, axes_row in enumerate(panels):
        name, values = list(maps.items())[row % len(maps)]
        for piece, axes in zip(slices[row // len(maps)], axes_row, strict=True):
            _draw(axes, mesh, piece, values, look)
        _label(axes_row, slices[row // len(maps)], name if len(maps) > 1 else "", row, len(maps))
    _colour_bar(figure, panels, maps, look)
    _legend(figure, look)
    if title:
        figure.suptitle(title, fontsize=12)
    return figure


def _check_settings(n_slices: int, pixels: int, cmap: str) -> None:
    """Refuse settings that make no picture."""
    if n_slices < 1:
        raise ConfigError(f"n_slices is {n_slices}; give at least 1.")
    if pixels < 2:
        raise ConfigError(f"pixels is {pixels}; give at least 2, better 100.")
    if cmap not in matplotlib.colormaps:
        raise ConfigError(f"cmap '{cmap}' is not known to matplotlib; try viridis or cividis.")


def _checked(name: str, values: np.ndarray, mesh: TetMesh) -> np.ndarray:
    """Return values that are one finite number per element, or say what is wrong."""
    count = mesh.n_tets
    if values.shape != (count,):
        raise TactorchError(
            f"{name}: shape {values.shape} for a mesh of {count} tetrahedra; "
            f"give one modulus (MPa) per tetrahedron, shape ({count},)."
        )
    wrong = np.flatnonzero(~np.isfinite(values))
    if len(wrong):
        raise TactorchError(
            f"{name}: {len(wrong)} of {count} values are not finite, the first at element "
            f"{wrong[0]}; a map needs a number everywhere."
        )
    return values


def _window(mesh: TetMesh, patches: list[ContactPatch], arrow: float) -> np.ndarray:
    """Return (2, 3) corners of the part of space shown: the body, and room for arrows."""
    margins = np.full((2, 3), 0.25 * arrow)
    for patch in patches:
        margins[0, patch.direction > 0.3] = 1.25 * arrow
        margins[1, patch.direction < -0.3] = 1.25 * arrow
    return mesh.bounds + np.array([[-1.0], [1.0]]) * margins


def _panels(size: np.ndarray, n_slices: int, n_maps: int) -> tuple[Figure, np.ndarray]:
    """Make the grid of panels, each row as high as its slices need."""
    width = _PANEL_INCHES
    widest = max(size[across] for across, _ in IN_PLANE)
    heights = [float(width * size[up] / widest) for _, up in IN_PLANE for _ in range(n_maps)]
    # Beside the panels: labels and colour bar; above and below: titles, labels and the legend.
    labels = 3 * (0.75 + 0.2 * (n_maps - 1)) + 0.7
    figure = new_figure((width + 0.12) * n_slices + 1.7, sum(heights) + labels)
    panels = figure.subplots(
        len(heights), n_slices, squeeze=False, gridspec_kw={"height_ratios": heights}
    )
    return figure, panels


def _draw(axes: Axes, mesh: TetMesh, piece: Slice, values: np.ndarray, look: _Look) -> None:
    """Draw one slice: colours, outline, contour of the truth, contact."""
    axes.imshow(
        piece.values(values),
        extent=piece.extent_mm,
        origin="lower",
        interpolation="nearest",
        cmap=look.cmap,
        norm=look.norm,
    )
    outline = cut_triangles(mesh.points, mesh.surface.triangles, piece.axis, piece.position_mm)
    axes.add_collection(LineCollection(list(outline), colors="0.4", linewidths=0.6))
    if look.outline is not None:
        look.outline.draw(axes, piece)
    _draw_contact(axes, mesh, piece, look)
    across, up = IN_PLANE[piece.axis]
    # As wide in mm for every axis: one scale of length throughout the picture.
    widest = max(np.ptp(look.window_mm[:, a]) for a, _ in IN_PLANE)
    middle = look.window_mm[:, across].mean()
    axes.set_xlim(middle - widest / 2, middle + widest / 2)
    axes.set_ylim(*look.window_mm[:, up])
    axes.spines[["top", "right"]].set_visible(False)


def _draw_contact(axes: Axes, mesh: TetMesh, piece: Slice, look: _Look) -> None:
    """Draw touched parts of the outline thick, with arrows that push on them."""
    for patch in look.patches:
        segments = cut_triangles(mesh.points, patch.triangles, piece.axis, piece.position_mm)
        axes.add_collection(
            LineCollection(list(segments), colors=_CONTACT, linewidths=2.5, zorder=3)
        )
        tips, along = arrow_places(segments, patch.direction, piece.axis, count=3)
        for tip in tips:
            arrow = axes.annotate(
                "",
                xy=tuple(tip),
                xytext=tuple(tip - look.arrow_mm * along),
                arrowprops={
                    "arrowstyle": "-|>",
                    "color": _CONTACT,
                    "linewidth": 1.1,
                    "shrinkA": 0,
                    "shrinkB": 1,
                },
            )
            arrow.set_in_layout(False)  # they lie within the panel; asking each takes seconds


def _label(axes_row: np.ndarray, slices: Sequence[Slice], name: str, row: int, n_maps: int) -> None:
    """Write positions above the first row of each axis, coordinates left and below."""
    across, up = (_AXES[a] for a in IN_PLANE[slices[0].axis])
    first, last = row % n_maps == 0, row % n_maps == n_maps - 1
    for column, (axes, piece) in enumerate(zip(axes_row, slices, strict=True)):
        axes.tick_params(labelsize=8, labelbottom=last, labelleft=column == 0)
        axes.xaxis.set_major_locator(MaxNLocator(4))
        axes.yaxis.set_major_locator(MaxNLocator(4))
        if first:
            position = round(piece.position_mm, 6) + 0.0  # no -0, no 1e-16
            axes.set_title(f"{_AXES[piece.axis]} = {position:.4g} mm", fontsize=9)
        if last:
            axes.set_xlabel(f"{across} (mm)", fontsize=9)
    axes_row[0].set_ylabel(f"{name}\n{up} (mm)" if name else f"{up} (mm)", fontsize=9)


def _colour_bar(
    figure: Figure, panels: np.ndarray, maps: dict[str, np.ndarray], look: _Look
) -> None:
    """Add the one colour bar, pointed at an end that values go beyond."""
    beyond_low = any(values.min() < look.norm.vmin for values in maps.values())
    beyond_high = any(values.max() > look.norm.vmax for values in maps.values())
    extend = {(False, False): "neither", (True, False): "min", (False, True): "max"}
    bar = figure.colorbar(
        panels[0, 0].images[0],
        ax=panels,
        label=LABEL,
        extend=extend.get((beyond_low, beyond_high), "both"),
        aspect=40,
        pad=0.02,
    )
    if isinstance(look.norm, LogNorm):
        bar.ax.yaxis.set_major_formatter(ScalarFormatter())
        bar.ax.yaxis.set_minor_formatter(ScalarFormatter())
        bar.ax.tick_params(which="minor", labelsize=7)


def _legend(figure: Figure, look: _Look) -> None:
    """Explain the lines below the panels."""
    handles: list[Any] = []
    labels = []
    if look.patches:
        handles.append(Line2D([], [], color=_CONTACT, linewidth=2.5))
        labels.append("contact (arrows: direction of the force)")
    if look.outline is not None:
        handles.append(Outline.handle())
        labels.append("true inclusion")
    if handles:
        figure.legend(
            handles,
            labels,
            loc="outside lower center",
            ncols=2,
            frameon=False,
            fontsize=9,
            handlelength=3,
        )
