"""A gel pressed on a cube, in one simulation of both: the press that the gel tells is that made.

Gel and cube share the nodes where they touch, which is contact without slip.
"""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tactorch.errors import ConfigError
from tactorch.fem import SoftBody, Supports, make_material
from tactorch.mesh import TetMesh, box_mesh
from tactorch.sensor.contact import Touching, facing, press_of
from tactorch.sensor.description import GelLayer
from tactorch.sensor.gel import Contact, GelModel

GEL = GelLayer(4.0, 0.12, 0.45, size_mm=(10.0, 10.0))
DEPTH = 0.6


@dataclass
class Pair:
    """Both bodies in equilibrium, the gel's window pushed down by DEPTH."""

    cube: TetMesh
    u_cube: np.ndarray
    on_cube: np.ndarray  # forces of the gel on the cube's nodes
    bottom: np.ndarray
    model: GelModel
    u_gel: np.ndarray  # of its face's nodes, in the sensor's frame, against its window


def sensor_pose(z_mm: float) -> np.ndarray:
    """Looking down on the cube's top: x along y, y along x, z down."""
    pose = np.eye(4)
    pose[:3, :3] = [(0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, -1.0)]
    pose[:3, 3] = (5.0, 5.0, z_mm)
    return pose


FIRST, NOW = sensor_pose(10.0), sensor_pose(10.0 - DEPTH)


@pytest.fixture(scope="module")
def pair() -> Pair:
    model = GelModel(GEL, 1.0, 3, "tet4")
    cube = box_mesh(10.0, 10)
    above = model.meshed.mesh.points @ FIRST[:3, :3].T + FIRST[:3, 3]
    top = np.flatnonzero(cube.points[:, 2] > 9.999)
    face = model.meshed.face
    twin = {tuple(np.round(cube.points[i], 6)): i for i in top}
    number = np.arange(len(above)) + cube.n_points
    number[face] = [twin[tuple(np.round(above[i], 6))] for i in face]
    kept = np.setdiff1d(np.arange(len(above)), face)
    number[kept] = cube.n_points + np.arange(len(kept))
    both = TetMesh.create(
        np.concatenate([cube.points, above[kept]]),
        np.concatenate([cube.tets, number[model.meshed.mesh.tets]]),
    )
    youngs = np.full(both.n_tets, 0.2)
    youngs[cube.n_tets :] = 0.12
    hard = np.linalg.norm(cube.centroids - (6.0, 5.0, 7.0), axis=1) < 2.0
    youngs[: cube.n_tets][hard] = 1.0
    fixed, prescribed = np.zeros(both.points.shape, dtype=bool), np.zeros(both.points.shape)
    fixed[both.points[:, 2] < 1e-9] = True
    window = number[model.meshed.window]
    fixed[window] = True
    prescribed[window] = (0.0, 0.0, -DEPTH)
    body = SoftBody(both, make_material("neo_hookean", 0.45))
    still = np.zeros(both.points.shape)
    u = body.equilibrate(youngs, still, Supports(fixed, prescribed)).require().displacement
    alone = SoftBody(cube, make_material("neo_hookean", 0.45))
    bottom = fixed[: cube.n_points]
    own = Supports(bottom | (cube.points[:, 2:] > 9.999), u[: cube.n_points])
    found = alone.equilibrate(youngs[: cube.n_tets], still[: cube.n_points], own).require()
    inner = alone.assembly.internal_force(found.response, youngs[: cube.n_tets])
    on_cube = np.where(cube.points[:, 2:] > 9.999, inner, 0.0)
    u_gel = (u[number[face]] + (0.0, 0.0, DEPTH)) @ FIRST[:3, :3]
    return Pair(cube, u[: cube.n_points], on_cube, bottom, model, u_gel)


@pytest.fixture(scope="module")
def contact(pair: Pair) -> Contact:
    return pair.model.forces(pair.u_gel)


def everywhere(contact: Contact) -> np.ndarray:
    return np.ones(len(contact.points), dtype=bool)


