from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import cho_solve, solve_triangular

from tactorch.errors import ConfigError
from tactorch.inverse import (
    PRIORS,
    InverseProblem,
    Log,
    NoiseModel,
    NuisancePrior,
    Objective,
    Point,
    Scaled,
)
from tactorch.inverse.fields import ElementField
from tactorch.inverse.fields.regularization.base import jumps, relative
from tactorch.inverse.posterior import variational_posterior

LOG = Log()
NOISE = NoiseModel(relative=0.02)


@pytest.fixture
def point(make_problem: Callable[..., InverseProblem]) -> Point:
    """Some map near the truth, seen through coarse noise."""
    problem = InverseProblem(make_problem(faces=("z+", "x-")).recording, noise=NOISE)
    mesh = problem.recording.mesh
    truth = problem.recording.truth
    assert truth is not None
    found = truth * np.exp(0.05 * np.random.default_rng(2).normal(size=mesh.n_tets))
    return Objective(
        problem, ElementField(LOG, PRIORS.build("total_variation").on(mesh), mesh.n_tets)
    ).at(np.log(found))


def gibbs(point: Point, sweeps: int = 3000) -> np.ndarray:
    """Draw from the posterior under total variation by data augmentation.

    The Bayesian lasso's sampler (Park and Casella, 2008) on jumps, weight included.
    """
    rng = np.random.default_rng(0)
    mesh = point.objective.problem.recording.mesh
    difference, areas = jumps(mesh).toarray(), relative(mesh.adjacency.areas)
    hessian = point.jacobian.T @ point.jacobian
    right = hessian @ point.x - point.data_gradient
    x, drawn = point.x, []
    for _ in range(sweeps):
        sizes = np.maximum(np.abs(difference @ x), 1e-9)
        rate = areas * rng.gamma(mesh.n_tets - 1, 1.0 / (areas @ sizes))
        precisions = rng.wald(rate / sizes, rate**2)
        root = np.linalg.cholesky(hessian + difference.T @ (precisions[:, None] * difference))
        noise = rng.standard_normal(len(x))
        x = cho_solve((root, True), right) + solve_triangular(root.T, noise)
        drawn.append(x)
    return np.array(drawn[sweeps // 5 :])


def test_agrees_with_sampling_the_posterior(point: Point) -> None:
    found, drawn = variational_posterior(point, 1.0), gibbs(point)
    ratio = found.deviation() / drawn.std(axis=0)
    off = (found.mean - drawn.mean(axis=0)) / drawn.std(axis=0)
    # Variational posteriors are known to be narrow, but not by much.
    assert 0.65 < np.median(ratio) < 1.1
    assert np.sqrt(np.mean(off**2)) < 0.35


def test_the_equations_hold(point: Point) -> None:
    found = variational_posterior(point, 1.0)
    mesh = point.objective.problem.recording.mesh
    difference, areas = jumps(mesh).toarray(), relative(mesh.adjacency.areas)
    covariance = found.covariance(np.arange(mesh.n_tets))
    spread = np.einsum("fi,ij,fj->f", difference, covariance, difference)
    sizes = np.sqrt((difference @ found.mean) ** 2 + spread)
    assert found.weight == pytest.approx((mesh.n_tets - 1) / (areas @ sizes), rel=0.05)
    stiffness = found.weight * areas / sizes
    precision = point.jacobian.T @ point.jacobian + difference.T @ (stiffness[:, None] * difference)
    np.testing.assert_allclose(np.linalg.inv(precision), covariance, rtol=0.1, atol=1e-4)
    # The mean is that of the linear model, drawn towards flatness by the prior.
    seen = point.jacobian.T @ (point.jacobian @ point.x) - point.data_gradient
    np.testing.assert_allclose(found.mean, covariance @ seen, rtol=1e-6)


def test_the_first_weight_does_not_matter(point: Point) -> None:
    low, high = (variational_posterior(point, weight) for weight in (0.1, 100.0))
    np.testing.assert_allclose(low.deviation(), high.deviation(), rtol=0.1)


def test_a_flat_map_speaks_for_more_weight(point: Point) -> None:
    flat = point.objective.at(np.full_like(point.x, np.log(0.2)))
    residuals = np.zeros_like(flat.evaluation.residuals)
    flat.evaluation.residuals = residuals
    assert variational_posterior(flat, 1.0).weight > 2 * variational_posterior(point, 1.0).weight


def test_other_parameters_say_the_same(point: Point) -> None:
    elements = replace(point.objective.elements, parameterization=Scaled())
    scaled = replace(point.objective, field=elements)
    other = scaled.at(scaled.start(point.youngs))
    chain = elements.parameterization.slope(other.x) / other.youngs
    found, expected = variational_posterior(other, 1.0), variational_posterior(point, 1.0)
    np.testing.assert_allclose(found.deviation() * chain, expected.deviation(), rtol=1e-3)


def test_global_unknowns_widen_the_elements(point: Point) -> None:
    wider = replace(point.objective, nuisance=NuisancePrior(force_scale=0.3, poisson=0.05))
    found = variational_posterior(wider.at(wider.start(point.youngs)), 1.0)
    assert found.variance().shape == (len(point.x),)
    assert np.median(found.deviation() / variational_posterior(point, 1.0).deviation()) > 1.02


def test_refusals(point: Point) -> None:
    with pytest.raises(ConfigError, match="weight=0"):
        variational_posterior(point, 0.0)
    smooth = PRIORS.build("smoothness").on(point.objective.problem.recording.mesh)
    elements = replace(point.objective.elements, prior=smooth)
    with pytest.raises(ConfigError, match="total variation without a mean"):
        variational_posterior(replace(point.objective, field=elements).at(point.x), 1.0)


@pytest.mark.parametrize("given", [True, False])
def test_uniform_map_has_a_finite_posterior(point: Point, given: bool) -> None:
    """The iteration starts at the jumps of the map, which are zero here."""
    uniform = point.objective.at(np.full_like(point.x, np.log(0.2)))
    sizes = np.zeros(len(point.objective.problem.recording.mesh.adjacency.pairs))
    posterior = variational_posterior(uniform, 1.0, sizes=sizes if given else None)
    assert np.isfinite(posterior.weight)
    assert np.isfinite(posterior.deviation()).all()
    assert posterior.deviation().min() > 0


def test_a_start_at_the_last_sizes_settles_at_once(point: Point) -> None:
    found = variational_posterior(point, 1.0)
    again = variational_posterior(point, found.weight, sizes=found.sizes)
    assert again.iterations == 1 < found.iterations
    np.testing.assert_allclose(again.deviation(), found.deviation(), rtol=0.02)
    assert variational_posterior(point, 1.0, tolerance=0.5).iterations < found.iterations
