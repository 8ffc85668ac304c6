import numpy as np
import pytest

from tactorch.errors import ConfigError
from tactorch.simulation.pipeline import add_noise, noise_level

RNG = np.random.default_rng(3)


@pytest.mark.parametrize("snr_db", [-3.0, 0.0, 10.0, 20.0])
def test_level_is_by_the_formula(snr_db: float) -> None:
    signal = RNG.normal(size=50)
    sigma = noise_level(signal, snr_db)
    assert 20 * np.log10(np.sqrt((signal**2).mean()) / sigma) == pytest.approx(snr_db)


def test_noise_has_the_ratio_and_stays_on_what_is_observed() -> None:
    exact = RNG.normal(size=(40_000, 3)) * [1.0, 2.0, 5.0]
    observed = RNG.random((40_000, 3)) < 0.5
    noisy, sigma = add_noise(exact, observed, 20.0, np.random.default_rng(0))
    error = noisy - exact
    assert not error[~observed].any()
    seen, signal = error[observed], exact[observed]
    # Five standard errors of a variance over this many draws.
    slack = 5.0 * np.sqrt(2.0 / len(seen))
    assert (seen**2).mean() == pytest.approx(sigma**2, rel=slack)
    assert 10 * np.log10((signal**2).mean() / (seen**2).mean()) == pytest.approx(20.0, abs=0.1)
    assert abs(seen.mean()) < 5.0 * sigma / np.sqrt(len(seen))
    per_axis = [error[observed[:, i], i].std() for i in range(3)]
    np.testing.assert_allclose(per_axis, sigma, rtol=0.05)


@pytest.mark.parametrize("snr_db", [float("nan"), float("inf")])
def test_ratio_must_be_finite(snr_db: float) -> None:
    with pytest.raises(ConfigError, match="snr_db"):
        noise_level(np.ones(3), snr_db)
