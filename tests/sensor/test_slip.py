"""Where a gel slips on the object, which the traction of a contact tells."""

from dataclasses import replace

import numpy as np
import pytest

from tactorch.errors import ConfigError
from tactorch.sensor.contact import ContactOptions, build_press, slipping_nodes
from tactorch.sensor.gel import GelContact, GelErrors

from .gel_on_cube import FIRST, Pair, pressed, sensor_pose

DEPTH, FRICTION = 0.6, 0.4
NOW = sensor_pose(10.0 - DEPTH)


@pytest.mark.parametrize("stuck", [0.3, 0.6, 0.9])
def test_slip_is_the_annulus_of_cattaneo_and_mindlin(stuck: float) -> None:
    """A sphere under a tangential load sticks within `stuck` of the contact's radius.

    K. L. Johnson, Contact Mechanics (1985), equations 7.13 to 7.15.
    """
    at = np.random.default_rng(0).uniform(-1.0, 1.0, (2000, 2))
    away = np.linalg.norm(at, axis=1)
    pressure = np.sqrt(np.maximum(1.0 - away**2, 0.0))
    less = stuck * np.sqrt(np.maximum(1.0 - (away / stuck) ** 2, 0.0))
    traction = np.column_stack([FRICTION * (pressure - less), np.zeros(2000), -pressure])
    slips = slipping_nodes(traction, away < 1.0, FRICTION)
    assert not slips[away >= 1.0].any()
    assert slips[(away > stuck) & (away < 1.0)].all()
    assert not slips[away < 0.9 * stuck].any()
    assert not slipping_nodes(traction, away < 1.0, 1.2 * FRICTION).any()


@pytest.fixture(scope="module")
def pair() -> Pair:
    return pressed(DEPTH)


@pytest.fixture(scope="module")
def contact(pair: Pair) -> GelContact:
    """A contact whose left part is sheared to the limit of friction."""
    found = pair.model.forces(pair.u_gel)
    forces = found.forces.copy()
    left = found.points[:, 1] < 0.1  # the sensor's y is the cube's x
    forces[:, :2] *= 0.01
    forces[left, 0] = FRICTION * -forces[left, 2]
    return replace(found, forces=forces)


def test_where_it_slips_the_object_is_observed_along_the_axis(
    pair: Pair, contact: GelContact
) -> None:
    everywhere = np.ones(len(contact.points), dtype=bool)
    fields = {"fixed": pair.bottom, "noise_mm": 0.01}
    args = (contact, NOW, FIRST, pair.cube, everywhere)
    stuck = build_press(*args, **fields)
    assert stuck.surface is None
    press = build_press(*args, options=ContactOptions(friction=FRICTION), **fields)
    np.testing.assert_array_equal(press.forces, stuck.forces)
    lost = stuck.observed.all(axis=1) & ~press.observed.any(axis=1)
    x = pair.cube.points[:, 0]
    assert x[lost].max() < 5.6
    assert x[press.observed.any(axis=1)].min() > 4.9
    assert press.surface is not None
    np.testing.assert_array_equal(press.surface.points_mm, pair.cube.points[lost])
    np.testing.assert_allclose(press.surface.directions, np.tile((0, 0, -1), (lost.sum(), 1)))
    np.testing.assert_allclose(press.surface.displacement_mm, -stuck.displacement[lost, 2])
    assert (press.surface.deviations_mm == 0.01).all()
    with pytest.raises(ConfigError, match="noise_mm is needed"):
        build_press(*args, options=ContactOptions(friction=FRICTION), fixed=pair.bottom)
    rough = build_press(*args, options=ContactOptions(friction=2 * FRICTION), **fields)
    np.testing.assert_array_equal(rough.observed, stuck.observed)


def test_errors_of_the_displacement_count_in_readings(pair: Pair, contact: GelContact) -> None:
    shift = np.zeros((1, len(contact.points), 3))
    shift[0, :, 2] = 0.02
    wrong = replace(contact, errors=GelErrors(0.0 * shift, shift))
    press = build_press(
        wrong, NOW, FIRST, pair.cube, np.ones(len(contact.points), dtype=bool),
        options=ContactOptions(friction=FRICTION), fixed=pair.bottom, noise_mm=0.01,
    )  # fmt: skip
    assert press.surface is not None
    np.testing.assert_allclose(press.surface.deviations_mm, np.hypot(0.01, 0.02), rtol=1e-6)
