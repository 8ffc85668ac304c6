"""Slices through a map of Young's modulus across three axes: evenly spaced, or in a live run."""

from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import ScalarFormatter

from tactorch.errors import ConfigError
from tactorch.mesh import TetMesh
from tactorch.sampling import Patch
from tactorch.viz.contact import (
    CONTACT_LINE,
    ContactPatch,
    arrow_positions,
    contact_patches,
    draw_cut,
)
from tactorch.viz.figure import CONTACT, MODULUS_LABEL, new_grid
from tactorch.viz.slicing import (
    IN_PLANE,
    OUTLINE_STYLES,
    Slice,
    check_values,
    colour_scale,
    departure_from_background,
    draw_outline,
    slice_body,
    slices_at,
)

_ARROW = 0.13  # length of arrows, as a fraction of the longest side
_PANEL_INCHES = 1.7
_LIVE_PIXELS = 90
_LIVE_ARROW = 0.2  # length of the arrow of the next press, likewise
_NEXT, _CENTRE = "#CC3399", "white"


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
    label: str = MODULUS_LABEL,
    title: str = "",
    truth_rows: bool = True,
    pixels: int = 120,
) -> Figure:
    """Return a figure of slices across x, y and z with one colour scale.

    Args:
        mesh: Mesh of the body, mm.
        youngs: Young's modulus of each element, MPa (m,).
        truth: True modulus of each element, MPa (m,); its inclusions are outlined.
        pressed: External force on each node, N (n, 3), summed over presses; or face names.
            Contact is drawn as a thick line with arrows along the force.
        n_slices: Number of evenly spaced slices across each axis.
        scale: Colour scale, "linear" or "log".
        limits_mpa: Ends of the colour scale, MPa; computed from the values if None.
        cmap: Name of a matplotlib colour map.
        label: Label of the colour bar.
        title: Title of the figure.
        truth_rows: Whether rows with slices of the truth are added.
        pixels: Number of pixels along the longest side of the body.

    Raises:
        TactorchError: Values do not match the mesh or are not finite.
        ConfigError: A setting is out of range or unknown.
    """
    if n_slices < 1:
        raise ConfigError(f"n_slices is {n_slices}; give at least 1.")
    if pixels < 2:
        raise ConfigError(f"pixels is {pixels}; give at least 2, better 100.")
    if cmap not in matplotlib.colormaps:
        raise ConfigError(f"cmap '{cmap}' is not known to matplotlib; try viridis or cividis.")
    check_values("youngs", youngs, mesh)
    maps, departure = {"reconstruction": youngs}, None
    if truth is not None:
        check_values("truth", truth, mesh)
        maps["truth"], departure = truth, departure_from_background(mesh, truth)
    patches = [] if pressed is None else contact_patches(mesh, pressed)
    arrow_mm = _ARROW * float(np.ptp(mesh.bounds, axis=0).max())
    window_mm = _window(mesh, patches, arrow_mm)
    norm = colour_scale(maps, scale, limits_mpa)
    if not truth_rows:
        maps.pop("truth", None)
    figure, panels = _panels(np.ptp(window_mm, axis=0), n_slices, len(maps))
    slices = slice_body(mesh, n_slices, pixels)
    for row, axes_row in enumerate(panels):
        part, kind = divmod(row, len(maps))
        name, values = list(maps.items())[kind]
        for piece, axes in zip(slices[part], axes_row, strict=True):
            piece.draw(axes, values, cmap=cmap, norm=norm)
            if departure is not None:
                draw_outline(axes, mesh, piece, departure)
            _draw_body(axes, mesh, piece, patches, arrow_mm)
            _set_window(axes, piece, window_mm)
            title = name if len(maps) > 1 else ""
            left, bottom = axes is axes_row[0], kind == len(maps) - 1
            piece.label(axes, title, left=left, top=kind == 0, bottom=bottom)
    _add_colour_bar(figure, panels, np.concatenate(list(maps.values())), norm, label)
    legend: dict[str, Any] = {}
    if patches:
        legend["contact (arrows: direction of the force)"] = Line2D(
            [], [], color=CONTACT, linewidth=2.5
        )
    if departure is not None:
        lines = [Line2D([], [], color=c, linewidth=w, linestyle=s) for c, w, s in OUTLINE_STYLES]
        legend["true inclusion"] = tuple(lines)
    _add_legend(figure, legend, title)
    return figure


