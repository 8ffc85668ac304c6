"""Priors that refer to levels: what is given is used, what is not is estimated."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize, minimize_scalar
from scipy.sparse.linalg import spsolve

from tactorch.errors import ConfigError
from tactorch.inverse import (
    PRIORS,
    Bounds,
    Composite,
    InverseProblem,
    Matern,
    ShiftedPrior,
    Sparsity,
    Tikhonov,
    monte_carlo,
)
from tactorch.inverse.fields.regularization.sharp import smoothed_median, two_levels
from tactorch.mesh import TetMesh, box_mesh
from tactorch.metrics.segment import weighted_median
from tactorch.recording import Recording

MESH = box_mesh(10.0, 2, tets_per_cell=5)
VOLUMES = MESH.volumes / MESH.volumes.mean()
BINARY = np.where(MESH.centroids[:, 2] > 7.0, np.log(1.0), np.log(0.2))
SEEDS = st.integers(0, 2**32 - 1)


@pytest.mark.parametrize("name", ["tikhonov", "sparsity", "matern"])
def test_a_map_at_the_given_level_costs_nothing(name: str) -> None:
    prior = PRIORS.build({"name": name, "level_mpa": 0.2}).on(MESH)
    assert prior.value(np.full(MESH.n_tets, np.log(0.2))) == pytest.approx(0.0, abs=1e-12)
    assert prior.value(np.full(MESH.n_tets, np.log(0.3))) > 0.1


@pytest.mark.parametrize("levels", [(0.2, 1.0), (1.0, 0.2), None])
def test_a_binary_map_costs_nothing_in_the_well(levels: tuple[float, float] | None) -> None:
    prior = PRIORS.build({"name": "binary_well", "levels_mpa": levels}).on(MESH)
    assert prior.value(BINARY) == pytest.approx(0.0, abs=1e-12)
    between = BINARY.copy()
    between[0] = np.log(0.45)
    assert prior.value(between) > 1e-3


def test_the_well_is_the_papers_on_log_moduli() -> None:
    field = np.random.default_rng(0).normal(-1.0, 0.5, MESH.n_tets)
    prior = PRIORS.build({"name": "binary_well", "levels_mpa": (0.2, 1.0)}).on(MESH)
    expected = (VOLUMES * (field - np.log(0.2)) ** 2 * (field - np.log(1.0)) ** 2).sum()
    assert prior.value(field) == pytest.approx(expected)


@given(seed=SEEDS, edge=st.sampled_from([0.01, 0.3, 3.0]))
@settings(max_examples=20, deadline=None)
def test_estimated_levels_make_their_penalties_smallest(seed: int, edge: float) -> None:
    rng = np.random.default_rng(seed)
    field, weights = rng.standard_normal(30), rng.uniform(0.1, 2.0, 30)

    def spread(level: float) -> float:
        return float(weights @ np.hypot(field - level, edge))

    best = minimize_scalar(spread, bounds=(field.min(), field.max()), method="bounded")
    assert spread(smoothed_median(field, weights, edge)) <= best.fun * (1 + 1e-9)

    def well(levels: np.ndarray) -> float:
        return float(weights @ ((field - levels[0]) ** 2 * (field - levels[1]) ** 2))

    low, high = two_levels(field, weights)
    assert field.min() <= low < high <= field.max()
    searched = minimize(well, np.array([-1.0, 1.0]), method="Nelder-Mead")
    assert well(np.array([low, high])) <= searched.fun * (1 + 1e-9)


def test_the_median_counts_by_weight() -> None:
    field, weights = np.array([3.0, 1.0, 2.0]), np.array([1.0, 5.0, 1.0])
    assert weighted_median(field, weights) == 1.0
    assert smoothed_median(field, weights, 1e-4) == pytest.approx(1.0, abs=1e-3)


def test_sparsity_forgives_few_large_departures() -> None:
    """Half the contrast in twice the volume costs as much; under Tikhonov, half."""
    few, many = np.zeros(MESH.n_tets), np.zeros(MESH.n_tets)
    order = np.flatnonzero(np.isclose(VOLUMES, VOLUMES[0]))[:4]
    few[order[:2]], many[order] = 2.0, 1.0
    sparse = Sparsity(edge=1e-6, level_mpa=1.0).on(MESH)
    squares = Tikhonov(level_mpa=1.0).on(MESH)
    assert sparse.value(few) == pytest.approx(sparse.value(many), rel=1e-5)
    assert squares.value(few) == pytest.approx(2.0 * squares.value(many))


def test_log_jumps_prefer_one_large_jump_to_two_halves() -> None:
    z = MESH.centroids[:, 2]
    once = np.where(z > 5.0, 2.0, 0.0)
    prior = PRIORS.build({"name": "log_jumps", "edge": 0.1}).on(MESH)
    assert prior.value(once) < 1.5 * prior.value(0.5 * once)
    variation = PRIORS.build({"name": "total_variation", "edge": 0.01}).on(MESH)
    assert variation.value(once) > 1.9 * variation.value(0.5 * once)
    small = PRIORS.build({"name": "log_jumps", "edge": 100.0}).on(
        MESH
    )  # a quadratic where jumps are small
    assert small.value(once) == pytest.approx(4.0 * small.value(0.5 * once), rel=1e-3)


def test_matern_draws_have_the_covariance_of_the_precision() -> None:
    prior = Matern(length_mm=5.0, deviation=0.5, level_mpa=0.3).on(MESH)
    rng = np.random.default_rng(0)
    draws = np.log([prior.sample(rng) for _ in range(4000)])
    covariance = np.linalg.inv(prior.curvature(draws[0]).toarray())
    np.testing.assert_allclose(draws.mean(0), np.log(0.3), atol=0.05)
    np.testing.assert_allclose(np.cov(draws.T), covariance, atol=0.1 * covariance.max())


def test_matern_states_its_deviation_and_length_inside() -> None:
    """Far from the surface, on a mesh finer than the length."""
    mesh = box_mesh(20.0, 10, tets_per_cell=5)
    length = 6.0
    prior = Matern(length_mm=length, deviation=0.5, level_mpa=1.0).on(mesh)
    distance = np.linalg.norm(mesh.centroids - 10.0, axis=1)
    centre = int(distance.argmin())
    unit = np.zeros(mesh.n_tets)
    unit[centre] = 1.0
    column = spsolve(prior.curvature(unit).tocsc(), unit)
    assert np.sqrt(column[centre]) == pytest.approx(0.5, rel=0.25)
    far = np.linalg.norm(mesh.centroids - mesh.centroids[centre], axis=1)
    ring = (far > 0.9 * length) & (far < 1.1 * length)
    assert column[ring].mean() / column[centre] == pytest.approx(np.exp(-2.0), abs=0.1)


def test_a_draw_can_start_an_inversion(recording: Recording) -> None:
    prior = Matern(level_mpa=0.3).on(recording.mesh)
    start = monte_carlo(prior.sample, draws=3)
    first = start(InverseProblem(recording), Bounds())
    assert first.shape == (recording.mesh.n_tets,)
    assert first.min() > 0
    with pytest.raises(ConfigError, match="level_mpa is null"):
        Matern().on(recording.mesh).sample(np.random.default_rng(0))


def test_a_composite_is_the_weighted_sum() -> None:
    field = np.random.default_rng(0).normal(-1.0, 0.5, MESH.n_tets)
    shares = {"total_variation": 2.0, "tikhonov": 0.5}
    whole = PRIORS.build({"name": "composite", "parts": shares}).on(MESH)
    parts = [(share, PRIORS.build(name).on(MESH)) for name, share in shares.items()]
    assert whole.value(field) == pytest.approx(sum(s * p.value(field) for s, p in parts))
    np.testing.assert_allclose(
        whole.curvature(field).toarray(), sum(s * p.curvature(field).toarray() for s, p in parts)
    )


@pytest.mark.parametrize(
    ("name", "options", "words"),
    [
        ("tikhonov", {"level_mpa": 0.0}, r"level_mpa=0\.0: give a number above 0"),
        ("sparsity", {"level_mpa": -1.0}, r"level_mpa=-1\.0: give a number above 0"),
        ("binary_well", {"levels_mpa": [0.2, 0.2]}, "two different moduli"),
        ("binary_well", {"levels_mpa": [0.2, -1.0]}, "give a list of two numbers.* above 0"),
        ("matern", {"length_mm": 0.0}, r"length_mm=0\.0: give a number above 0"),
        ("matern", {"deviation": -0.5}, r"deviation=-0\.5: give a number above 0"),
        ("composite", {"parts": {}}, "parts is empty"),
        ("composite", {"parts": {"ridge": 1.0}}, "regularization=ridge is unknown"),
        ("composite", {"parts": {"smoothness": 0.0}}, r"parts\.smoothness=0\.0: give a share"),
        ("composite", {"parts": {"sparsity": {"bogus": 1}}}, "bogus"),
    ],
)
def test_what_cannot_be_used_is_refused(name: str, options: dict, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        PRIORS.build({"name": name, **options})


def test_a_map_of_levels_must_fit_the_mesh() -> None:
    with pytest.raises(ConfigError, match=r"shape \(3,\)"):
        ShiftedPrior(prior=Matern(), mean_mpa=np.ones(3)).on(MESH)


def test_parts_on_a_single_element() -> None:
    mesh = TetMesh(np.vstack([np.zeros(3), np.eye(3)]), np.array([[0, 1, 2, 3]]))
    whole = Composite(parts={"total_variation": 1.0, "none": 2.0}).on(mesh)
    assert whole.value(np.array([0.3])) == 0.0
