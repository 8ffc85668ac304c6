"""What the camera sees of a deformed gel."""

import numpy as np

from tactorch.sensor.description import GelLayer, MarkerGrid, SensorDescription
from tactorch.sensor.render import RenderOptions
from tactorch.touch.simulate import draw_gel


def test_markers_beyond_the_nodes_move_with_the_nearest() -> None:
    grid = MarkerGrid(5, 4, (2.0, 2.0), 0.6)
    gel = GelLayer(2.0, 0.2, 0.45, size_mm=(11.0, 9.0))
    sensor = SensorDescription("small", (40, 32), (0.25, 0.25), gel, grid)
    axis = np.linspace(-2.0, 2.0, 5)
    x, y = (a.ravel() for a in np.meshgrid(axis, axis))
    points, shift = np.column_stack([x, y, np.zeros(25)]), np.array([0.4, -0.3, 0.0])
    _, _, markers, _ = draw_gel(sensor, points, np.tile(shift, (25, 1)), RenderOptions(), 0)
    assert np.abs(grid.positions_mm).max() > 2.0
    np.testing.assert_allclose(markers, sensor.to_px(grid.positions_mm + shift[:2]))
