"""Text and pictures of objects in notebooks and scripts."""

import io
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.image import imread

from tactorch import PressPlan, make_phantom, simulate
from tactorch.display import Displayed
from tactorch.errors import ConfigError
from tactorch.fem.contact import Ball
from tactorch.inverse import Reconstruction, ShapeReconstruction
from tactorch.inverse.fields import BALL, ShapeField, ShapePrior
from tactorch.inverse.posterior.shapes import ShapePosterior
from tactorch.mesh import TetMesh, box_mesh
from tactorch.phantoms import Phantom
from tactorch.recording import ForceReading, MaterialSpec, Press, ProbePose, Recording
from tactorch.viz import convergence_figure
from tactorch.viz.figures import make_figure, surface_figure

HISTORY = [
    {"iteration": i, "seconds": float(i), "misfit": 10.0**-i, "chi2": 4.0 - i} for i in range(3)
]


@pytest.fixture(scope="module")
def mesh() -> TetMesh:
    return box_mesh(10.0, 4)


@pytest.fixture(scope="module")
def phantom() -> Phantom:
    return make_phantom("cube_sphere", radius=0.3)


@pytest.fixture(scope="module")
def recording(phantom: Phantom, mesh: TetMesh) -> Recording:
    return simulate(phantom, PressPlan(("z+",), (0.005, 0.01)), mesh=mesh)


@pytest.fixture(scope="module")
def result(recording: Recording, mesh: TetMesh) -> Reconstruction:
    moved = np.stack([press.displacement for press in recording.presses])
    return Reconstruction(mesh, recording.truth, np.nan_to_num(moved), HISTORY, "stopped", 2.0)


@pytest.fixture(scope="module")
def shapes(mesh: TetMesh) -> ShapeReconstruction:
    field = ShapeField(ShapePrior.of(mesh, 0.2), (BALL,))
    z = field.standard(np.array([np.log(0.2), 5.0, 5.0, 6.0, np.log(2.0), np.log(5.0)]))
    posterior = ShapePosterior(field, z, np.zeros(field.size), 1e-4 * np.eye(field.size))
    return ShapeReconstruction(field, z, posterior, 1.0, (9.0,), 9.0)


@pytest.fixture(scope="module")
def probed(mesh: TetMesh) -> Recording:
    base = np.repeat(mesh.points[:, 2:] == 0.0, 3, axis=1)
    presses = [
        Press.by_probe(
            ProbePose(Ball(2.0), np.array([x, 5.0, 12.0 - depth])), mesh.n_points,
            force=ForceReading.along((0.0, 0.0, 1.0), force, 0.01), fixed=base,
        )
        for x, depth, force in ((3.0, 0.2, 0.1), (3.0, 0.4, 0.3), (7.0, 0.3, 0.2))
    ]  # fmt: skip
    return Recording(mesh, tuple(presses), MaterialSpec("neo_hookean", 0.45))


OBJECTS = ("mesh", "phantom", "recording", "probed", "result", "shapes")


@pytest.mark.parametrize("name", OBJECTS)
def test_a_notebook_shows_text_and_picture(name: str, request: pytest.FixtureRequest) -> None:
    thing: Displayed = request.getfixturevalue(name)
    page = thing._repr_html_()
    assert f"<strong>{type(thing).__name__}</strong>" in page
    assert re.search('src="data:image/png;base64,[A-Za-z0-9+/=]{1000,}"', page)
    first = thing.summary().splitlines()[0]
    assert first.replace("&", "&amp;").replace("'", "&#x27;") in page
    assert 1 <= len(repr(thing).splitlines()) < 12
    assert type(thing).__name__ in repr(thing)


