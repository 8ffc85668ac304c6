"""Weights chosen without the truth: the linearised problem, its rules, and the raised weight."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp

from tactorch.errors import ConfigError
from tactorch.inverse import GaussNewton, Reconstruction, Settings, invert_map
from tactorch.inverse.fit.optimizers.spectrum import (
    RULES,
    Spectrum,
    gcv_score,
    gcv_weight,
    l_curve_weight,
)
from tactorch.recording import Recording

SIZE = 60


def smooth_problem(seed: int, noise: float, data: int = 90) -> tuple[np.ndarray, ...]:
    """A blurred signal with noise: Jacobian, data, truth; residuals at zero are minus the data."""
    rng = np.random.default_rng(seed)
    at = np.linspace(0.0, 1.0, SIZE)
    seen = np.linspace(0.0, 1.0, data)
    jacobian = np.exp(-0.5 * ((seen[:, None] - at) / 0.05) ** 2)
    truth = np.sin(2 * np.pi * at) + 0.5 * (at > 0.6)
    return jacobian, jacobian @ truth + noise * rng.standard_normal(data), truth


def bends() -> sp.csr_matrix:
    difference = np.diff(np.eye(SIZE), axis=0)
    return sp.csr_matrix(difference.T @ difference)


def decomposed(jacobian: np.ndarray, data: np.ndarray) -> Spectrum:
    spectrum = Spectrum.of(jacobian, -data, bends(), np.zeros(SIZE))
    assert spectrum is not None
    return spectrum


def solved(jacobian: np.ndarray, data: np.ndarray, weight: float) -> np.ndarray:
    prior = bends().toarray()
    prior += 1e-6 * np.trace(prior) / SIZE * np.eye(SIZE)
    return np.linalg.solve(jacobian.T @ jacobian + weight * prior, jacobian.T @ data)


@pytest.mark.parametrize("n_data", [SIZE // 2, 90])
def test_the_spectrum_solves_every_weight(n_data: int) -> None:
    """Through the elements' space or the data's, whichever is smaller; from any point."""
    jacobian, data, _ = smooth_problem(0, 0.1, n_data)
    here = np.random.default_rng(1).standard_normal(SIZE)
    prior = bends().toarray()
    prior += 1e-6 * np.trace(prior) / SIZE * np.eye(SIZE)
    spectrum = Spectrum.of(jacobian, jacobian @ here - data, bends(), prior @ here)
    assert spectrum is not None
    weights = spectrum.squares.max() * np.array([1.0, 1e-3, 1e-6])
    misfits, penalties = spectrum.misfits(weights), spectrum.penalties(weights)
    freedom = spectrum.freedom(weights)
    for i, weight in enumerate(weights):
        best = solved(jacobian, data, weight)
        inner = jacobian.T @ jacobian
        used = np.trace(np.linalg.solve(inner + weight * prior, inner))
        assert misfits[i] == pytest.approx(np.sum((jacobian @ best - data) ** 2), rel=1e-4)
        assert freedom[i] == pytest.approx(used, rel=1e-4)
        assert penalties[i] == pytest.approx(0.5 * best @ prior @ best, rel=1e-4)


@pytest.mark.parametrize("rule", [gcv_weight, l_curve_weight])
def test_a_rule_comes_near_the_best_weight(rule: Callable[[Spectrum], float]) -> None:
    """Over noises never told to it; the error of the signal is at most twice the least."""
    ratios = []
    for seed in range(10):
        jacobian, data, truth = smooth_problem(seed, 0.3)
        spectrum = decomposed(jacobian, data)
        errors = [np.linalg.norm(solved(jacobian, data, w) - truth) for w in spectrum.weights()]
        chosen = np.linalg.norm(solved(jacobian, data, rule(spectrum)) - truth)
        ratios.append(chosen / min(errors))
    assert np.median(ratios) < 2.0


def test_gcv_gives_more_noise_more_weight_and_ignores_its_scale() -> None:
    chosen = [gcv_weight(decomposed(*smooth_problem(3, noise)[:2])) for noise in (0.01, 0.1, 1.0)]
    assert chosen[0] < chosen[1] < chosen[2]
    jacobian, data, _ = smooth_problem(3, 0.1)
    scaled = gcv_weight(decomposed(7.0 * jacobian, 7.0 * data))
    assert scaled == pytest.approx(49.0 * chosen[1], rel=1e-3)


def test_gcv_is_leave_one_out_on_average() -> None:
    """Where all data weigh alike (a circulant problem), the score is the left-out error itself."""
    n = 24
    distance = np.abs(np.arange(n)[:, None] - np.arange(n))
    jacobian = np.exp(-np.minimum(distance, n - distance) / 3.0)
    data = np.random.default_rng(0).standard_normal(n)
    spectrum = Spectrum.of(jacobian, -data, sp.identity(n, format="csr"), np.zeros(n))
    assert spectrum is not None
    weight = 2.0
    errors = []
    for out in range(n):
        keep = np.arange(n) != out
        inner = jacobian[keep].T @ jacobian[keep] + weight * np.eye(n)
        foretold = jacobian[out] @ np.linalg.solve(inner, jacobian[keep].T @ data[keep])
        errors.append((foretold - data[out]) ** 2)
    found = gcv_score(spectrum, np.array([weight]))[0]
    assert found == pytest.approx(np.mean(errors), rel=1e-4)


def test_a_prior_that_cannot_be_factored_is_a_value() -> None:
    jacobian, data, _ = smooth_problem(0, 0.1)
    negative = sp.csr_matrix(-np.eye(SIZE))
    assert Spectrum.of(jacobian, data, negative, np.zeros(SIZE)) is None


@pytest.fixture(scope="module")
def noisy(make_cube: Callable[..., Recording]) -> Recording:
    return make_cube(snr_db=20.0, seed=1)


def run(recording: Recording, rule: str = "discrepancy", **others: object) -> Reconstruction:
    optimizer = GaussNewton(weight_rule=rule, max_iterations=60)
    return invert_map(recording, Settings(optimizer=optimizer), show_progress=False, **others)  # type: ignore[arg-type]


def test_an_overfit_is_taken_back(noisy: Recording) -> None:
    """Few data, many elements: the map that first fits to the noise goes on to overfit."""
    found = run(noisy)
    weights = [entry["weight"] for entry in found.history]
    assert weights[-1] > min(weights)
    assert 0.85 <= found.history[-1]["chi2"] <= 1.05
    assert "fitted to their noise" in found.stop_reason


def test_an_assumed_noise_raises_no_weight(cube: Recording) -> None:
    assumed = run(replace(cube, presses=tuple(replace(p, noise_mm=None) for p in cube.presses)))
    weights = np.array([entry["weight"] for entry in assumed.history])
    assert (np.diff(weights) <= 0).all()


@pytest.mark.parametrize("rule", sorted(RULES))
def test_a_rule_settles(noisy: Recording, rule: str) -> None:
    found = run(noisy, rule)
    assert "weight of the prior has converged" in found.stop_reason


@pytest.mark.parametrize(
    "rule",
    ["discrepancy", *(pytest.param(rule, marks=pytest.mark.slow) for rule in ("gcv", "l_curve"))],
)
def test_a_rule_resumes(noisy: Recording, rule: str, tmp_path: Path) -> None:
    whole = run(noisy, rule)
    stop = whole.iterations - 3
    path = tmp_path / "state.npz"
    first = GaussNewton(weight_rule=rule, max_iterations=stop)
    invert_map(noisy, Settings(optimizer=first), checkpoint=path, show_progress=False)
    again = run(noisy, rule, resume=path)
    assert again.iterations == whole.iterations
    np.testing.assert_allclose(again.youngs, whole.youngs, rtol=1e-6)


def test_an_unknown_rule_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"weight_rule='guess': give .*gcv"):
        GaussNewton(weight_rule="guess")
