"""Near-incompressible blocks: exact where the field is uniform, unlocked where it is not."""

import numpy as np
import pytest

from tactorch.fem import ELEMENTS, SoftBody, Supports, make_material
from tactorch.mesh import box_mesh, face_nodes

MU, LAMBDA = 1.0, 1e4
POISSON = LAMBDA / (2.0 * (LAMBDA + MU))  # 0.49995
YOUNGS = MU * (3.0 * LAMBDA + 2.0 * MU) / (LAMBDA + MU)


@pytest.mark.parametrize("element", ELEMENTS.names())
def test_a_block_stretched_to_twice_its_length_keeps_its_volume(element):
    mesh = box_mesh(1.0, 2)
    body = SoftBody(mesh, make_material("neo_hookean", POISSON), element=element)
    fixed = mesh.points < 1e-9  # each low side slides in its plane
    prescribed = np.zeros(fixed.shape)
    top, side = face_nodes(mesh, "z+"), face_nodes(mesh, "x+")
    fixed[top, 2], prescribed[top, 2] = True, 1.0
    supports = Supports(fixed=fixed, prescribed=prescribed)
    youngs = np.full(mesh.n_tets, YOUNGS)
    found = body.equilibrate(youngs, np.zeros((mesh.n_points, 3)), supports)
    assert found.converged, found.reason
    volumes = np.linalg.det(found.response.F)
    np.testing.assert_allclose(volumes, 1.0, atol=1e-4)
    assert np.abs(volumes - 1.0).max() > 1e-6  # nearly, not exactly
    u = found.displacement
    np.testing.assert_allclose(u[side, 0], -0.292893, atol=3e-5)
    np.testing.assert_allclose(u[face_nodes(mesh, "y+"), 1], -0.292893, atol=3e-5)


def sink(element: str, divisions: int, poisson: float) -> float:
    """Mean sinking of the top of a 10 mm cube glued to its base, pressed at 20 kPa, mm."""
    mesh = box_mesh(10.0, divisions, tets_per_cell=5)
    body = SoftBody(mesh, make_material("neo_hookean", poisson), element=element)
    fixed = np.zeros((mesh.n_points, 3), dtype=bool)
    fixed[face_nodes(mesh, "z-")] = True
    forces = body.pressure("z+", 0.02).numpy()
    found = body.equilibrate(np.full(mesh.n_tets, 0.2), forces, Supports(fixed=fixed))
    assert found.converged, found.reason
    return float(-found.displacement[face_nodes(mesh, "z+"), 2].mean())


def test_a_glued_cube_does_not_lock_in_quadratic_elements():
    """Refinement tells: a locked element changes much, a free one little."""
    change = {
        element: sink(element, 4, 0.499) / sink(element, 2, 0.499) - 1.0
        for element in ELEMENTS.names()
    }
    assert abs(change["tet10"]) < 0.04
    assert change["tet4"] > 0.15
    # Nearly incompressible tissue sinks nearly as much at 0.499 as at 0.49.
    ratio = {e: sink(e, 4, 0.499) / sink(e, 4, 0.49) for e in ELEMENTS.names()}
    assert ratio["tet10"] > 0.97
    assert ratio["tet4"] < 0.9
