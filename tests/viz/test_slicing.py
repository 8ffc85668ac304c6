import numpy as np
import pytest

from tactorch.mesh import TetMesh, compact
from tactorch.viz.slicing import IN_PLANE, slice_body

CENTRE, RADIUS = np.array([14.0, 6.0, 12.0]), 4.0


def test_planes_are_evenly_spaced_and_off_the_surface(cube: TetMesh) -> None:
    for axis, row in enumerate(slice_body(cube, 5, 10)):
        assert [piece.axis for piece in row] == [axis] * 5
        np.testing.assert_allclose([piece.position_mm for piece in row], [2, 6, 10, 14, 18])
        assert all(piece.extent_mm == (0.0, 20.0, 0.0, 20.0) for piece in row)


def test_inclusion_appears_where_it_is(cube: TetMesh, sphere_map: np.ndarray) -> None:
    element = np.sqrt(3) * 2.5  # a sphere's surface is known to within one cell's diagonal
    seen = 0
    for row in slice_body(cube, 5, 40):
        for piece in row:
            across, up = IN_PLANE[piece.axis]
            h, v = np.meshgrid(*piece.centres_mm())
            away = (h - CENTRE[across]) ** 2 + (v - CENTRE[up]) ** 2
            away = np.sqrt(away + (piece.position_mm - CENTRE[piece.axis]) ** 2)
            values = piece.values(sphere_map)
            assert not values.mask.any()
            assert (values[away > RADIUS + element] == 0.2).all()
            seen += int((values[away < RADIUS / 4] == 1.0).sum())
            assert (values[away < RADIUS - element + 1.0] == 1.0).all()
    assert seen > 10


def test_outside_the_body_is_masked(cube: TetMesh) -> None:
    # Cut one corner off: x > 10, y > 10, z > 10.
    kept = ~(cube.centroids > 10.0).all(axis=1)
    points, tets, _ = compact(cube.points, cube.tets[kept])
    body = TetMesh(points, tets)
    values = np.ones(body.n_tets)
    (_, above), _, _ = slice_body(body, 2, 20)
    h, v = np.meshgrid(*above.centres_mm())
    np.testing.assert_array_equal(above.values(values).mask, (h > 10.0) & (v > 10.0))


def test_long_bodies_get_square_pixels(cube: TetMesh) -> None:
    body = TetMesh(cube.points * [1.0, 0.5, 0.25], cube.tets)
    slices = slice_body(body, 1, 40)
    assert [row[0].elements.shape for row in slices] == [(10, 20), (10, 40), (20, 40)]


def test_plane_through_the_nodes_shows_elements_of_one_side(cube: TetMesh) -> None:
    ((piece,), _, _) = slice_body(cube, 1, 40)
    assert piece.position_mm == pytest.approx(10.0)
    assert (cube.centroids[piece.elements.ravel(), 0] > 10.0).all()
