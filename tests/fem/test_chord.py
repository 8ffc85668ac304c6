"""Several load cases approach their equilibria with one factorisation."""

import numpy as np
import pytest

from tactorch.fem import NewtonOptions, SoftBody, Supports, make_material
from tactorch.fem.chord import approach
from tactorch.linalg import SharedLease


def searches_of(block, clamped, element, loads, solver="auto"):
    material = make_material("neo_hookean", 0.45)
    newton = NewtonOptions(rtol=1e-6)
    body = SoftBody(block, material, element=element, solver=solver, newton=newton)
    supports, youngs = Supports(fixed=clamped(block, "z-")), np.ones(block.n_tets)
    lease = SharedLease(body.pool, single_precision=True)
    forces = [
        body.discretisation.consistent_loads(body.traction("z+", [0.01, 0.0, -load]).numpy())
        for load in loads
    ]
    return [body.search(youngs, force, supports, lease=lease) for force in forces], lease


@pytest.mark.parametrize(
    ("element", "solver"), [("tet4", "auto"), ("tet10", "auto"), ("tet10", "p_multigrid")]
)
def test_they_are_the_equilibria_of_newton(block, clamped, element, solver):
    searches, lease = searches_of(block, clamped, element, (0.01, 0.02, 0.04), solver)
    rest = np.zeros_like(searches[0].forces)
    found = approach(searches, [rest] * 3, lease)
    for search, u in zip(searches, found, strict=True):
        assert search.unbalanced(u)[1] <= 1e-4  # and 1 at rest
        assert search.run(u).iterations <= 1
        exact = search.run(rest)
        assert exact.iterations > 2
        np.testing.assert_allclose(u, exact.displacement, atol=1e-4 * np.abs(u).max())


def test_a_case_that_diverges_keeps_its_best_displacements(block, clamped):
    # Under the second load an element inverts, or the case moves away from equilibrium.
    searches, lease = searches_of(block, clamped, "tet4", (0.02, 5.0))
    rest = np.zeros_like(searches[0].forces)
    near, far = approach(searches, [rest, rest], lease)
    assert searches[0].unbalanced(near)[1] <= 1e-6
    assert searches[1].unbalanced(far)[1] <= searches[1].unbalanced(rest)[1]
