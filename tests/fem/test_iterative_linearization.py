"""Derivatives by conjugate gradients with the factorisation of a nearby tangent."""

import numpy as np
import pytest

from tactorch.fem import Linearization, Sensitivity, SoftBody, Supports, make_material
from tactorch.fem.boundary import pressure_forces
from tactorch.linalg import SharedLease
from tactorch.mesh import box_mesh, face_nodes


@pytest.fixture(scope="module")
def state():
    mesh = box_mesh(10.0, 4, tets_per_cell=5)
    body = SoftBody(mesh, make_material("neo_hookean", 0.45), element="tet10")
    fixed = np.zeros((mesh.n_points, 3), dtype=bool)
    fixed[face_nodes(mesh, "z-")] = True
    youngs = np.linspace(0.1, 0.5, mesh.n_tets)
    forces = np.asarray(pressure_forces(body.discretisation, "z+", 0.02))
    search = body.search(youngs, forces, Supports(fixed=fixed))
    return search, search.run().require(), youngs


def test_they_are_those_of_a_factorisation_to_the_tolerance(state):
    search, equilibrium, youngs = state
    changes = np.random.default_rng(0).normal(size=(3, len(youngs))) * youngs
    iterative, rough = (
        Sensitivity(search.linearize(equilibrium, rtol), np.arange(3)).times_each(changes)[1]
        for rtol in (1e-6, 1e-2)
    )
    exact = search.linearize(equilibrium)
    for change, close, far in zip(changes, iterative, rough, strict=True):
        expected = exact.displacement_change(change)
        scale = np.abs(expected).max()
        np.testing.assert_allclose(close, expected, atol=1e-5 * scale)
        np.testing.assert_allclose(far, expected, atol=0.1 * scale)


def test_without_a_factorisation_the_tangent_is_factored(state):
    search, equilibrium, youngs = state
    expected = search.linearize(equilibrium).displacement_change(youngs)
    linearization = search.linearize(equilibrium, rtol=1e-3)
    linearization.lease.transfer_factorization()
    found = linearization.displacement_change(youngs)
    np.testing.assert_allclose(found, expected, atol=1e-3 * np.abs(expected).max())


def test_load_cases_at_the_same_moduli_share_a_factorisation(state):
    search, equilibrium, _youngs = state
    lease = SharedLease(search._pool, single_precision=True)
    loads = np.random.default_rng(0).normal(size=(8, *equilibrium.displacement.shape))
    loads[:, search.supports.fixed] = 0.0

    def near(share: float) -> Linearization:
        moved = search.run(share * equilibrium.displacement).require()
        other = search.linearize(moved, 1e-6)
        other.lease, other.tangent = lease, other.tangent * (1.0 + share)
        return other

    first, second = near(0.0), near(0.1)
    first.force_response(loads)
    found = second.force_response(loads)
    with lease.hold() as held:
        if not held.single_precision:
            pytest.skip("no solver in single precision")
        assert held.factored is first.tangent
    second.rtol = 0.0
    expected = np.array(second.force_response(loads))
    np.testing.assert_allclose(found, expected, atol=1e-5 * np.abs(expected).max())
