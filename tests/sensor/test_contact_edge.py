"""Distances from the edge of a contact, in an image and by the outline of the object."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactorch.mesh import box_mesh
from tactorch.sensor.contact_edge import common_edge, image_edge, surface_edge
from tactorch.sensor.description import GelLayer, SensorDescription

SENSOR = SensorDescription("s", (120, 100), (0.1, 0.1), GelLayer(2.0, 0.1, 0.45, (14.0, 12.0)))
CORNERS = np.array([(-6.0, -6.0, 0.0), (6.0, -6.0, 0.0), (6.0, 6.0, 0.0), (-6.0, 6.0, 0.0)])


def disc(radius_mm: float) -> np.ndarray:
    rows, columns = np.indices(SENSOR.shape)
    at = SENSOR.to_mm(np.stack([columns, rows], axis=-1).reshape(-1, 2).astype(float))
    return (np.linalg.norm(at, axis=1) < radius_mm).reshape(SENSOR.shape)


def test_image_edge_is_that_of_a_disc_to_half_a_pixel() -> None:
    distance = image_edge(SENSOR, disc(3.0), CORNERS, np.zeros((4, 3)))
    points = np.array([(0.0, 0.0), (2.0, 0.0), (3.0, 0.0), (0.0, -4.0), (2.5, 2.5)])
    expected = 3.0 - np.linalg.norm(points, axis=1)
    np.testing.assert_allclose(distance(points), expected, atol=0.12)


def test_image_edge_follows_the_material_and_the_margin() -> None:
    moved = np.zeros((4, 3))
    moved[:, 0] = 0.5  # the image shows points of the gel where they have moved
    still = image_edge(SENSOR, disc(3.0), CORNERS, np.zeros((4, 3)))
    distance = image_edge(SENSOR, disc(3.0), CORNERS, moved, margin_mm=0.2)
    points = np.array([(1.0, 0.5), (-3.5, 0.0), (2.5, 1.0)])
    np.testing.assert_allclose(
        distance(points), still(points + np.array([0.5, 0.0])) + 0.2, atol=1e-9
    )


@given(st.floats(-8.0, 8.0), st.floats(-8.0, 8.0))
def test_surface_edge_is_the_distance_from_the_outline_of_a_box(x: float, y: float) -> None:
    mesh = box_mesh((6.0, 4.0, 2.0), (3, 4, 1), center_mm=(0.0, 0.0, 0.0))
    surface = mesh.surface
    distance = surface_edge(mesh.points, surface.triangles[surface.normals[:, 2] > 0.5])
    inside = np.array([3.0 - abs(x), 2.0 - abs(y)])
    expected = inside.min() if (inside > 0).all() else -np.linalg.norm(np.minimum(inside, 0.0))
    assert distance(np.array([(x, y)]))[0] == pytest.approx(expected, abs=1e-9)


def test_common_edge_is_the_nearer_one() -> None:
    mesh = box_mesh((6.0, 4.0, 2.0), 2, center_mm=(2.0, 0.0, 0.0))
    surface = mesh.surface
    box = surface_edge(mesh.points, surface.triangles[surface.normals[:, 2] > 0.5])
    both = common_edge(box, image_edge(SENSOR, disc(3.0), CORNERS, np.zeros((4, 3))))
    points = np.array([(-0.8, 0.0), (2.6, 0.0), (4.0, 0.0)])
    np.testing.assert_allclose(both(points), [0.2, 0.4, -1.0], atol=0.07)
