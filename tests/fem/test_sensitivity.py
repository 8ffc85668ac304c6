"""S du/de as a matrix and as products, against autograd."""

import numpy as np
import pytest
import torch

from tactorch.fem import ELEMENTS, Sensitivity


@pytest.fixture(params=[(element, False) for element in ELEMENTS.names()] + [("tet10", True)])
def problem(request, cell):
    """A cell at equilibrium under its first load, its sensitivity, and the autograd Jacobian."""
    c = cell("neo_hookean", *request.param)
    youngs, forces = c.inputs["youngs"], c.inputs["forces"][0]
    search = c.body.search(youngs.numpy(), forces.numpy(), c.supports)
    observed = np.array([5, 2, 20, 11, 7, 23])
    sensitivity = Sensitivity(search.linearize(search.run()), observed)

    def measured(e):
        return c.body.solve(e, forces, c.supports).reshape(-1)[torch.from_numpy(observed)]

    jacobian = torch.autograd.functional.jacobian(measured, youngs).numpy()
    return sensitivity, jacobian.reshape(len(observed), -1)


def test_matrix_is_the_jacobian(problem):
    sensitivity, jacobian = problem
    np.testing.assert_allclose(sensitivity.matrix(), jacobian, rtol=0, atol=1e-12)
    assert np.abs(jacobian).max() > 1e-3


def test_products_are_the_matrix_times(problem):
    sensitivity, jacobian = problem
    rng = np.random.default_rng(0)
    change, weights = rng.standard_normal(jacobian.shape[1]), rng.standard_normal(len(jacobian))
    np.testing.assert_allclose(
        sensitivity.times_each(change[None])[0][:, 0], jacobian @ change, atol=1e-12
    )
    np.testing.assert_allclose(
        sensitivity.transpose_times(weights), jacobian.T @ weights, atol=1e-12
    )


def test_order_of_requests_does_not_matter(problem):
    """The factorisation is renewed on the way from products to the matrix."""
    sensitivity, jacobian = problem
    change = np.ones(jacobian.shape[1])
    before = sensitivity.times_each(change[None])[0][:, 0]
    sensitivity.matrix()
    np.testing.assert_allclose(
        sensitivity.times_each(change[None])[0][:, 0], before, rtol=0, atol=1e-12
    )


def test_observations_beyond_one_batch(problem, monkeypatch):
    from tactorch.fem import linearization as module

    sensitivity, jacobian = problem
    monkeypatch.setattr(module, "_MAX_COLUMNS", 4)
    np.testing.assert_allclose(sensitivity.matrix(), jacobian, rtol=0, atol=1e-12)


def test_displacement_change_covers_all_nodes(problem):
    sensitivity, jacobian = problem
    change = np.ones(jacobian.shape[1])
    everywhere = sensitivity.linearization.displacement_change(change)
    np.testing.assert_allclose(
        everywhere.ravel()[sensitivity.observed], jacobian @ change, atol=1e-12
    )


@pytest.mark.parametrize("count", [2, 9])
def test_load_response_is_the_same_by_loads_and_by_data(problem, count):
    """Six data: fewer loads take one solve each, more take one solve for each datum."""
    sensitivity, _ = problem
    loads = np.random.default_rng(1).standard_normal(
        (count, len(sensitivity.linearization.displacement), 3)
    )
    moved = np.array(sensitivity.linearization.force_response(loads))
    expected = moved.reshape(count, -1)[:, sensitivity.observed].T
    assert np.abs(expected).max() > 1e-3
    np.testing.assert_allclose(sensitivity.load_response(loads), expected, rtol=0, atol=1e-10)
