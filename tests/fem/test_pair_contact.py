"""Contact of two parts by paired points: forces and tangent are derivatives of the energy."""

import numpy as np
import pytest

from tactorch.fem.contact.pair import CoupledDiscretisation, PairContact, Pairs
from tactorch.fem.elements import TET4
from tactorch.mesh import box_mesh


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(5)


@pytest.fixture
def contact(rng: np.random.Generator) -> PairContact:
    """Six pairs between far nodes of a box, which its elements do not couple."""
    mesh = box_mesh((2.0, 2.0, 8.0), (1, 1, 4))
    top = np.flatnonzero(mesh.points[:, 2] > 7.9)
    bottom = np.flatnonzero(mesh.points[:, 2] < 0.1)
    nodes = np.array([[*rng.permutation(top)[:3], *rng.permutation(bottom)[:3]] for _ in range(6)])
    shares = rng.dirichlet(np.ones(3), (6, 2))
    parts = CoupledDiscretisation(mesh, TET4, nodes)
    values = np.hstack([shares[:, 0], -shares[:, 1]])
    pairs = Pairs(
        parts, values, rng.uniform(0.0, 0.1, 6), rng.uniform(0.5, 1.0, 6), np.zeros((6, 3))
    )
    sticking = np.array([True, True, True, False, False, False])
    return PairContact(pairs, np.array([0.03, -0.02, 0.06]), 5.0, sticking)


def test_forces_and_tangent_are_derivatives(contact: PairContact, rng: np.random.Generator) -> None:
    parts = contact.pairs.discretisation
    u = 0.02 * rng.standard_normal((parts.n_nodes, 3))
    touching = contact.offsets(u)[:, 2] < 0.0
    assert 0 < touching.sum() < len(touching)
    response = contact.at(u)
    step = 1e-6 * rng.standard_normal(u.shape)
    change = contact.energy(u + step) - contact.energy(u - step)
    assert change == pytest.approx(2.0 * (response.forces * step).sum(), rel=1e-6)
    values = np.zeros(parts.pattern.nnz)
    contact.add_tangent(values, response)
    forces = contact.at(u + step).forces - contact.at(u - step).forces
    product = parts.pattern.product(values, step.ravel())
    whole = contact.tangent(response)
    np.testing.assert_allclose(whole.toarray(), parts.pattern.full(values).toarray(), atol=1e-12)
    np.testing.assert_allclose(2.0 * product, forces.ravel(), atol=1e-6 * np.abs(forces).max())


def test_forces_of_both_parts_are_opposite(contact: PairContact, rng: np.random.Generator) -> None:
    u = 0.02 * rng.standard_normal((contact.pairs.discretisation.n_nodes, 3))
    response, at_pairs = contact.at(u), contact.pair_forces(u)
    np.testing.assert_allclose(response.forces.sum(axis=0), 0.0, atol=1e-12)
    np.testing.assert_allclose(response.force_n, -at_pairs.sum(axis=0))
    apart = contact.offsets(u)[:, 2] >= 0.0
    assert (at_pairs[apart, 2] == 0.0).all()
    assert (at_pairs[~apart, 2] > 0.0).all()  # pushed apart
    assert (at_pairs[3:, :2] == 0.0).all()  # those slip


def test_parts_of_the_motion_are_those_of_a_smaller_motion(contact: PairContact) -> None:
    u = np.zeros((contact.pairs.discretisation.n_nodes, 3))
    half = contact.moved(0.5)
    np.testing.assert_allclose(half.offsets(u)[:, :2], 0.5 * contact.offsets(u)[:, :2])
    assert contact.moved(1.0) is contact
    assert half.energy(u) < contact.energy(u)
