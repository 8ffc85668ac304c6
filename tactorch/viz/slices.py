"""Slices through a map of Young's modulus across three axes, in one picture."""

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
from tactorch.viz.contact import ContactPatch, arrow_positions, contact_patches, cut_triangles
from tactorch.viz.figure import CONTACT, MODULUS_LABEL, new_figure, save_figure
from tactorch.viz.outline import Outline
from tactorch.viz.slicing import AXES, IN_PLANE, Slice, colour_scale, slice_body

_ARROW = 0.13  # length of arrows, as a fraction of the longest side
_PANEL_INCHES = 1.7


@dataclass(frozen=True, eq=False)
class _PanelStyle:
    """Style shared by all panels."""

    norm: Normalize
    cmap: str
    window_mm: np.ndarray
    arrow_mm: float
    patches: list[ContactPatch]
    outline: Outline | None


def plot_slices(
    mesh: TetMesh, youngs: Float[np.ndarray, " _"], path: str | Path, **options: Any
) -> Path:
    """Write `slice_figure(mesh, youngs, **options)` to a png, pdf or svg file and return its path.

    Raises:
        ConfigError: The suffix of `path` is none of these.
    """
    return save_figure(slice_figure(mesh, youngs, **options), path)


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
        mesh: Mesh of the body, mm.
        youngs: Young's modulus of each element, MPa (m,).
        truth: True modulus of each element, MPa (m,); its inclusions are outlined.
        pressed: External force on each node, N (n, 3), summed over presses; or face names.
            Contact is drawn as a thick line with arrows along the force.
        n_slices: Number of evenly spaced slices across each axis.
        scale: Colour scale, "linear" or "log".
        limits_mpa: Ends of the colour scale, MPa; computed from the values if None.
        cmap: Name of a matplotlib colour map.
        title: Title of the figure.
        truth_rows: Whether rows with slices of the truth are added.
        pixels: Number of pixels along the longest side of the body.

    Returns:
        The figure.

    Raises:
        TactorchError: Values do not match the mesh or are not finite.
        ConfigError: A setting is out of range or unknown.
    """
    _check_settings(n_slices, pixels, cmap)
    maps = {"reconstruction": youngs} | ({} if truth is None else {"truth": truth})
    for name, values in maps.items():
        _check_values("youngs" if name == "reconstruction" else name, values, mesh)
    patches = [] if pressed is None else contact_patches(mesh, pressed)
    arrow = _ARROW * float(np.ptp(mesh.bounds, axis=0).max())
    style = _PanelStyle(
        norm=colour_scale(maps, scale, limits_mpa),
        cmap=cmap,
        window_mm=_window(mesh, patches, arrow),
        arrow_mm=arrow,
        patches=patches,
        outline=None if truth is None else Outline.of(mesh, maps["truth"]),
    )
    if not truth_rows:
        maps.pop("truth", None)
    figure, panels = _panels(np.ptp(style.window_mm, axis=0), n_slices, len(maps))
    slices = slice_body(mesh, n_slices, pixels)
    for row, axes_row in enumerate(panels):
        name, values = list(maps.items())[row % len(maps)]
        for piece, axes in zip(slices[row // len(maps)], axes_row, strict=True):
            _draw(axes, mesh, piece, values, style)
        _label(axes_row, slices[row // len(maps)], name if len(maps) > 1 else "", row, len(maps))
    _colour_bar(figure, panels, maps, style)
    _legend(figure, style)
    if title:
        figure.suptitle(title, fontsize=12)
    return figure


def _check_settings(n_slices: int, pixels: int, cmap: str) -> None:
    """Raise `ConfigError` if a setting is out of range or unknown."""
    if n_slices < 1:
        raise ConfigError(f"n_slices is {n_slices}; give at least 1.")
    if pixels < 2:
        raise ConfigError(f"pixels is {pixels}; give at least 2, better 100.")
    if cmap not in matplotlib.colormaps:
        raise ConfigError(f"cmap '{cmap}' is not known to matplotlib; try viridis or cividis.")


def _check_values(name: str, values: np.ndarray, mesh: TetMesh) -> None:
    """Raise `TactorchError` unless there is one finite number per element."""
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


def _window(mesh: TetMesh, patches: list[ContactPatch], arrow: float) -> np.ndarray:
    """Return the lowest and highest corner of the body with a margin for arrows, (2, 3) mm."""
    margins = np.full((2, 3), 0.25 * arrow)
    for patch in patches:
        margins[0, patch.direction > 0.3] = 1.25 * arrow
        margins[1, patch.direction < -0.3] = 1.25 * arrow
    return mesh.bounds + np.array([[-1.0], [1.0]]) * margins


def _panels(size: np.ndarray, n_slices: int, n_maps: int) -> tuple[Figure, np.ndarray]:
    """Return the figure and its grid of panels, with rows as high as their slices."""
    width = _PANEL_INCHES
    widest = max(size[across] for across, _ in IN_PLANE)
    heights = [float(width * size[up] / widest) for _, up in IN_PLANE for _ in range(n_maps)]
    # Inches of titles, axis labels and legend.
    labels = 3 * (0.75 + 0.2 * (n_maps - 1)) + 0.7
    figure = new_figure((width + 0.12) * n_slices + 1.7, sum(heights) + labels)
    panels = figure.subplots(
        len(heights), n_slices, squeeze=False, gridspec_kw={"height_ratios": heights}
    )
    return figure, panels


def _draw(axes: Axes, mesh: TetMesh, piece: Slice, values: np.ndarray, style: _PanelStyle) -> None:
    """Draw the map, the outlines of body and truth, and the contact in one slice."""
    piece.draw(axes, values, cmap=style.cmap, norm=style.norm)
    draw_cut(axes, mesh, mesh.surface.triangles, piece, colors="0.4", linewidths=0.6)
    if style.outline is not None:
        style.outline.draw(axes, piece)
    _draw_contacts(axes, mesh, piece, style)
    across, up = IN_PLANE[piece.axis]
    # The same width in mm for every axis gives one length scale for the figure.
    widest = max(np.ptp(style.window_mm[:, a]) for a, _ in IN_PLANE)
    middle = style.window_mm[:, across].mean()
    axes.set_xlim(middle - widest / 2, middle + widest / 2)
    axes.set_ylim(*style.window_mm[:, up])
    axes.spines[["top", "right"]].set_visible(False)


def draw_cut(
    axes: Axes, mesh: TetMesh, triangles: np.ndarray, piece: Slice, **options: Any
) -> Float[np.ndarray, "s 2 2"]:
    """Draw the segments where triangles cross a slice, with options of `LineCollection`.

    Returns:
        The ends of the segments in the two coordinates of the slice, mm.
    """
    segments = cut_triangles(mesh.points, triangles, piece.axis, piece.position_mm)
    axes.add_collection(LineCollection(list(segments), **options))
    return segments


def draw_contact(
    axes: Axes, mesh: TetMesh, patch: ContactPatch, piece: Slice
) -> Float[np.ndarray, "s 2 2"]:
    """Draw a contact patch as thick lines; see `draw_cut`."""
    return draw_cut(axes, mesh, patch.triangles, piece, colors=CONTACT, linewidths=2.5, zorder=3)


def _draw_contacts(axes: Axes, mesh: TetMesh, piece: Slice, style: _PanelStyle) -> None:
    """Draw the contact as thick lines with arrows along the force."""
    for patch in style.patches:
        segments = draw_contact(axes, mesh, patch, piece)
        tips, along = arrow_positions(segments, patch.direction, piece.axis, count=3)
        for tip in tips:
            arrow = axes.annotate(
                "", xy=tuple(tip), xytext=tuple(tip - style.arrow_mm * along),
                arrowprops={
                    "arrowstyle": "-|>", "color": CONTACT, "linewidth": 1.1, "shrinkA": 0,
                    "shrinkB": 1,
                },
            )  # fmt: skip
            arrow.set_in_layout(False)  # within the panel; computing each extent takes seconds


def _label(axes_row: np.ndarray, slices: Sequence[Slice], name: str, row: int, n_maps: int) -> None:
    """Label the first row of each axis with positions, the left and lower panels with axes."""
    across, up = (AXES[a] for a in IN_PLANE[slices[0].axis])
    first, last = row % n_maps == 0, row % n_maps == n_maps - 1
    for column, (axes, piece) in enumerate(zip(axes_row, slices, strict=True)):
        axes.tick_params(labelsize=8, labelbottom=last, labelleft=column == 0)
        axes.xaxis.set_major_locator(MaxNLocator(4))
        axes.yaxis.set_major_locator(MaxNLocator(4))
        if first:
            position = round(piece.position_mm, 6) + 0.0  # no -0, no 1e-16
            axes.set_title(f"{AXES[piece.axis]} = {position:.4g} mm", fontsize=9)
        if last:
            axes.set_xlabel(f"{across} (mm)", fontsize=9)
    axes_row[0].set_ylabel(f"{name}\n{up} (mm)" if name else f"{up} (mm)", fontsize=9)


def _colour_bar(
    figure: Figure, panels: np.ndarray, maps: dict[str, np.ndarray], style: _PanelStyle
) -> None:
    """Add a colour bar, pointed at the ends that values exceed."""
    beyond_low = any(values.min() < style.norm.vmin for values in maps.values())
    beyond_high = any(values.max() > style.norm.vmax for values in maps.values())
    extend = {(False, False): "neither", (True, False): "min", (False, True): "max"}
    bar = figure.colorbar(
        panels[0, 0].images[0],
        ax=panels,
        label=MODULUS_LABEL,
        extend=extend.get((beyond_low, beyond_high), "both"),
        aspect=40,
        pad=0.02,
    )
    if isinstance(style.norm, LogNorm):
        bar.ax.yaxis.set_major_formatter(ScalarFormatter())
        bar.ax.yaxis.set_minor_formatter(ScalarFormatter())
        bar.ax.tick_params(which="minor", labelsize=7)


def _legend(figure: Figure, style: _PanelStyle) -> None:
    """Add the legend of contact and outline below the panels."""
    handles: list[Any] = []
    labels = []
    if style.patches:
        handles.append(Line2D([], [], color=CONTACT, linewidth=2.5))
        labels.append("contact (arrows: direction of the force)")
    if style.outline is not None:
        handles.append(Outline.handle())
        labels.append("true inclusion")
    if handles:
        figure.legend(
            handles, labels, loc="outside lower center", ncols=2, frameon=False, fontsize=9,
            handlelength=3,
        )  # fmt: skip