def _window(mesh: TetMesh, patches: list[ContactPatch], arrow_mm: float) -> np.ndarray:
    """Return the lowest and highest corner of the body with a margin for arrows, (2, 3) mm."""
    margins = np.full((2, 3), 0.25 * arrow_mm)
    for patch in patches:
        margins[0, patch.direction > 0.3] = 1.25 * arrow_mm
        margins[1, patch.direction < -0.3] = 1.25 * arrow_mm
    return mesh.bounds + np.array([[-1.0], [1.0]]) * margins


def _panels(size: np.ndarray, n_slices: int, n_maps: int) -> tuple[Figure, np.ndarray]:
    width = _PANEL_INCHES
    widest = max(size[across] for across, _ in IN_PLANE)
    heights = [float(width * size[up] / widest) for _, up in IN_PLANE for _ in range(n_maps)]
    # Inches of titles, axis labels and legend.
    labels = 3 * (0.75 + 0.2 * (n_maps - 1)) + 0.7
    inches = (width + 0.12) * n_slices + 1.7, sum(heights) + labels
    return new_grid(*inches, len(heights), n_slices, gridspec_kw={"height_ratios": heights})


def _draw_body(
    axes: Axes,
    mesh: TetMesh,
    piece: Slice,
    patches: Sequence[ContactPatch],
    arrow_mm: float | None = None,
) -> None:
    """Draw the outline of the body and its contacts, with arrows if their length is given."""
    draw_cut(axes, piece, mesh.points, mesh.surface.triangles, colors="0.4", linewidths=0.6)
    style = {"arrowstyle": "-|>", "color": CONTACT, "linewidth": 1.1, "shrinkA": 0, "shrinkB": 1}
    for patch in patches:
        segments = draw_cut(axes, piece, mesh.points, patch.triangles, **CONTACT_LINE, zorder=3)
        if arrow_mm is None:
            continue
        tips, along = arrow_positions(segments, patch.direction, piece.axis)
        for tip in tips:
            start = tuple(tip - arrow_mm * along)
            arrow = axes.annotate("", xy=tuple(tip), xytext=start, arrowprops=style)
            arrow.set_in_layout(False)  # within the panel; computing each extent takes seconds


def _set_window(axes: Axes, piece: Slice, window_mm: np.ndarray) -> None:
    """Limit a panel; the same width in mm for every axis gives one length scale."""
    across, up = IN_PLANE[piece.axis]
    widest = max(np.ptp(window_mm[:, a]) for a, _ in IN_PLANE)
    middle = window_mm[:, across].mean()
    axes.set_xlim(middle - widest / 2, middle + widest / 2)
    axes.set_ylim(*window_mm[:, up])
    axes.spines[["top", "right"]].set_visible(False)


def _add_colour_bar(
    figure: Figure, panels: np.ndarray, values: np.ndarray, norm: Normalize, label: str
) -> None:
    beyond_low, beyond_high = bool(values.min() < norm.vmin), bool(values.max() > norm.vmax)
    extend = ("neither", "min", "max", "both")[beyond_low + 2 * beyond_high]
    bar = figure.colorbar(
        panels[0, 0].images[0], ax=panels, label=label, extend=extend, aspect=40, pad=0.02
    )
    if isinstance(norm, LogNorm):
        bar.ax.yaxis.set_major_formatter(ScalarFormatter())
        bar.ax.yaxis.set_minor_formatter(ScalarFormatter())
        bar.ax.tick_params(which="minor", labelsize=7)