@pytest.mark.parametrize("name", OBJECTS)
def test_each_object_has_a_view_in_three_dimensions(
    name: str, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    thing: Displayed = request.getfixturevalue(name)
    thing.show(screenshot=tmp_path / "view.png")
    picture = imread(tmp_path / "view.png")
    assert picture[..., :3].std() > 0.02  # not blank


def test_a_pyvista_that_does_not_load_is_reported(
    mesh: TetMesh, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """It is installed, but a library of the system that it needs is not."""
    (tmp_path / "pyvista.py").write_text("raise ImportError('libGL.so.1: cannot open')")
    monkeypatch.delitem(sys.modules, "pyvista", raising=False)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ConfigError, match=r"Views in 3-D need PyVista.*libGL.so.1"):
        mesh.to_pyvista()


def test_text_in_pages_is_escaped(recording: Recording) -> None:
    material = MaterialSpec("<b>neo_hookean</b>", 0.45)
    changed = Recording(recording.mesh, recording.presses, material)
    assert "<b>" not in changed._repr_html_()


def test_grids_have_the_values_of_elements_and_nodes(
    recording: Recording, result: Reconstruction, phantom: Phantom
) -> None:
    grid = recording.to_pyvista()
    np.testing.assert_array_equal(grid.cell_data["truth_mpa"], recording.truth)
    np.testing.assert_array_equal(grid.points, recording.mesh.points)
    np.testing.assert_array_equal(grid.point_data["force_1_n"], recording.presses[1].forces)
    assert grid.volume == pytest.approx(1000.0)
    np.testing.assert_array_equal(result.to_pyvista().cell_data["youngs_mpa"], result.youngs)
    values = phantom.to_pyvista().cell_data["youngs_mpa"]
    assert values.max() == pytest.approx(1.0)
    assert values.min() == pytest.approx(0.2)


def test_an_inclusion_is_a_closed_surface_of_its_size_and_modulus(
    shapes: ShapeReconstruction,
) -> None:
    (lump,) = shapes.to_pyvista()
    assert lump.volume == pytest.approx(4.0 / 3.0 * np.pi * 8.0, rel=0.02)
    assert lump.center == pytest.approx((5.0, 5.0, 6.0), abs=0.01)
    assert lump.cell_data["youngs_mpa"] == pytest.approx(1.0, rel=5e-3)


def test_the_palpation_figure_shows_the_force_of_the_deepest_press(probed: Recording) -> None:
    axes = probed.plot().axes[0]
    dots = axes.collections[0]
    shown = dict(zip(dots.get_offsets()[:, 0].tolist(), dots.get_array().tolist(), strict=True))
    assert shown == {3.0: 0.3, 7.0: 0.2}
    assert axes.get_xlabel() == "x (mm)"


def test_slices_of_a_phantom_are_of_its_modulus_and_outside_is_empty() -> None:
    phantom = make_phantom("cube_sphere")
    panels = phantom.plot(point_mm=np.array([5.0, 5.0, 5.0])).axes[:3]
    for axes in panels:
        pixels = axes.images[0].get_array()
        assert pixels[60, 60] == 1.0
        assert pixels[2, 2] == 0.2
    figure = phantom.plot(point_mm=np.array([1.0, 5.0, 5.0]))
    assert figure.axes[0].images[0].get_array().max() == 0.2


def test_the_convergence_of_a_result_needs_no_names(result: Reconstruction) -> None:
    (line,) = convergence_figure(result).axes[0].lines
    assert line.get_ydata() == pytest.approx([1.0, 0.1, 0.01])


def test_a_figure_shows_itself_in_a_notebook(result: Reconstruction) -> None:
    picture = imread(io.BytesIO(convergence_figure(result)._repr_png_()))
    assert picture.shape[1] > 500


def test_the_report_of_a_result_is_one_file(
    result: Reconstruction, recording: Recording, tmp_path: Path
) -> None:
    path = result.report(tmp_path / "report.html", recording, uncertainty=False)
    page = path.read_text(encoding="utf-8")
    assert "stopped" in page
    assert "report" in page
    assert [file.name for file in tmp_path.iterdir()] == ["report.html"]
    alone = result.report(tmp_path / "alone.html")
    assert "no recording was given" in alone.read_text(encoding="utf-8")


def test_values_of_a_surface_are_one_for_each_element(mesh: TetMesh) -> None:
    with pytest.raises(ConfigError, match="values: 3 for"):
        surface_figure(mesh, values=np.ones(3))


def test_without_a_window_system_the_remedy_is_named(
    mesh: TetMesh, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    with pytest.raises(ConfigError, match=r"screenshot='view\.png', or use plot\(\)"):
        mesh.show()


def test_other_objects_have_no_figure() -> None:
    with pytest.raises(TypeError, match="dict has no figure"):
        make_figure({})


def test_regions_of_a_mesh_are_shown(mesh: TetMesh) -> None:
    regions = (mesh.centroids[:, 2] > 5.0).astype(int)
    marked: Any = mesh.with_regions(regions)
    assert len(marked.plot().axes) == 2  # with a colour bar
    assert "regions: 0, 1" in marked.summary()
    assert set(marked.to_pyvista().cell_data["region"]) == {0, 1}


def test_an_inclusion_prints_in_two_lines(shapes: ShapeReconstruction) -> None:
    name, line = str(shapes.inclusions[0]).splitlines()
    assert name == "ShapeInclusion"
    assert line == f"  {shapes.inclusions[0].summary()}"
    assert line in str(shapes)
    assert "(5.00, 5.00, 6.00) mm: radius 2 mm [" in line
