"""Costs of residuals: their definitions, derivatives, and what they are for."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactorch.errors import ConfigError
from tactorch.inverse import MISFITS, InverseProblem, Settings, invert_map, make_objective
from tactorch.inverse.data.misfit import Adaptive, Huber
from tactorch.recording import Recording

BEGINS = np.array([0, 7, 12])


def white_of(seed: int, spread: float) -> np.ndarray:
    return spread * np.random.default_rng(seed).standard_normal(20)


@pytest.mark.parametrize("name", MISFITS.names())
@given(seed=st.integers(0, 2**32 - 1), spread=st.sampled_from([0.3, 1.0, 4.0, 100.0]))
@settings(max_examples=20, deadline=None)
def test_derivative_is_symmetric_and_the_finite_difference(
    name: str, seed: int, spread: float
) -> None:
    misfit, white = MISFITS.build(name), white_of(seed, spread)
    matrix = misfit.derivative(white, BEGINS, np.eye(20))
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-12)
    h = 1e-6 * spread
    for direction in np.random.default_rng(seed).standard_normal((3, 20)):
        plus, minus = (misfit.residuals(white + s * h * direction, BEGINS) for s in (1, -1))
        near = np.abs(np.abs(white) - 1.345) < 2 * h * np.abs(direction)  # at Huber's corner
        expected = (plus - minus) / (2 * h)
        np.testing.assert_allclose((matrix @ direction)[~near], expected[~near], atol=1e-5)
        one = misfit.derivative(white, BEGINS, direction)
        np.testing.assert_allclose(one, matrix @ direction, atol=1e-12)


@given(seed=st.integers(0, 2**32 - 1), spread=st.sampled_from([0.5, 3.0, 50.0]))
@settings(max_examples=20, deadline=None)
def test_half_the_square_is_the_cost(seed: int, spread: float) -> None:
    white = white_of(seed, spread)
    size, k = np.abs(white), 1.345
    huber = np.where(size <= k, 0.5 * white**2, k * size - 0.5 * k**2)
    found = Huber().residuals(white, BEGINS)
    np.testing.assert_allclose(0.5 * found**2, huber, rtol=1e-12)
    assert np.all(np.sign(found) == np.sign(white))
    whole = 0.0
    for r in np.split(white, BEGINS[1:]):
        q = np.mean(r**2)
        whole += len(r) * (0.5 * q if q <= 1 else np.sqrt(q) - 0.5)
    adaptive = Adaptive().residuals(white, BEGINS)
    assert 0.5 * adaptive @ adaptive == pytest.approx(whole)


def test_chi2_of_normal_noise_is_one() -> None:
    noise = np.random.default_rng(0).standard_normal(20_000)
    begins = np.arange(0, 20_000, 2_000)
    for name in MISFITS.names():
        assert MISFITS.build(name).chi2(noise, begins) == pytest.approx(1.0, abs=0.03)
    astray = np.where(np.arange(20_000) % 50 == 0, 100.0, noise)
    assert MISFITS.build("huber").chi2(astray, begins) == pytest.approx(1.0, abs=0.1)
    assert MISFITS.build("squares").chi2(astray, begins) > 100


def error_of(recording: Recording, misfit: str) -> float:
    truth = recording.truth
    assert truth is not None
    found = invert_map(replace(recording, truth=None), Settings(misfit=misfit), show_progress=False)
    return float(np.sqrt(np.mean(np.log(found.youngs / truth) ** 2)))


@pytest.mark.slow
def test_huber_bears_stray_markers(make_cube: Callable[..., Recording]) -> None:
    clean = make_cube(snr_db=40.0)
    rng = np.random.default_rng(1)
    presses = []
    for press in clean.presses:
        stray = press.data & (rng.random(press.data.shape) < 0.03)
        kick = np.where(stray, rng.choice([-0.5, 0.5], press.data.shape), 0.0)
        presses.append(replace(press, displacement=press.displacement + kick))
    dirty = replace(clean, presses=tuple(presses), check_units=False)
    best = error_of(clean, "squares")
    assert error_of(dirty, "huber") < 1.5 * best
    assert error_of(dirty, "squares") > 2.0 * best


@pytest.mark.slow
def test_adaptive_weights_bear_a_bad_press(make_cube: Callable[..., Recording]) -> None:
    clean = make_cube(snr_db=40.0)
    rng = np.random.default_rng(1)
    worst = clean.presses[1]
    sigma = 20.0 * float(worst.noise_mm or 0.0)
    bad = replace(worst, displacement=worst.displacement + sigma * rng.standard_normal((64, 3)))
    dirty = replace(clean, presses=(clean.presses[0], bad, clean.presses[2]), check_units=False)
    assert error_of(dirty, "adaptive") < 1.2 * error_of(clean.select([0, 2]), "squares")
    problem = make_objective(dirty, Settings(misfit="adaptive")).problem
    factors = [
        plain.scale[0] / seen.scale[0]
        for plain, seen in zip(
            InverseProblem(dirty).data.observations, problem.data.observations, strict=True
        )
    ]
    assert factors[0] < 1.5
    assert factors[2] < 1.5
    assert factors[1] > 5.0


@pytest.mark.parametrize("name", MISFITS.names())
def test_gradients_of_the_objective_hold(
    recording: Recording, moduli: np.ndarray, name: str
) -> None:
    problem = InverseProblem(recording, misfit=MISFITS.build(name))

    def cost(youngs: np.ndarray) -> float:
        residuals = problem.evaluate(youngs).residuals
        return 0.5 * float(residuals @ residuals)

    at = problem.evaluate(moduli)
    direction = np.random.default_rng(0).standard_normal(len(moduli))
    expected = (cost(moduli + 1e-5 * direction) - cost(moduli - 1e-5 * direction)) / 2e-5
    assert at.gradient() @ direction == pytest.approx(expected, rel=1e-5)
    np.testing.assert_allclose(at.jacobian().T @ at.residuals, at.gradient(), rtol=1e-6)


def test_each_press_has_a_figure(recording: Recording, moduli: np.ndarray) -> None:
    at = InverseProblem(recording).evaluate(moduli)
    sizes = [int(press.data.sum()) for press in recording.presses]
    figures = [np.mean(r**2) for r in at.deviations]
    assert np.average(figures, weights=sizes) == pytest.approx(at.chi2)


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(ConfigError, match="misfit=l1 is unknown"):
        MISFITS.build("l1")
    with pytest.raises(ConfigError, match=r"misfit.edge=0"):
        Huber(0.0)
