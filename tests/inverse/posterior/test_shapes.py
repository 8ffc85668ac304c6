"""Samples of the posterior of shapes: densities, weights, and agreement where it is normal."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.stats import genpareto

from tactorch.errors import ConfigError, ConvergenceError
from tactorch.inverse import InverseProblem, Settings, ShapeSamples, sample_shapes
from tactorch.inverse.fields import BALL, ELLIPSOID, ShapeField, ShapePrior
from tactorch.inverse.fit.shapes import ShapesOnSites, fit_shapes
from tactorch.inverse.posterior.ridges import basis_across
from tactorch.inverse.posterior.shapes import ShapePosterior
from tactorch.inverse.result.shapes import InclusionValues, ShapeReconstruction
from tactorch.inverse.search.correction import Correction
from tactorch.inverse.search.final_posterior import final_posterior
from tactorch.inverse.search.model import MIN_GAIN, Model, Start, gain, make_posterior
from tactorch.inverse.search.problem import ShapeProblem
from tactorch.inverse.shape_samples import _ExactPosterior, sample_posterior
from tactorch.mesh import box_mesh
from tactorch.phantoms import make_phantom
from tactorch.simulation import PressPlan, simulate

MESH = box_mesh(10.0, 3, tets_per_cell=5)
PRIOR = ShapePrior.of(MESH, 0.2)
FIELD = ShapeField(PRIOR, (BALL,))
VALUES = np.array([np.log(0.2), 5.0, 5.0, 6.0, np.log(2.5), np.log(5.0)])
QUANTITIES = ("E", "R", "x", "y", "z")


@pytest.fixture(scope="module")
def recording():
    """Two presses on a ball, computed by the model itself, with noise of 60 dB."""
    plan = PressPlan(("z+", "x+"), (0.02,))
    uniform = simulate(make_phantom("uniform_cube"), plan, mesh=MESH, element="tet10")
    problem = InverseProblem(uniform, element="tet10")
    _, evaluation = fit_shapes(problem, FIELD, FIELD.standard(VALUES), max_iterations=0)
    rng, presses = np.random.default_rng(0), []
    for press, reported in zip(uniform.presses, evaluation.reported, strict=True):
        predicted = np.where(press.observed, reported[: MESH.n_points], press.displacement)
        sigma = 1e-3 * float(np.sqrt(np.mean(predicted[press.observed] ** 2)))
        noisy = predicted + sigma * rng.standard_normal(predicted.shape)
        presses.append(replace(press, displacement=noisy, noise_mm=sigma))
    return replace(uniform, presses=tuple(presses))


def reconstruct(presses: ShapeProblem, model: Model) -> ShapeReconstruction:
    """Return the result of a search that ends at a model of one ball."""
    fit, posterior = model.fit, make_posterior(model, presses.sites)
    return ShapeReconstruction(fit.field, fit.z, posterior, fit.chi2, (9.0,), 9.0, model.errors)


@pytest.fixture(scope="module")
def result(recording):
    presses = ShapeProblem(recording, Settings())
    field = ShapeField(presses.prior, (BALL,))
    fit = fit_shapes(presses.full, field, field.standard(VALUES), sites=presses.sites)
    return reconstruct(presses, Model(*fit, presses.errors.least))


def quantities(values: InclusionValues) -> dict[str, np.ndarray]:
    columns = (np.log(values.youngs_mpa), values.radius_mm, *values.center_mm.T)
    return dict(zip(QUANTITIES, columns, strict=True))


def disagreement(samples: ShapeSamples, result: ShapeReconstruction) -> float:
    """Return the largest difference of means and deviations from the fast posterior, in errors."""
    fast = quantities(InclusionValues.of(result.posterior.field, result.samples, 0))
    exact, error = quantities(samples.inclusion(0)), 1.0 / np.sqrt(samples.effective_size)
    differences = []
    for name in QUANTITIES:
        mean = samples.weights @ exact[name]
        deviation = np.sqrt(samples.weights @ (exact[name] - mean) ** 2)
        differences.append((mean - fast[name].mean()) / (error * deviation))
        differences.append(np.log(deviation / fast[name].std()) / (error / np.sqrt(2.0)))
    return float(np.abs(differences).max())


@pytest.fixture(scope="module")
def samples(recording, result):
    return sample_shapes(recording, result, draws=150)


def test_samples_are_those_of_the_normal_posterior_where_noise_is_small(samples, result):
    assert samples.reliable
    assert samples.failed == 0
    assert samples.effective_size > 0.4 * len(samples.z)
    assert samples.k_hat < 0.5
    assert disagreement(samples, result) < 3.0


def noisy(recording, factor: float):
    """Return presses whose noise, of other draws, is larger by a factor."""
    rng, presses = np.random.default_rng(3), []
    for press in recording.presses:
        sigma = factor * press.noise_mm
        changed = press.displacement + sigma * rng.standard_normal(press.displacement.shape)
        presses.append(replace(press, displacement=changed, noise_mm=sigma))
    return replace(recording, presses=tuple(presses))


@pytest.fixture(scope="module")
def uncertain(recording):
    """Presses with noise of 34 dB, by which the contrast is uncertain, and the ball fitted."""
    return fitted_ball(noisy(recording, 20.0))


def fitted_ball(presses):
    problem = ShapeProblem(presses, Settings())
    field = ShapeField(problem.prior, (BALL,))
    fit = fit_shapes(problem.full, field, field.standard(VALUES), sites=problem.sites)
    return presses, problem, Model(*fit, problem.errors.least)


def test_the_ridge_has_the_optima_of_held_parameters(uncertain):
    _, problem, model = uncertain
    final, posterior = final_posterior(problem, model)
    assert final is model
    assert posterior.field.families == (ELLIPSOID,)
    (ridge,) = posterior.ridges
    assert 4 <= len(ridge.points) <= 8
    heights = np.array([point.height for point in ridge.points])
    assert heights[[0, -1]].min() > heights.min() + 2.0
    assert heights[ridge.start] < heights.min() + 0.1
    family = ShapesOnSites(posterior.field, problem.sites)
    scale = np.sqrt(max(1.0, model.fit.chi2))
    for point, height in zip(ridge.points, heights, strict=True):
        # The first point is linearised at the ball.
        tolerance = 0.3 if point is ridge.points[ridge.start] else 0.1
        evaluation = problem.full.evaluate(family.at(point.z).youngs)
        residuals = evaluation.residuals / scale
        actual = 0.5 * (residuals @ residuals + point.z @ point.z)
        assert height == pytest.approx(actual, abs=tolerance)
        jacobian = family.at(point.z).jacobian(evaluation) / scale
        gradient = basis_across(ridge.direction).T @ (jacobian.T @ residuals + point.z)
        fall = 0.5 * np.sum((point.root.T @ gradient) ** 2)
        assert fall < tolerance


def test_a_held_direction_remains(uncertain):
    _, problem, model = uncertain
    held = np.array([0.0, 0.0, 0.0, 0.0, 0.6, -0.8])
    start = Start("held", model.fit.field, model.fit.z + 0.3 * held, model.errors)
    displacements = model.evaluation.displacements
    moved = problem.fit(start, displacements, 1e-4, held=held)
    assert moved.fit.z @ held == pytest.approx(start.z @ held, abs=1e-12)
    assert np.abs(moved.fit.z - start.z).max() > 0.02
    fit = moved.fit
    gradient = fit.jacobian.T @ fit.residuals + fit.z
    along = gradient @ held
    assert abs(along) > 1.0
    scale = np.sqrt(np.diag(np.linalg.inv(fit.covariance)))
    assert (np.abs(gradient - along * held) / scale).max() < 0.05


def test_a_ball_with_a_saturated_contrast_may_be_an_ellipsoid(recording):
    """The presses are of an ellipsoid; the ball that is nearest to it is accepted before."""
    problem = InverseProblem(recording, element="tet10")
    field = ShapeField(PRIOR, (ELLIPSOID,))
    z = field.standard(np.r_[VALUES, 0.3, -0.3, 0.2, 0.0, 0.2])
    _, evaluation = fit_shapes(problem, field, z, max_iterations=0)
    exact = [
        replace(press, displacement=np.where(press.observed, u[: MESH.n_points], 0.0))
        for press, u in zip(recording.presses, evaluation.reported, strict=True)
    ]
    _, shapes, ball = fitted_ball(noisy(replace(recording, presses=tuple(exact)), 8.0))
    final, posterior = final_posterior(shapes, ball)
    assert final.fit.field.families == (ELLIPSOID,)
    assert gain(final.fit, ball.fit) > MIN_GAIN
    assert posterior.field is final.fit.field


@pytest.mark.slow
def test_samples_are_those_about_the_ridge_where_the_contrast_is_uncertain(uncertain):
    presses, problem, model = uncertain
    _, posterior = final_posterior(problem, model)
    result = replace(reconstruct(problem, model), posterior=posterior)
    samples = sample_shapes(presses, result, draws=1_000)
    assert samples.reliable
    (found,), (exact,) = result.inclusions, samples.intervals()
    normal = replace(result, posterior=replace(posterior, ridges=())).inclusions[0]
    for name in ("radius_90_mm", "youngs_90_mpa"):
        fast, reference, other = (np.log(getattr(of, name)) for of in (found, exact, normal))
        errors = np.abs(fast - reference) / np.ptp(reference)
        assert errors.max() < 0.12
        if name == "youngs_90_mpa":  # the upper end of the normal one is far too large
            assert np.abs(other - reference).max() / np.ptp(reference) > 2.0 * errors.max()


def test_the_true_ball_is_within_the_samples(samples):
    (intervals,) = samples.intervals()
    values = samples.inclusion(0)
    for axis, true in enumerate((5.0, 5.0, 6.0)):
        low, high = intervals.center_90_mm[axis]
        assert low - 0.5 * (high - low) < true < high + 0.5 * (high - low)
    assert samples.quantile(values.radius_mm, [0.001])[0] < 2.5
    assert samples.quantile(values.radius_mm, [0.999])[0] > 2.5
    assert intervals.radius_90_mm == tuple(samples.quantile(values.radius_mm, [0.05, 0.95]))
    assert intervals.youngs_90_mpa == tuple(samples.quantile(values.youngs_mpa, [0.05, 0.95]))
    assert intervals.contrast_90 == tuple(samples.quantile(values.contrast, [0.05, 0.95]))
    assert 0.9 < intervals.youngs_90_mpa.low < intervals.youngs_90_mpa.high < 1.1


def test_samples_correct_a_wrong_proposal(recording, result):
    """The fast posterior with too large a covariance, and its radius 1.2 deviations too large."""
    right, radius = result.posterior, result.posterior.field.parts[0].start + 3
    aside = right.covariance[radius] / np.sqrt(right.covariance[radius, radius])
    wrong = replace(right, covariance=1.5 * right.covariance, step=right.step + 1.2 * aside)
    samples = sample_shapes(recording, replace(result, posterior=wrong), draws=200, seed=1)
    assert samples.reliable
    assert disagreement(samples, result) < 3.0
    first = replace(samples, z=samples.z[:30], log_weights=np.full(30, -np.log(30.0)))
    assert disagreement(first, result) > 4.5  # draws of the proposal itself


def test_searches_start_near_the_equilibria(recording, result):
    exact = _ExactPosterior.of(recording, result, Settings())
    z = result.samples[0]
    evaluation = exact.problem.evaluate(exact.family.at(z).youngs)
    starts, before = exact._starts(z), exact.evaluation.displacements
    for start, u, old in zip(starts, evaluation.displacements, before, strict=True):
        assert np.linalg.norm(start - u) < 0.05 * np.linalg.norm(old - u)


def test_noise_beyond_the_stated_one_widens_the_samples(recording, result, samples):
    """Four times the mean squared residual: twice the deviations."""
    wide = replace(
        result,
        chi2=4.0,
        posterior=replace(result.posterior, covariance=4.0 * result.posterior.covariance),
    )
    radius, weights = samples.inclusion(0).radius_mm, samples.weights
    narrow = np.sqrt(weights @ (radius - weights @ radius) ** 2)
    other = sample_shapes(recording, wide, draws=100)
    radius, weights = other.inclusion(0).radius_mm, other.weights
    assert np.sqrt(weights @ (radius - weights @ radius) ** 2) / narrow == pytest.approx(2, rel=0.2)


def test_seeds_determine_the_samples(recording, result):
    first, again, other = (
        sample_shapes(recording, result, draws=12, seed=seed) for seed in (3, 3, 4)
    )
    np.testing.assert_array_equal(first.z, again.z)
    np.testing.assert_array_equal(first.log_weights, again.log_weights)
    assert not np.isin(first.z, other.z).any()


def test_few_draws_are_not_reliable(recording, result, caplog):
    samples = sample_shapes(recording, result, draws=10)
    assert not samples.reliable
    assert "not reliable" in caplog.text
    with pytest.raises(ConfigError, match="draws=1"):
        sample_shapes(recording, result, draws=1)


def test_the_predictions_are_those_of_the_search(recording, monkeypatch):
    """Another mesh, whose correction is a fixed share of the predictions, and both errors."""

    def offsets(self, fit, evaluation, check):
        index = [observation.index for observation in evaluation.data.observations]
        return [0.002 * u.ravel()[i] for u, i in zip(evaluation.reported, index, strict=True)]

    monkeypatch.setattr(Correction, "offsets", offsets)
    other = replace(recording, provenance={})
    presses = ShapeProblem(other, Settings())
    displacements = presses.uniform().evaluation.displacements
    field = ShapeField(presses.prior, (BALL,))
    errors = {**presses.errors.least, "forces": 0.02, "pose": 0.002}
    start = Start("ball", field, field.standard(VALUES), errors)
    model = presses.final(presses.fit(start, displacements))
    result = reconstruct(presses, model)
    exact = _ExactPosterior.of(other, result, Settings())
    data = exact.evaluation.data
    assert data.log_determinant == pytest.approx(model.evaluation.data.log_determinant, abs=1e-3)
    np.testing.assert_allclose(exact.evaluation.residuals, model.fit.residuals, atol=2e-3)
    z = result.posterior.z
    expected = -0.5 * (2.0 * model.fit.misfit + z @ z) + result.posterior.log_jacobian(z[None])[0]
    assert exact.log_density(z) == pytest.approx(expected, abs=1e-2)

    def fails(self, fit, evaluation, check):
        raise ConvergenceError("no equilibrium")

    monkeypatch.setattr(Correction, "offsets", fails)
    with pytest.raises(ConvergenceError, match="discretisation"):
        _ExactPosterior.of(other, result, Settings())


def test_draws_without_equilibrium_have_no_weight(recording, result, monkeypatch):
    evaluate, calls = InverseProblem.evaluate, []

    def sometimes(*args, **options):
        calls.append(args)
        if len(calls) > 10 and len(calls) % 3 == 0:
            raise ConvergenceError("no equilibrium")
        return evaluate(*args, **options)

    monkeypatch.setattr(InverseProblem, "evaluate", sometimes)
    samples = sample_shapes(recording, result, draws=30)
    assert 0 < samples.failed < 15
    np.testing.assert_array_equal(samples.weights == 0.0, np.isneginf(samples.log_weights))
    assert samples.weights.sum() == pytest.approx(1.0)
    assert samples.failed == (samples.weights == 0.0).sum()
    with pytest.raises(ConvergenceError, match="zero at all draws"):
        sample_posterior(result.posterior, lambda z: -np.inf, 5)


def skewed(contrast: float, size: float = 0.3, field: ShapeField = FIELD) -> ShapePosterior:
    """Return a posterior whose radius and contrast are uncertain, with correlations."""
    z = field.standard(np.array([*VALUES[:5], np.log(contrast), *[0.1] * (field.size - 6)]))
    root = np.random.default_rng(2).standard_normal((field.size, field.size))
    covariance = size**2 * (0.3 * root @ root.T / field.size + 0.7 * np.eye(field.size))
    return ShapePosterior(field, z, 0.1 * size * root[0], covariance)


def uncertain_radius(contrast: float, size: float, others: float = 0.05) -> ShapePosterior:
    """Return a posterior in which radius and contrast are correlated with each other only."""
    z = FIELD.standard(np.array([*VALUES[:5], np.log(contrast)]))
    covariance = np.diag(np.r_[np.full(4, others), size, size] ** 2)
    covariance[4, 5] = covariance[5, 4] = -0.5 * size**2
    return ShapePosterior(FIELD, z, np.array([0.1, 0, 0, 0, 0.1 * size, -0.2 * size]), covariance)


POSTERIORS = {
    "soft": skewed(0.3),
    "stiff": skewed(5.0),
    "ellipsoid": skewed(2.0, 0.15, ShapeField(PRIOR, (ELLIPSOID,))),
    "logarithms": skewed(5.0, 8.0),
}


def log_density(posterior, z):
    """Logarithm of the density of samples without ridges, by the normal one of the coordinates."""
    normal = posterior.normal
    squares = (normal.standardised(posterior.coordinates(z)) ** 2).sum(axis=1)
    heights = -0.5 * squares - 0.5 * z.shape[1] * np.log(2.0 * np.pi) - normal.log_volume
    density = heights + posterior.log_jacobian(z)
    if not posterior.is_linear:
        return density
    return np.where(posterior.within_limits(z), density - np.log(posterior._accepted), -np.inf)


@pytest.mark.parametrize(
    ("posterior", "is_linear", "reach"),
    [
        (uncertain_radius(0.3, 0.3), True, 4.0),
        (uncertain_radius(5.0, 0.7), True, 4.0),  # a quarter of the normal samples are left out
        (uncertain_radius(5.0, 5.0, 10.0), False, 25.0),
    ],
)
def test_the_density_is_that_of_the_samples(posterior, is_linear, reach):
    """Its integral over radius and contrast is one, and its marginals are those of the samples."""
    assert posterior.is_linear == is_linear
    grid, z = np.linspace(-reach, reach, 142)[1:-1], posterior.samples(20_000)
    points = np.tile(posterior.z + posterior.step, (len(grid) ** 2, 1))
    points[:, 4:] = np.stack(np.meshgrid(grid, grid, indexing="ij"), axis=-1).reshape(-1, 2)
    masses = np.exp(log_density(posterior, points)).reshape(len(grid), -1) * np.ptp(grid[:2]) ** 2
    # The others are independent of these, and at their means.
    masses *= np.sqrt(np.prod(2.0 * np.pi * np.diag(posterior.covariance)[:4]))
    if is_linear:
        assert np.isneginf(log_density(posterior, np.full((1, 6), 4.5))[0])
    assert masses.sum() == pytest.approx(1.0, abs=0.02)
    for axis in (0, 1):
        mass = masses.sum(axis=1 - axis)
        below = np.searchsorted(np.sort(z[:, 4 + axis]), grid) / len(z)
        np.testing.assert_allclose(np.cumsum(mass) - 0.5 * mass, below, atol=0.015)


@pytest.mark.parametrize("name", POSTERIORS)
def test_coordinates_are_inverted_and_have_their_jacobian(name):
    posterior = POSTERIORS[name]
    z = posterior.samples(3)
    x = posterior.coordinates(z)
    np.testing.assert_allclose(posterior.parameters(x), z, atol=1e-10)
    for one, log in zip(z, posterior.log_jacobian(z), strict=True):
        steps = 1e-5 * np.eye(len(one))
        slopes = (posterior.coordinates(one + steps) - posterior.coordinates(one - steps)) / 2e-5
        sign, expected = np.linalg.slogdet(slopes)
        assert sign == 1.0
        assert log == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize("name", ["soft", "stiff"])
def test_weights_correct_a_skewed_proposal(name):
    """A proposal that is twice as wide, and aside; the target is known."""
    right = POSTERIORS[name]
    aside = right.step + 0.5 * np.sqrt(np.diag(right.covariance))
    wrong = replace(right, covariance=2.0 * right.covariance, step=aside)

    def log_target(z):
        return float(log_density(right, z[None])[0])

    z, logs = sample_posterior(wrong, log_target, 5_000)
    expected, weights = right.samples(20_000), np.exp(logs)
    assert weights.sum() == pytest.approx(1.0)
    deviation = expected.std(axis=0)
    mean = weights @ z
    np.testing.assert_allclose((mean - expected.mean(axis=0)) / deviation, 0.0, atol=0.12)
    np.testing.assert_allclose(np.sqrt(weights @ (z - mean) ** 2) / deviation, 1.0, atol=0.1)
    # The first ones are of the proposal itself.
    assert np.abs((z[:800].mean(axis=0) - expected.mean(axis=0)) / deviation).max() > 0.3


def test_the_limit_of_k_falls_with_the_number_of_draws():
    weights = np.log(genpareto(0.62).rvs(100_000, random_state=np.random.default_rng(1)))

    def samples(logs):
        logs = logs - np.log(np.exp(logs).sum())
        return ShapeSamples(FIELD, np.zeros((len(logs), FIELD.size)), logs, (0,))

    many = samples(weights)
    assert many.reliable
    few = samples(np.quantile(weights, (np.arange(200) + 0.5) / 200))
    assert few.effective_size > 20.0
    assert few.k_hat == pytest.approx(0.6, abs=0.15)
    assert few.k_hat > 1.0 - 1.0 / np.log10(200)
    assert not few.reliable
    one = samples(np.r_[np.zeros(199), np.log(400.0)])
    assert one.effective_size < 20.0
    assert not one.reliable


def test_inclusions_are_in_the_order_of_the_result():
    field = ShapeField(PRIOR, (BALL, BALL))
    second = [4.0, 5.0, 6.0, np.log(1.5), 0.7]
    z = field.standard(np.array([*VALUES, *second]))
    posterior = ShapePosterior(field, z, np.zeros(11), 1e-6 * np.eye(11))
    result = ShapeReconstruction(field, z, posterior, 1.0, (5.0, 8.0), 13.0)
    samples = ShapeSamples(field, np.tile(z, (40, 1)), np.full(40, -np.log(40.0)), result.order)
    assert result.order == (1, 0)
    approx = partial(pytest.approx, rel=1e-3)
    for inclusion, intervals in zip(result.inclusions, samples.intervals(), strict=True):
        assert intervals.radius_90_mm.low == approx(inclusion.shape.radius_mm)
        assert intervals.contrast_90.high == approx(inclusion.shape.contrast)
        assert intervals.youngs_90_mpa.low == approx(inclusion.youngs_mpa)
        assert intervals.center_90_mm[0].low == approx(inclusion.shape.center_mm[0])


def test_a_body_without_inclusion_has_samples_too(recording):
    presses = ShapeProblem(recording, Settings())
    model = presses.uniform()
    posterior = make_posterior(model, presses.sites)
    fit = model.fit
    result = ShapeReconstruction(fit.field, fit.z, posterior, fit.chi2, (), 0.0)
    samples = sample_shapes(recording, result, draws=40)
    assert samples.intervals() == []
    mean = samples.weights @ samples.z[:, 0]
    deviation = np.sqrt(posterior.covariance[0, 0])
    assert mean == pytest.approx((posterior.z + posterior.step)[0], abs=0.6 * deviation)
