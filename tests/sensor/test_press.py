"""A gel pressed on a cube, in one simulation of both: the press that the gel tells is that made."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tactorch.errors import ConfigError
from tactorch.mesh import TetMesh
from tactorch.sensor.contact import ContactOptions, build_press, facing_triangles
from tactorch.sensor.gel import GelContact

from .gel_on_cube import FIRST, Pair, pressed, sensor_pose

DEPTH = 0.6
NOW = sensor_pose(10.0 - DEPTH)


@pytest.fixture(scope="module")
def pair() -> Pair:
    return pressed(DEPTH)


@pytest.fixture(scope="module")
def contact(pair: Pair) -> GelContact:
    return pair.model.forces(pair.u_gel)


def everywhere(contact: GelContact) -> np.ndarray:
    return np.ones(len(contact.points), dtype=bool)


def test_the_press_is_that_which_was_made(pair: Pair, contact: GelContact) -> None:
    press = build_press(contact, NOW, FIRST, pair.cube, everywhere(contact), fixed=pair.bottom)
    assert contact.total[2] < -0.5  # N, into the sensor
    np.testing.assert_allclose(press.total_force, pair.on_cube.sum(axis=0), atol=1e-6)
    np.testing.assert_allclose(press.forces, pair.on_cube, atol=1e-6)
    seen = press.observed.all(axis=1)
    assert seen[pair.cube.points[:, 2] > 9.999].mean() > 0.95
    np.testing.assert_allclose(press.displacement[seen], pair.u_cube[seen], atol=1e-6)
    np.testing.assert_allclose(press.direction, (0, 0, -1))


def test_frames_do_not_matter(pair: Pair, contact: GelContact) -> None:
    """The whole scene rotated and moved: so are forces and displacements."""
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_euler("xyz", (30, -50, 110), degrees=True).as_matrix()
    turn[:3, 3] = (20.0, -7.0, 3.0)
    Q = turn[:3, :3]
    elsewhere = TetMesh(pair.cube.points @ Q.T + turn[:3, 3], pair.cube.tets)
    here = build_press(contact, NOW, FIRST, pair.cube, everywhere(contact), fixed=pair.bottom)
    there = build_press(
        contact, turn @ NOW, turn @ FIRST, elsewhere, everywhere(contact), fixed=pair.bottom
    )
    np.testing.assert_allclose(there.forces, here.forces @ Q.T, atol=1e-9)
    seen = here.observed.all(axis=1) & there.observed.all(axis=1)
    assert seen.sum() >= 0.95 * here.observed.all(axis=1).sum()
    np.testing.assert_allclose(there.displacement[seen], here.displacement[seen] @ Q.T, atol=1e-6)


def test_partial_contact(pair: Pair, contact: GelContact) -> None:
    """What is not touched bears no force and is not seen, or moves with the sensor."""
    left = contact.points[:, 1] < 0.1  # the sensor's y is the cube's x
    fields = {"fixed": pair.bottom}
    unseen = build_press(contact, NOW, FIRST, pair.cube, left, **fields)
    right = pair.cube.points[:, 0] > 5.6
    assert not unseen.observed[right].any()
    assert (unseen.forces[pair.cube.points[:, 0] > 6.1] == 0).all()
    np.testing.assert_allclose(
        unseen.total_force[2], -contact.forces[left, 2].sum() * -1, atol=1e-9
    )
    cube = build_press(
        contact, NOW, FIRST, pair.cube, left, options=ContactOptions(untouched="sensor"), **fields
    )
    top = (pair.cube.points[:, 2] > 9.999) & (pair.cube.points[:, 0] > 5.6)
    moved = cube.displacement[top & cube.observed.all(axis=1)]
    assert len(moved) > 20
    np.testing.assert_allclose(moved, np.tile((0.0, 0.0, -DEPTH), (len(moved), 1)), atol=1e-9)


def test_what_cannot_be_a_press(pair: Pair, contact: GelContact) -> None:
    all_ = everywhere(contact)
    with pytest.raises(ConfigError, match="touches nothing in this frame"):
        build_press(contact, NOW, FIRST, pair.cube, ~all_)
    with pytest.raises(ConfigError, match=r"the nearest is 30 mm away; check T_object_sensor"):
        facing_triangles(pair.cube, sensor_pose(40.0), contact, 3.0)
    with pytest.raises(ConfigError, match="over no part of the object"):
        facing_triangles(
            pair.cube, FIRST @ np.diag([1.0, -1.0, -1.0, 1.0]), contact, 3.0
        )  # looks up
    with pytest.raises(ConfigError, match="first pose mirrors"):
        build_press(contact, NOW, np.diag([1.0, 1.0, -1.0, 1.0]), pair.cube, all_)
    with pytest.raises(ConfigError, match="untouched='gone'"):
        ContactOptions(untouched="gone")
    with pytest.raises(ConfigError, match="reach_mm=0"):
        ContactOptions(reach_mm=0.0)


def test_depth_alone_is_a_press_whose_other_components_are_unknown(
    pair: Pair, contact: GelContact
) -> None:
    """Normal forces, and displacements along the sensor's axis as readings of the surface."""
    forces, moved = contact.forces.copy(), contact.displacement.copy()
    forces[:, :2] = moved[:, :2] = np.nan
    alone = GelContact(contact.points, moved, forces)
    with pytest.raises(ConfigError, match="noise_mm is needed"):
        build_press(alone, NOW, FIRST, pair.cube, everywhere(contact), fixed=pair.bottom)
    press = build_press(
        alone, NOW, FIRST, pair.cube, everywhere(contact), fixed=pair.bottom, noise_mm=0.01
    )
    assert not press.observed.any()
    assert not press.forces[:, :2].any()
    np.testing.assert_allclose(press.total_force[2], pair.on_cube[:, 2].sum(), atol=1e-6)
    assert press.surface is not None
    np.testing.assert_allclose(press.surface.directions, np.tile((0, 0, -1), (121, 1)), atol=1e-12)
    nodes = np.array([np.flatnonzero((pair.cube.points == p).all(axis=1))[0]
                      for p in press.surface.points_mm])  # fmt: skip
    np.testing.assert_allclose(press.surface.displacement_mm, -pair.u_cube[nodes, 2], atol=1e-6)
    assert (press.surface.deviations_mm == 0.01).all()