def _add_legend(figure: Figure, legend: dict[str, Any], title: str) -> None:
    if legend:
        figure.legend(
            list(legend.values()), list(legend), loc="outside lower center", ncols=3,
            frameon=False, fontsize=9, handlelength=3,
        )  # fmt: skip
    if title:
        figure.suptitle(title, fontsize=12)


def live_figure(
    mesh: TetMesh,
    youngs: Float[np.ndarray, " m"],
    *,
    pressed: Float[np.ndarray, "n 3"],
    inclusion_mm: Float[np.ndarray, "3"] | None = None,
    next_press: Patch | None = None,
    title: str = "",
) -> Figure:
    """Return a figure of three slices through the inclusion, and three through the next press.

    Forces `pressed` on the nodes are summed over presses. Without an inclusion the slices are
    through the centre of the body; without a next press the second row is omitted.
    """
    name = "the middle of the object" if inclusion_mm is None else "the inclusion"
    rows = [(f"through {name}", mesh.bounds.mean(axis=0) if inclusion_mm is None else inclusion_mm)]
    if next_press is not None:
        inside = next_press.center + 0.5 * next_press.radius_mm * next_press.inward
        rows.append(("through the next press", inside))
    figure, panels = new_grid(10.0, 3.1 * len(rows) + 0.9, len(rows), 3)
    norm = colour_scale({"reconstruction": youngs}, "linear", None)
    patches, longest = contact_patches(mesh, pressed), float(np.ptp(mesh.bounds, axis=0).max())
    half = (0.5 + _LIVE_ARROW + 0.06) * longest  # with a margin for the arrow
    window_mm = mesh.bounds.mean(axis=0) + np.array([[-half], [half]])
    for axes_row, (label, point) in zip(panels, rows, strict=True):
        for axes, piece in zip(axes_row, slices_at(mesh, point, _LIVE_PIXELS), strict=True):
            piece.draw(axes, youngs, cmap="viridis", norm=norm)
            _draw_body(axes, mesh, piece, patches)
            if inclusion_mm is not None and point is inclusion_mm:
                x, y = inclusion_mm[list(IN_PLANE[piece.axis])]
                axes.plot([x], [y], "+", color=_CENTRE, ms=9, mew=1.4, zorder=4)
            if next_press is not None:
                _draw_next_press(axes, piece, next_press, _LIVE_ARROW * longest)
            _set_window(axes, piece, window_mm)
            piece.label(axes, label if axes is axes_row[0] else "")
    _add_colour_bar(figure, panels, youngs, norm, MODULUS_LABEL)
    legend = {"contact of the presses so far": Line2D([], [], color=CONTACT, linewidth=2.5)}
    if inclusion_mm is not None:
        cross = Line2D([], [], color=_CENTRE, marker="P", ls="", mec="0.3", markersize=8)
        legend["centre of the inclusion"] = cross
    if len(rows) > 1:
        legend["next press"] = Line2D([], [], color=_NEXT, linewidth=2.4, marker=">")
    _add_legend(figure, legend, title)
    return figure


def _draw_next_press(axes: Axes, piece: Slice, press: Patch, arrow_mm: float) -> None:
    """Draw an arrow, or a ring if seen from above, in slices that cross the contact."""
    if abs(piece.position_mm - press.center[piece.axis]) > press.radius_mm:
        return
    plane = list(IN_PLANE[piece.axis])
    tip, along = press.center[plane], press.inward[plane]
    if np.linalg.norm(along) < 0.3:
        angle = np.linspace(0.0, 2.0 * np.pi, 49)
        ring = tip[:, None] + press.radius_mm * np.stack([np.cos(angle), np.sin(angle)])
        axes.plot(*ring, color=_NEXT, lw=2)
        axes.plot([tip[0]], [tip[1]], "o", color=_NEXT, markersize=4)
        return
    start = tuple(tip - arrow_mm * along / np.linalg.norm(along))
    style = {"arrowstyle": "-|>", "color": _NEXT, "linewidth": 2.4, "mutation_scale": 16}
    axes.annotate("", xy=tuple(tip), xytext=start, arrowprops=style, zorder=5)
