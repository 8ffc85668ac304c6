"""White Gaussian measurement noise of a given signal-to-noise ratio."""

import numpy as np
from jaxtyping import Bool, Float

from tactorch.errors import ConfigError
from tactorch.mesh.values import Real


def noise_level(signal: Float[np.ndarray, " k"], snr_db: Real) -> float:
    """Return the standard deviation sigma with 20 log10(rms(signal) / sigma) = `snr_db`."""
    if not np.isfinite(snr_db):
        raise ConfigError(f"snr_db={snr_db!r} must be a finite number of decibels, or None.")
    return float(np.sqrt(np.mean(np.square(signal))) * 10.0 ** (-float(snr_db) / 20.0))


def add_noise(
    displacement: Float[np.ndarray, "n 3"],
    observed: Bool[np.ndarray, "n 3"],
    snr_db: Real,
    rng: np.random.Generator,
) -> tuple[Float[np.ndarray, "n 3"], float]:
    """Add white Gaussian noise to the observed degrees of freedom; return its deviation too, mm."""
    sigma = noise_level(displacement[observed], snr_db)
    noisy = displacement.copy()
    noisy[observed] += sigma * rng.standard_normal(int(observed.sum()))
    return noisy, sigma
