"""Slices of a result, beside its element map and the truth, and of several results."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure

from tactorch.errors import ConfigError
from tactorch.inverse import Reconstruction
from tactorch.text import one_line
from tactorch.viz.contact import CONTACT_LINE, contact_patches, draw_cut
from tactorch.viz.figure import MODULUS_LABEL, new_grid
from tactorch.viz.lump_surfaces import lump_surfaces
from tactorch.viz.slicing import Slice, check_values, colour_scale, slices_at

_PANEL_INCHES = 2.3
_PIXELS, _COMPARED_PIXELS = 160, 90
_MAX_NAME = 90
# Outlines of an inclusion, and of what is inside it with 95 % and 5 %.
_BEST: dict[str, Any] = {"colors": "white", "linewidths": 1.3, "linestyles": "-", "zorder": 3}
_RANGE = {**_BEST, "linewidths": 0.8, "linestyles": ":"}


def reconstruction_figure(
    result: Reconstruction,
    *,
    truth: Float[np.ndarray, " m"] | None = None,
    pressed: Float[np.ndarray, "n 3"] | Sequence[str] | None = None,
    point_mm: Float[np.ndarray, "3"] | None = None,
    cmap: str = "viridis",
) -> Figure:
    """Return a figure of slices through the first lump, or the centre of the body.

    The rows are the result, with sharp boundaries of its inclusions and dotted lines where the
    boundary is with a probability of 90 %; the element map, where it was computed beside
    inclusions; and the truth.

    Args:
        result: Result of `tactorch.invert`.
        truth: True modulus of each element, MPa (m,).
        pressed: External force on each node, N (n, 3), summed over presses, or face names; the
            contact is drawn as a thick line.
        point_mm: Point that the slices have in common, instead of the lump's centre.
        cmap: Name of a matplotlib colour map.

    Raises:
        TactorchError: values do not match the mesh.
    """
    mesh = result.mesh
    rows: dict[str, np.ndarray | None] = {result.name: None if result.shapes else result.youngs}
    if result.other is not None:
        rows["element map"] = result.youngs if result.shapes is None else result.other.youngs
    if truth is not None:
        rows["truth by element"] = truth
    for name, values in rows.items():
        if values is not None:
            check_values(name, values, mesh)
    if point_mm is None:
        center = result.lumps[0].inclusion.center_mm if result.lumps else None
        point_mm = np.mean(mesh.bounds, axis=0) if center is None else center
    slices = slices_at(mesh, point_mm, _PIXELS)
    fields = [_field(piece, result) for piece in slices]
    scaled = {"reconstruction": np.concatenate([field.compressed() for field in fields])}
    norm = colour_scale(scaled if truth is None else scaled | {"truth": truth}, "linear", None)
    lumps = [] if result.shapes is None else lump_surfaces(result.shapes)
    patches = [] if pressed is None else contact_patches(mesh, pressed)
    height = len(rows) * _PANEL_INCHES + 0.5
    figure, grid = new_grid(3 * _PANEL_INCHES + 1.0, height, len(rows), 3)
    last = list(rows)[-1]
    for (name, values), row in zip(rows.items(), grid, strict=True):
        for piece, field, axes in zip(slices, fields, row, strict=True):
            pixels = field if values is None else piece.values(values)
            piece.show(axes, pixels, cmap=cmap, norm=norm)
            for lump in lumps if name == result.name else ():
                outlines = (lump.best, _BEST), (lump.inner, _RANGE), (lump.outer, _RANGE)
                for surface, style in outlines:
                    if surface is not None:
                        draw_cut(axes, piece, *surface, **style)
            for patch in patches:
                draw_cut(axes, piece, mesh.points, patch.triangles, **CONTACT_LINE)
            title = name if axes is row[0] else ""
            piece.label(axes, title, bottom=name == last, fontsize=8)
    figure.colorbar(ScalarMappable(norm, cmap), ax=grid, label=MODULUS_LABEL, shrink=0.8)
    if result.reasons:
        figure.suptitle("Do not trust this result: see its summary", color="firebrick", fontsize=10)
    return figure


def _field(piece: Slice, result: Reconstruction) -> Float[np.ma.MaskedArray, "r c"]:
    """Modulus of a result at the pixels of a slice, masked outside the body."""
    if result.shapes is None:
        return piece.values(result.youngs)
    values = result.youngs_at(piece.points.reshape(-1, 3)).reshape(piece.elements.shape)
    return np.ma.masked_where(piece.elements < 0, values)


def comparison_figure(
    runs: Mapping[str, Reconstruction], *, common: bool = True, cmap: str = "viridis"
) -> Figure:
    """Return a figure with three slices of each map, one run in each row.

    Args:
        runs: Results of inversions by name.
        common: Whether all runs have one colour scale, rather than one each.
        cmap: Name of a matplotlib colour map.

    Raises:
        ConfigError: There is no run.
    """
    if not runs:
        raise ConfigError("comparison_figure: no run given; pass at least one.")
    everything = np.concatenate([run.youngs for run in runs.values()])
    figure, grid = new_grid(3 * _PANEL_INCHES + 1.6, _PANEL_INCHES * len(runs) + 0.4, len(runs), 3)
    for row, (name, run) in zip(grid, runs.items(), strict=True):
        scaled = everything if common else run.youngs
        norm = colour_scale({"reconstruction": scaled}, "linear", None)
        center = np.mean(run.mesh.bounds, axis=0)
        for axes, piece in zip(row, slices_at(run.mesh, center, _COMPARED_PIXELS), strict=True):
            piece.draw(axes, run.youngs, cmap=cmap, norm=norm)
            piece.label(axes, top=False, fontsize=7)
        row[1].set_title(one_line(name, _MAX_NAME), fontsize=8)
        if not common:
            figure.colorbar(ScalarMappable(norm, cmap), ax=row, label=MODULUS_LABEL, shrink=0.9)
    if common:
        figure.colorbar(ScalarMappable(norm, cmap), ax=grid, label=MODULUS_LABEL, shrink=0.8)
    return figure