def test_the_press_is_that_which_was_made(pair: Pair, contact: Contact) -> None:
    press = press_of(contact, NOW, FIRST, pair.cube, everywhere(contact), fixed=pair.bottom)
    assert contact.total[2] < -0.5  # N, into the sensor
    np.testing.assert_allclose(press.total_force, pair.on_cube.sum(axis=0), atol=1e-6)
    np.testing.assert_allclose(press.forces, pair.on_cube, atol=1e-6)
    seen = press.observed.all(axis=1)
    assert seen[pair.cube.points[:, 2] > 9.999].mean() > 0.95
    np.testing.assert_allclose(press.displacement[seen], pair.u_cube[seen], atol=1e-6)
    np.testing.assert_allclose(press.direction, (0, 0, -1))


def test_frames_do_not_matter(pair: Pair, contact: Contact) -> None:
    """The whole scene turned and moved: so are forces and displacements."""
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_euler("xyz", (30, -50, 110), degrees=True).as_matrix()
    turn[:3, 3] = (20.0, -7.0, 3.0)
    Q = turn[:3, :3]
    elsewhere = TetMesh(pair.cube.points @ Q.T + turn[:3, 3], pair.cube.tets)
    here = press_of(contact, NOW, FIRST, pair.cube, everywhere(contact), fixed=pair.bottom)
    there = press_of(
        contact, turn @ NOW, turn @ FIRST, elsewhere, everywhere(contact), fixed=pair.bottom
    )
    np.testing.assert_allclose(there.forces, here.forces @ Q.T, atol=1e-9)
    seen = here.observed.all(axis=1) & there.observed.all(axis=1)
    assert seen.sum() >= 0.95 * here.observed.all(axis=1).sum()
    np.testing.assert_allclose(there.displacement[seen], here.displacement[seen] @ Q.T, atol=1e-6)


def test_partial_contact(pair: Pair, contact: Contact) -> None:
    """What is not touched bears no force and is not seen, or moves with the sensor."""
    left = contact.points[:, 1] < 0.1  # the sensor's y is the cube's x
    fields = {"fixed": pair.bottom}
    unseen = press_of(contact, NOW, FIRST, pair.cube, left, **fields)
    right = pair.cube.points[:, 0] > 5.6
    assert not unseen.observed[right].any()
    assert (unseen.forces[pair.cube.points[:, 0] > 6.1] == 0).all()
    np.testing.assert_allclose(
        unseen.total_force[2], -contact.forces[left, 2].sum() * -1, atol=1e-9
    )
    cube = press_of(
        contact, NOW, FIRST, pair.cube, left, touching=Touching(untouched="sensor"), **fields
    )
    top = (pair.cube.points[:, 2] > 9.999) & (pair.cube.points[:, 0] > 5.6)
    moved = cube.displacement[top & cube.observed.all(axis=1)]
    assert len(moved) > 20
    np.testing.assert_allclose(moved, np.tile((0.0, 0.0, -DEPTH), (len(moved), 1)), atol=1e-9)


def test_what_cannot_be_a_press(pair: Pair, contact: Contact) -> None:
    all_ = everywhere(contact)
    with pytest.raises(ConfigError, match="touches nothing in this frame"):
        press_of(contact, NOW, FIRST, pair.cube, ~all_)
    with pytest.raises(ConfigError, match=r"the nearest is 30 mm away; check T_object_sensor"):
        facing(pair.cube, sensor_pose(40.0), contact, 3.0)
    with pytest.raises(ConfigError, match="over no part of the object"):
        facing(pair.cube, FIRST @ np.diag([1.0, -1.0, -1.0, 1.0]), contact, 3.0)  # looks up
    with pytest.raises(ConfigError, match="first pose mirrors"):
        press_of(contact, NOW, np.diag([1.0, 1.0, -1.0, 1.0]), pair.cube, all_)
    with pytest.raises(ConfigError, match="untouched='gone'"):
        Touching(untouched="gone")
    with pytest.raises(ConfigError, match="reach_mm=0"):
        Touching(reach_mm=0.0)
