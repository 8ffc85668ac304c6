"""Objects in three dimensions, for PyVista. Lengths are in mm."""

import os
import sys
import warnings
from functools import singledispatch
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from tactorch.errors import ConfigError
from tactorch.files import atomic_path
from tactorch.inverse import Reconstruction, ShapeReconstruction
from tactorch.mesh import TetMesh
from tactorch.phantoms import Phantom
from tactorch.progress import in_notebook
from tactorch.recording import Recording
from tactorch.viz.figure import BLUE, MODULUS_LABEL, VERMILION
from tactorch.viz.lump_surfaces import lump_surfaces

if TYPE_CHECKING:
    import pyvista

_YOUNGS = "youngs_mpa"
_SAMPLES = 3  # of the modulus of a phantom along an edge of an element
_ARROW = 0.1  # longest arrow, over the diagonal of the body
_MIN_FORCE = 0.05  # of the nodes with an arrow, over the largest
_BODY, _STIFF, _SOFT = "lightsteelblue", VERMILION, BLUE


def _pyvista() -> ModuleType:
    try:
        with warnings.catch_warnings():  # in notebooks without widgets, which it does not need
            warnings.filterwarnings("ignore", message="IProgress not found")
            import pyvista
    except ImportError as error:
        raise ConfigError(
            f"Views in 3-D need PyVista, which does not load: {error}. Install it by: pip install "
            "pyvista"
        ) from error
    return pyvista


@singledispatch
def to_pyvista(thing: object) -> Any:
    """Return an object for PyVista.

    A mesh, a recording, a phantom (meshed with its default edge length) and a reconstruction are an
    `UnstructuredGrid`: `youngs_mpa`, `truth_mpa` and `region` for each element, and the
    `displacement_0_mm` and `force_0_n` of each press for each node. The
    inclusions of a `ShapeReconstruction` are a `MultiBlock` of closed surfaces with their
    `youngs_mpa`.

    Raises:
        ConfigError: PyVista is not installed.
        TypeError: the object has no view.
    """
    raise TypeError(f"{type(thing).__name__} has no view in 3-D.")


@to_pyvista.register(TetMesh)
def _(mesh: TetMesh) -> "pyvista.UnstructuredGrid":
    pyvista = _pyvista()
    grid = pyvista.UnstructuredGrid({pyvista.CellType.TETRA: mesh.tets}, mesh.points)
    if mesh.regions is not None:
        grid.cell_data["region"] = mesh.regions
    return grid


@to_pyvista.register(Recording)
def _(recording: Recording) -> "pyvista.UnstructuredGrid":
    grid = to_pyvista(recording.mesh)
    if recording.truth is not None:
        grid.cell_data["truth_mpa"] = recording.truth
    for number, press in enumerate(recording.presses):
        if press.observed.any() or press.forces.any():
            grid.point_data[f"displacement_{number}_mm"] = press.displacement
            grid.point_data[f"force_{number}_n"] = press.forces
    return grid


@to_pyvista.register(Reconstruction)
def _(result: Reconstruction) -> "pyvista.UnstructuredGrid":
    grid = to_pyvista(result.mesh)
    grid.cell_data[_YOUNGS] = result.youngs
    for number, displacement in enumerate(result.displacements):
        grid.point_data[f"displacement_{number}_mm"] = displacement
    return grid


@to_pyvista.register(Phantom)
def _(phantom: Phantom) -> "pyvista.UnstructuredGrid":
    mesh = phantom.mesh()
    grid = to_pyvista(mesh)
    grid.cell_data[_YOUNGS] = phantom.on_mesh(mesh, _SAMPLES)
    return grid


@to_pyvista.register(ShapeReconstruction)
def _(shapes: ShapeReconstruction) -> "pyvista.MultiBlock":
    blocks = _pyvista().MultiBlock()
    for number, lump in enumerate(lump_surfaces(shapes), 1):
        surface = _surface(*lump.best)
        surface.cell_data[_YOUNGS] = np.full(surface.n_cells, lump.youngs_mpa)
        blocks.append(surface, f"lump {number}")
    return blocks


def _surface(points: np.ndarray, triangles: np.ndarray) -> "pyvista.PolyData":
    surface: pyvista.PolyData = _pyvista().PolyData.from_regular_faces(points, triangles)
    return surface


