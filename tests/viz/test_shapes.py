"""Slices of shapes beside the map."""

import numpy as np
import pytest

from tactorch.errors import TactorchError
from tactorch.inverse.fields import BALL, ShapeField, ShapePrior
from tactorch.inverse.shapes import ShapeReconstruction
from tactorch.inverse.shapes.posterior import ShapePosterior
from tactorch.mesh import box_mesh
from tactorch.viz import shape_figure

MESH = box_mesh(10.0, 3, tets_per_cell=5)
FIELD = ShapeField(ShapePrior.of(MESH, 0.2), (BALL,))


@pytest.fixture
def shapes():
    z = FIELD.standard(np.array([np.log(0.2), 3.0, 5.0, 6.0, np.log(2.0), np.log(5.0)]))
    return ShapeReconstruction(FIELD, z, posterior(FIELD, z), 1.0, (50.0,), 50.0)


def posterior(field, z):
    return ShapePosterior(field, z, np.zeros(len(z)), 1e-4 * np.eye(len(z)))


def test_boundaries_are_sharp_and_where_they_are(shapes):
    figure = shape_figure(MESH, shapes)
    panels = [axes for axes in figure.axes if axes.images]
    assert [axes.get_title() for axes in panels] == ["x = 3.00 mm", "y = 5.00 mm", "z = 6.00 mm"]
    for axes in panels:
        pixels = np.asarray(axes.images[0].get_array())
        np.testing.assert_allclose(np.unique(np.round(pixels, 9)), [0.2, 1.0])
        area = float((pixels > 0.5).mean()) * 100.0
        assert area == pytest.approx(np.pi * 2.0**2, rel=0.03)
    down = np.asarray(panels[1].images[0].get_array())  # across y: x to the right, z up
    rows, columns = np.nonzero(down > 0.5)
    assert (columns.mean() + 0.5) / down.shape[1] == pytest.approx(0.3, abs=0.01)
    assert (rows.mean() + 0.5) / down.shape[0] == pytest.approx(0.6, abs=0.01)


def test_map_and_truth_are_rows(shapes):
    youngs, truth = np.full(MESH.n_tets, 0.3), np.full(MESH.n_tets, 0.4)
    figure = shape_figure(MESH, shapes, youngs=youngs, truth=truth)
    panels = [axes for axes in figure.axes if axes.images]
    labels = [axes.get_ylabel().split("\n")[0] for axes in panels[::3]]
    assert labels == ["map by element", "shapes", "truth by element"]
    assert float(panels[0].images[0].get_array().max()) == pytest.approx(0.3)
    assert float(panels[6].images[0].get_array().min()) == pytest.approx(0.4)


def test_without_inclusions_the_middle_is_shown():
    field = ShapeField(ShapePrior.of(MESH, 0.2))
    z = np.zeros(1)
    result = ShapeReconstruction(field, z, posterior(field, z), 1.0, (), 0.0)
    titles = [axes.get_title() for axes in shape_figure(MESH, result).axes if axes.images]
    assert titles == ["x = 5.00 mm", "y = 5.00 mm", "z = 5.00 mm"]


def test_values_of_another_mesh_are_refused(shapes):
    with pytest.raises(TactorchError, match="map: shape"):
        shape_figure(MESH, shapes, youngs=np.ones(3))
