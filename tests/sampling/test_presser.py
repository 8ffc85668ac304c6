from dataclasses import replace

import numpy as np
import pytest

from tactorch.fem import SoftBody, make_material
from tactorch.mesh import box_mesh
from tactorch.sampling import Patch, Presser, SimulatedPresser

TOP = Patch(np.array([5.0, 5.0, 10.0]), np.array([0.0, 0.0, -1.0]), 3.0)


@pytest.fixture(scope="module")
def presser() -> SimulatedPresser:
    fine, mesh = (box_mesh(10.0, n, tets_per_cell=5) for n in (6, 4))
    return SimulatedPresser(
        body=SoftBody(fine, make_material("neo_hookean", 0.45)),
        youngs=np.full(fine.n_tets, 0.2),
        held=fine.points[:, 2] < 1e-9,
        mesh=mesh,
        mesh_held=mesh.points[:, 2] < 1e-9,
        pressure_mpa=0.005,
        noise_mm=0.0,
    )


def test_what_is_pressed_sinks(presser: SimulatedPresser) -> None:
    assert isinstance(presser, Presser)
    press = presser.press(TOP)
    center = int(np.linalg.norm(presser.mesh.points - TOP.center, axis=1).argmin())
    assert press.displacement[center, 2] < -0.01
    assert press.observed[:, 0].sum() == press.forces.any(axis=1).sum() > 3
    assert press.total_force[2] == pytest.approx(-0.005 * np.pi * 9.0)


def test_twice_as_stiff_sinks_half_as_far(presser: SimulatedPresser) -> None:
    stiff = replace(presser, youngs=2 * presser.youngs, pressure_mpa=0.01)
    np.testing.assert_allclose(
        stiff.press(TOP).displacement, presser.press(TOP).displacement, atol=1e-7
    )


def test_noise_is_as_stated_and_seeded(presser: SimulatedPresser) -> None:
    noisy = replace(presser, noise_mm=0.1)
    press = noisy.press(TOP)
    np.testing.assert_array_equal(press.displacement, noisy.press(TOP).displacement)
    off = (press.displacement - presser.press(TOP).displacement)[press.observed]
    assert off.std() == pytest.approx(0.1, rel=0.4)
    other = replace(noisy, seed=1).press(TOP)
    assert not np.array_equal(
        other.displacement[press.observed], press.displacement[press.observed]
    )