def show(thing: object, screenshot: str | Path | None, **options: Any) -> None:
    """Show an object in a window or in a notebook, or write a picture; see `Displayed.show`."""
    pyvista = _pyvista()
    if screenshot is None and not in_notebook() and not _has_windows():
        raise ConfigError(
            "There is no window system. Give screenshot='view.png', or use plot() for a figure."
        )
    plotter = pyvista.Plotter(off_screen=screenshot is not None)
    draw(thing, plotter)
    plotter.add_axes()
    plotter.show_bounds(
        location="outer", xtitle="x (mm)", ytitle="y (mm)", ztitle="z (mm)", n_xlabels=3,
        n_ylabels=3, n_zlabels=3,
    )  # fmt: skip
    if screenshot is None:
        plotter.show(**options)
        return
    with atomic_path(Path(screenshot)) as temporary:
        plotter.screenshot(str(temporary))
    plotter.close()


def _has_windows() -> bool:
    if sys.platform != "linux":
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def _draw_half(thing: object, plotter: "pyvista.Plotter") -> None:
    """Draw the modulus of the half of a body behind a cut."""
    grid = to_pyvista(thing)
    outline = grid.extract_surface(algorithm="dataset_surface")
    plotter.add_mesh(outline, color=_BODY, opacity=0.15)
    half = grid.clip("y", crinkle=True)
    plotter.add_mesh(
        half, scalars=_YOUNGS, lighting=False, scalar_bar_args={"title": MODULUS_LABEL}
    )


#: Adds an object to a plotter.
draw = singledispatch(_draw_half)


@draw.register(TetMesh)
def _(mesh: TetMesh, plotter: "pyvista.Plotter") -> None:
    surface, scalars = _surface(mesh.points, mesh.surface.triangles), None
    if mesh.regions is not None:
        surface.cell_data["region"], scalars = mesh.regions[mesh.surface.owners], "region"
    plotter.add_mesh(surface, show_edges=True, color=_BODY, scalars=scalars)


@draw.register(Recording)
def _(recording: Recording, plotter: "pyvista.Plotter") -> None:
    pyvista, mesh = _pyvista(), recording.mesh
    surface = _surface(mesh.points, mesh.surface.triangles)
    plotter.add_mesh(surface, show_edges=True, color=_BODY, opacity=0.6)
    forces = np.sum([press.forces for press in recording.presses], axis=0)
    sizes = np.linalg.norm(forces, axis=1)
    pressed = sizes > _MIN_FORCE * sizes.max(initial=0.0)
    if pressed.any():
        vectors = forces[pressed] * (_ARROW * mesh.diagonal / sizes.max())
        arrows = pyvista.PolyData(mesh.points[pressed] - vectors)
        arrows["force"] = vectors
        plotter.add_mesh(arrows.glyph(orient="force", scale="force"), color=_STIFF)
    probes = [press.probe for press in recording.presses if press.probe is not None]
    if probes:
        plotter.add_points(np.array([probe.position_mm for probe in probes]), color=_STIFF)


@draw.register(Reconstruction)
def _(result: Reconstruction, plotter: "pyvista.Plotter") -> None:
    if result.shapes is None:
        _draw_half(result, plotter)
        return
    surface = _surface(result.mesh.points, result.mesh.surface.triangles)
    plotter.add_mesh(surface, color=_BODY, opacity=0.15)
    _draw_lumps(plotter, to_pyvista(result.shapes), result.background_mpa)


@draw.register(ShapeReconstruction)
def _(shapes: ShapeReconstruction, plotter: "pyvista.Plotter") -> None:
    low, high = shapes.field.prior.low_mm, shapes.field.prior.high_mm
    box = np.stack([low, high], axis=1).ravel()
    plotter.add_mesh(_pyvista().Box(bounds=box), style="wireframe", color="grey")
    _draw_lumps(plotter, to_pyvista(shapes), shapes.background_mpa)


def _draw_lumps(
    plotter: "pyvista.Plotter", lumps: "pyvista.MultiBlock", background_mpa: float
) -> None:
    for lump in lumps:
        is_stiff = float(lump.cell_data[_YOUNGS][0]) > background_mpa
        plotter.add_mesh(lump, color=_STIFF if is_stiff else _SOFT)
