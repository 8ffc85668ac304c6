"""Offset of the force sensor for each probe of a palpation, from samples clear of the surface."""

import logging
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.stats import chi2

from tactorch.importers.samples import NAMED, Samples

_log = logging.getLogger(__name__)
MIN_CLEAR = 3  # samples of a probe, clear of the surface, that tell its offset
_LEVEL = 1e-3  # probability of so different offsets by noise alone, from which they differ
_DRIFT = 5.0  # standard deviations of a drift in time
_OF_DRIFT = 0.5  # of the variance of the offsets, that a drift explains


class Offsets(NamedTuple):
    """Offsets of the force sensor."""

    force_n: Float[np.ndarray, " probes"]
    deviation_n: Float[np.ndarray, " probes"]  # their standard deviation
    clear: int  # number of samples that are clear of the surface


def without_drift(
    samples: Samples, clear: Bool[np.ndarray, " s"], noise_n: float, source: str
) -> Samples:
    """Return the samples without a drift of the force that is the same during each probe.

    Arguments are those of `pool_offsets`. The drift is linear in time, and zero at the mean time of
    the clear samples of a probe.
    """
    count = np.maximum(np.bincount(samples.probe, clear), 1)
    time, force = (
        values - (np.bincount(samples.probe, values * clear) / count)[samples.probe]
        for values in (samples.time, samples.force_n)
    )
    square = float((time**2) @ clear)
    rate = float((time * force) @ clear) / max(square, 1e-300)
    known = (np.bincount(samples.probe, clear) >= MIN_CLEAR)[samples.probe]
    change = np.where(known, rate * time, 0.0)
    if abs(rate) * np.sqrt(square) < _DRIFT * noise_n:
        return samples
    if np.ptp(change) > noise_n:
        _log.warning(
            "'%s': the force in air drifts by up to %.2g N during a probe, which is subtracted.",
            source, np.ptp(change),
        )  # fmt: skip
    return replace(samples, force_n=samples.force_n - change)


def pool_offsets(
    samples: Samples, clear: Bool[np.ndarray, " s"], noise_n: float, source: str
) -> Offsets:
    """Return the offsets of the probes: one for all, or of each, where they differ.

    Offsets are normally distributed about a mean, or a line in time (R. DerSimonian, N. Laird,
    Controlled Clinical Trials 7, 1986, p. 177). Those of probes without enough clear samples are
    on it, with the deviation of the others.

    `clear` tells which samples are clear of the surface, `noise_n` is the standard deviation of the
    noise of each, and `source` the name of the file in messages.
    """
    count = np.bincount(samples.probe, clear)
    known = count >= MIN_CLEAR
    means = np.bincount(samples.probe, samples.force_n * clear) / np.maximum(count, 1)
    variance = noise_n**2 / np.maximum(count, 1)
    time = np.bincount(samples.probe, samples.time) / np.bincount(samples.probe)
    time = (time - time.min()) / max(float(np.ptp(time)), 1e-300)
    flat, line = np.ones((len(count), 1)), np.column_stack([np.ones(len(count)), time])
    basis, trend, spread, errors = flat, *_fit(flat, means, variance, known)
    if spread > 0.0 and known.sum() > 4:
        drift, rest, slope = _fit(line, means, variance, known)
        if rest < (1.0 - _OF_DRIFT) * spread and abs(drift[1]) > _DRIFT * np.sqrt(slope[1, 1]):
            basis, trend, spread, errors = line, drift, rest, slope
    expected = basis @ trend
    _report(samples.names[~known], float(np.std(means[known])), trend, spread, source)
    share = np.where(known, spread / np.maximum(spread + variance, 1e-300), 0.0)
    common = np.einsum("pi,ij,pj->p", basis, errors, basis) * (1.0 - share) ** 2
    deviations = np.sqrt(np.where(known, share * variance, spread) + common)
    return Offsets(expected + share * (means - expected), deviations, int((clear * 1).sum()))


def _report(
    others: np.ndarray,
    deviation_n: float,
    trend: Float[np.ndarray, " b"],
    spread: float,
    source: str,
) -> None:
    """Report offsets that differ, and probes that have those of others."""
    if spread > 0.0 or len(trend) > 1:
        _log.warning(
            "'%s': the force in air differs between probes by more than its noise, with a standard "
            "deviation of %.2g N%s. The offset of each probe is that of its samples in air.",
            source, deviation_n,
            f": it drifts by {trend[1]:.2g} N from the first probe to the last"
            if len(trend) > 1 else "",
        )  # fmt: skip
    if len(others):
        named = ", ".join(f"'{name}'" for name in others[:NAMED])
        (_log.warning if spread > 0.0 else _log.info)(
            "'%s': the offset of %d probes without enough samples in air is taken from the "
            "others, with a standard deviation of %.2g N: %s.",
            source, len(others), np.sqrt(spread), named,
        )  # fmt: skip


def _fit(
    basis: Float[np.ndarray, "probes b"],
    means: Float[np.ndarray, " probes"],
    variance: Float[np.ndarray, " probes"],
    known: Bool[np.ndarray, " probes"],
) -> tuple[Float[np.ndarray, " b"], float, Float[np.ndarray, "b b"]]:
    """Return coefficients of the offsets, the variance about them, and the coefficients' errors.

    The variance (N^2) is zero where noise explains the offsets.
    """
    basis, means, variance = basis[known], means[known], variance[known]
    _, within, inverse = _weighted(basis, means, variance)
    weights, free = 1.0 / variance, len(means) - basis.shape[1]
    spread = 0.0
    if free > 0 and within > chi2.ppf(1.0 - _LEVEL, free):
        scale = weights.sum() - np.einsum("pi,ij,pj,p->", basis, inverse, basis, weights**2)
        spread = float((within - free) / scale)
    trend, _, errors = _weighted(basis, means, variance + spread)
    return trend, spread, errors


def _weighted(
    basis: Float[np.ndarray, "probes b"],
    means: Float[np.ndarray, " probes"],
    variance: Float[np.ndarray, " probes"],
) -> tuple[Float[np.ndarray, " b"], float, Float[np.ndarray, "b b"]]:
    """Return a weighted fit, its chi2 and the covariance of its coefficients."""
    inverse = np.linalg.pinv(basis.T @ (basis / variance[:, None]))
    trend = inverse @ (basis.T @ (means / variance))
    return trend, float((((means - basis @ trend) ** 2) / variance).sum()), inverse
