"""Cook's membrane in plane strain, mm and MPa.

Corners (0,0), (48,44), (48,60), (0,44) mm, 1 mm thick, out of plane fixed on both faces; left side
clamped; mu = 422.5 kPa = 0.4225 MPa, E = 2 mu (1 + nu); dead shear of 1 N over the right side of
16 x 1 mm^2, a traction of 0.0625 MPa. With nu = 0.3 the point (48, 52) rises by 14.74 mm.
"""

import numpy as np
import pytest

from tactorch.fem import SoftBody, Supports, make_material
from tactorch.mesh import TetMesh, box_mesh

MU = 0.4225
RISE = 14.74


def tip(element: str, divisions: int, poisson: float = 0.3) -> float:
    """Vertical displacement at (48, 52), mm."""
    grid = box_mesh((48.0, 1.0, 1.0), (divisions, divisions, 1))
    x, height, z = grid.points.T
    low, high = 44.0 / 48.0 * x, 44.0 + 16.0 / 48.0 * x
    mesh = TetMesh(np.stack([x, low + height * (high - low), z], axis=1), grid.tets)
    fixed = np.zeros((mesh.n_points, 3), dtype=bool)
    fixed[:, 2] = True
    fixed[x == 0.0] = True
    body = SoftBody(mesh, make_material("isochoric_neo_hookean", poisson), element=element)
    forces = body.traction("x+", [0.0, 1.0 / 16.0, 0.0]).numpy()
    np.testing.assert_allclose(forces.sum(0), [0.0, 1.0, 0.0], atol=1e-12)
    youngs = np.full(mesh.n_tets, 2.0 * MU * (1.0 + poisson))
    found = body.equilibrate(youngs, forces, Supports(fixed=fixed))
    assert found.converged, found.reason
    middle = (x == 48.0) & (height == 0.5)
    assert middle.sum() == 2
    return float(found.displacement[: mesh.n_points][middle, 1].mean())


def test_quadratic_elements_reach_the_value():
    rises = [tip("tet10", n) for n in (2, 4, 8)]
    gaps = RISE - np.array(rises)
    assert rises[0] == pytest.approx(RISE, rel=0.03)
    assert rises[2] == pytest.approx(RISE, abs=0.01)
    assert np.all(np.diff(np.abs(gaps)) < 0)


def test_linear_elements_tend_to_the_value_from_below():
    gaps = RISE - np.array([tip("tet4", n) for n in (8, 16, 32)])
    assert np.all(gaps > 0)
    assert gaps[1] < 0.4 * gaps[0]
    assert gaps[2] < 0.32 * gaps[1]
    # Order two, extrapolated.
    assert RISE - (gaps[2] - (gaps[1] - gaps[2]) / 3.0) == pytest.approx(RISE, rel=0.01)


@pytest.mark.slow
def test_finest_mesh_reaches_the_value_to_its_last_digit():
    assert tip("tet10", 16) == pytest.approx(RISE, abs=0.005)


def test_linear_elements_lock_where_quadratic_ones_do_not():
    """At nu = 0.499 the plain tetrahedron is far too stiff, on meshes that nu = 0.3 finds fine."""
    coarse, fine = (tip("tet10", n, 0.499) for n in (4, 8))
    assert coarse == pytest.approx(fine, rel=0.08)
    assert fine == pytest.approx(11.92, rel=0.02)  # tet10 on 16 x 16
    locked = tip("tet4", 16, 0.499)
    assert locked < 0.5 * fine
    assert tip("tet4", 16) > 0.9 * RISE


@pytest.mark.slow
def test_the_reference_at_nu_0499_is_converged():
    assert tip("tet10", 16, 0.499) == pytest.approx(11.92, abs=0.01)
