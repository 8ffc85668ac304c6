"""Slices of a result by inclusions, beside the element map and the truth."""

from dataclasses import replace

import numpy as np
import pytest

from tactorch.errors import TactorchError
from tactorch.inverse import Reconstruction
from tactorch.inverse.fields import BALL, ShapeField, ShapePrior
from tactorch.inverse.posterior.shapes import ShapePosterior
from tactorch.inverse.result.shapes import ShapeReconstruction
from tactorch.mesh import box_mesh
from tactorch.viz import reconstruction_figure
from tactorch.viz.lump_surfaces import lump_surfaces

MESH = box_mesh(10.0, 3, tets_per_cell=5)
FIELD = ShapeField(ShapePrior.of(MESH, 0.2), (BALL,))
CENTER = np.array([3.0, 5.0, 6.0])


@pytest.fixture
def shapes():
    z = FIELD.standard(np.array([np.log(0.2), *CENTER, np.log(2.0), np.log(5.0)]))
    return ShapeReconstruction(FIELD, z, posterior(FIELD, z), 1.0, (50.0,), 50.0)


def posterior(field, z):
    return ShapePosterior(field, z, np.zeros(len(z)), 1e-4 * np.eye(len(z)))


def result_of(shapes, youngs=0.2):
    moved = np.zeros((0, MESH.n_points, 3))
    return Reconstruction(MESH, np.full(MESH.n_tets, youngs), moved, [], "", 0.0, shapes=shapes)


def test_boundaries_are_sharp_and_where_they_are(shapes):
    figure = reconstruction_figure(result_of(shapes), point_mm=CENTER)
    panels = [axes for axes in figure.axes if axes.images]
    assert [axes.get_title() for axes in panels] == ["x = 3 mm", "y = 5 mm", "z = 6 mm"]
    for axes in panels:
        pixels = np.asarray(axes.images[0].get_array())
        np.testing.assert_allclose(np.unique(np.round(pixels, 9)), [0.2, 1.0], rtol=5e-3)
        area = float((pixels > 0.5).mean()) * 100.0
        assert area == pytest.approx(np.pi * 2.0**2, rel=0.03)
    down = np.asarray(panels[1].images[0].get_array())  # across y: x to the right, z up
    rows, columns = np.nonzero(down > 0.5)
    assert (columns.mean() + 0.5) / down.shape[1] == pytest.approx(0.3, abs=0.01)
    assert (rows.mean() + 0.5) / down.shape[0] == pytest.approx(0.6, abs=0.01)


def test_the_surfaces_are_those_of_the_ball_and_its_interval(shapes):
    (lump,) = lump_surfaces(shapes)
    distances = np.linalg.norm(lump.best.points - CENTER, axis=1)
    np.testing.assert_allclose(distances, 2.0, atol=0.02)
    inner, outer = (np.linalg.norm(s.points - CENTER, axis=1) for s in (lump.inner, lump.outer))
    assert inner.max() < 2.0 < outer.min()
    # Along each axis the boundary has the deviations of centre and radius together.
    spread = 0.01 * np.hypot(FIELD.deviation[1], 2.0 * FIELD.prior.log_radius)
    assert outer.mean() - 2.0 == pytest.approx(1.645 * spread, rel=0.4)
    assert lump.youngs_mpa == pytest.approx(1.0, rel=5e-3)


def test_element_map_and_truth_are_rows(shapes):
    elements, truth = result_of(None, 0.3), np.full(MESH.n_tets, 0.4)
    result = replace(result_of(shapes), other=elements)
    figure = reconstruction_figure(result, truth=truth)
    panels = [axes for axes in figure.axes if axes.images]
    labels = [axes.get_ylabel().split("\n")[0] for axes in panels[::3]]
    assert labels == ["inclusions", "element map", "truth by element"]
    below = [axes.get_xlabel() for axes in panels]
    assert below == 6 * [""] + ["y (mm)", "x (mm)", "x (mm)"]
    assert float(panels[3].images[0].get_array().max()) == pytest.approx(0.3)
    assert float(panels[6].images[0].get_array().min()) == pytest.approx(0.4)


def test_a_result_that_is_not_trusted_says_so(shapes):
    figure = reconstruction_figure(replace(result_of(shapes), reasons=("the forces are wrong",)))
    assert "Do not trust this result" in figure.get_suptitle()
    assert not reconstruction_figure(result_of(shapes)).get_suptitle()


def test_without_lumps_the_middle_is_shown():
    titles = [
        axes.get_title() for axes in reconstruction_figure(result_of(None)).axes if axes.images
    ]
    assert titles == ["x = 5 mm", "y = 5 mm", "z = 5 mm"]


def test_values_of_another_mesh_are_refused(shapes):
    with pytest.raises(TactorchError, match="truth by element: shape"):
        reconstruction_figure(result_of(shapes), truth=np.ones(3))
