"""Slices of a result: its field, the element map beside it, and the truth."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from tactorch.errors import TactorchError
from tactorch.inverse import Reconstruction
from tactorch.viz.contact import contact_patches, cut_triangles
from tactorch.viz.figure import CONTACT, MODULUS_LABEL, new_grid
from tactorch.viz.lump_surfaces import LumpSurfaces, Surface, lump_surfaces
from tactorch.viz.slicing import AXES, IN_PLANE, Slice, colour_scale, slices_at

_PANEL_INCHES = 2.3
_PIXELS = 160
_BEST, _RANGE = ("white", 1.3, "-"), ("white", 0.8, ":")  # colour, width and style of outlines


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
        if values is not None and values.shape != (mesh.n_tets,):
            raise TactorchError(
                f"{name}: shape {values.shape} for a mesh of {mesh.n_tets} tetrahedra."
            )
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
            axes.imshow(
                pixels, extent=piece.extent_mm, origin="lower", interpolation="nearest",
                cmap=cmap, norm=norm,
            )  # fmt: skip
            if name == result.name:
                _outline(axes, piece, lumps)
            for patch in patches:
                segments = cut_triangles(mesh.points, patch.triangles, *_plane(piece))
                axes.add_collection(LineCollection(list(segments), colors=CONTACT, linewidths=2.5))
            _label(axes, piece, name if axes is row[0] else "", name == last)
    figure.colorbar(ScalarMappable(norm, cmap), ax=grid, label=MODULUS_LABEL, shrink=0.8)
    if result.reasons:
        figure.suptitle("Do not trust this result: see its summary", color="firebrick", fontsize=10)
    return figure


def _field(piece: Slice, result: Reconstruction) -> Float[np.ma.MaskedArray, "r c"]:
    """Modulus of a result at the pixels of a slice, masked outside the body."""
    if result.shapes is None:
        return piece.values(result.youngs)
    across, up = IN_PLANE[piece.axis]
    horizontal, vertical = piece.centres_mm()
    points = np.empty((len(vertical), len(horizontal), 3))
    points[..., piece.axis] = piece.position_mm
    points[..., across], points[..., up] = horizontal, vertical[:, None]
    values = result.youngs_at(points.reshape(-1, 3)).reshape(points.shape[:2])
    return np.ma.masked_where(piece.elements < 0, values)


def _plane(piece: Slice) -> tuple[int, float]:
    return piece.axis, piece.position_mm


def _outline(axes: Axes, piece: Slice, lumps: Sequence[LumpSurfaces]) -> None:
    """Draw the boundaries of inclusions, and of what is inside with 95 % and 5 %."""
    for lump in lumps:
        for surface, style in ((lump.best, _BEST), (lump.inner, _RANGE), (lump.outer, _RANGE)):
            if surface is not None:
                _draw_surface(axes, piece, surface, *style)


def _draw_surface(
    axes: Axes, piece: Slice, surface: Surface, colour: str, width: float, style: str
) -> None:
    segments = list(cut_triangles(surface.points, surface.triangles, *_plane(piece)))
    axes.add_collection(
        LineCollection(segments, colors=colour, linewidths=width, linestyles=style, zorder=3)
    )


def _label(axes: Axes, piece: Slice, name: str, last: bool) -> None:
    across, up = IN_PLANE[piece.axis]
    axes.set_title(f"{AXES[piece.axis]} = {piece.position_mm:.2f} mm", fontsize=8)
    axes.tick_params(labelsize=7)
    if last:
        axes.set_xlabel(f"{AXES[across]} (mm)", fontsize=8)
    axes.set_ylabel(f"{name}\n{AXES[up]} (mm)" if name else f"{AXES[up]} (mm)", fontsize=8)
