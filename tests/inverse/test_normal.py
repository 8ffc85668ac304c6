"""One Gauss-Newton system, two ways to solve it."""

import numpy as np
import pytest
import scipy.sparse as sp

from tactorch.inverse import PRIORS, Settings, make_objective
from tactorch.inverse.fit.optimizers import gauss_newton
from tactorch.inverse.fit.optimizers.gauss_newton import data_space_step, parameter_space_step
from tactorch.recording import Recording


@pytest.mark.parametrize("damping", [1e-2, 1e-6, 1e-12])
@pytest.mark.parametrize("prior", PRIORS.names()[1:])
def test_data_space_agrees_with_parameter_space(
    cube: Recording, prior: str, damping: float
) -> None:
    """Also where nearly nothing but the data holds the mean of the map."""
    objective = make_objective(cube, Settings(regularization=prior))
    x = np.random.default_rng(0).uniform(-2.0, -1.0, cube.mesh.n_tets)
    point = objective.at(x)
    weight = 100.0
    curvature = weight * point.penalty_curvature
    gradient = point.data_gradient + weight * point.penalty_gradient
    shift = damping * (np.square(point.jacobian).sum(0) + curvature.diagonal())
    steps = [
        solve(point.jacobian, gradient, curvature, shift)
        for solve in (parameter_space_step, data_space_step)
    ]
    assert steps[0] is not None
    assert steps[1] is not None
    assert np.abs(steps[0]).max() > 1e-2
    np.testing.assert_allclose(steps[1], steps[0], rtol=0, atol=1e-6 * np.abs(steps[0]).max())


@pytest.mark.parametrize("solve", [parameter_space_step, data_space_step])
@pytest.mark.parametrize(("data", "unknowns"), [(5, 12), (12, 5), (1, 1)])
def test_step_solves_the_system(solve: object, data: int, unknowns: int) -> None:
    rng = np.random.default_rng(4)
    jacobian = rng.standard_normal((data, unknowns))
    gradient = rng.standard_normal(unknowns)
    root = sp.csr_matrix(np.diff(np.eye(unknowns), axis=0)) if unknowns > 1 else sp.eye(1)
    prior = (root.T @ root).tocsr()
    shift = rng.uniform(0.1, 1.0, unknowns)
    step = solve(jacobian, gradient, prior, shift)  # type: ignore[operator]
    matrix = jacobian.T @ jacobian + prior.toarray() + np.diag(shift)
    np.testing.assert_allclose(matrix @ step, -gradient, atol=1e-10)


def test_an_indefinite_prior_is_a_value_not_a_wrong_step() -> None:
    jacobian, gradient = np.ones((1, 3)), np.ones(3)
    prior = sp.csr_matrix(-10.0 * np.eye(3))
    for solve in (parameter_space_step, data_space_step):
        assert solve(jacobian, gradient, prior, np.full(3, 0.1)) is None


def test_a_step_that_refinement_cannot_mend_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Gauss-Newton then damps more."""
    rng = np.random.default_rng(0)
    jacobian, gradient = 1e8 * rng.standard_normal((4, 9)), rng.standard_normal(9)
    prior, shift = sp.csr_matrix((9, 9)), np.full(9, 1e-8)
    monkeypatch.setattr(gauss_newton, "_MAX_SWEEPS", 1)
    assert data_space_step(jacobian, gradient, prior, shift) is None
