"""Tractions that explain displacements and are no rougher than these ask for.

Of all tractions those are the likeliest that differ little between neighbours. How little is told
by the displacements themselves: the weight of smoothness is where they are likeliest of all
(restricted maximum likelihood: Patterson and Thompson, 1971). A traction that is the same all over
costs nothing, so smoothness does not take from the total force.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import minimize_scalar

_FLAT = 1e-9  # eigenvalue of roughness, relative to the largest, of what is not rough at all
_WEIGHTS = np.arange(-14.0, 4.0, 0.5)  # decades about the largest eigenvalue


@dataclass(frozen=True, eq=False)
class Roughness:
    """Forces on nodes as free uniform tractions, and rough ones of unit expected size.

    Attributes:
        uniform: Nodal forces under uniform tractions, one for each part of the contact and axis.
        rough: Nodal forces under tractions that count as equally rough.
    """

    uniform: Float[np.ndarray, "f u"]
    rough: Float[np.ndarray, "f r"]

    @staticmethod
    def between(edges: Int[np.ndarray, "e 2"], areas: Float[np.ndarray, " n"]) -> "Roughness":
        """Count squared differences of the traction along edges as roughness.

        Args:
            edges: Pairs of neighbours among n nodes.
            areas: What each node stands for, mm^2.
        """
        laplacian = np.zeros((len(areas), len(areas)))
        first, second = edges.T
        np.add.at(laplacian, (first, first), 1.0)
        np.add.at(laplacian, (second, second), 1.0)
        np.add.at(laplacian, (first, second), -1.0)
        np.add.at(laplacian, (second, first), -1.0)
        values, vectors = np.linalg.eigh(laplacian)
        flat = values <= _FLAT * max(values.max(), 1.0)
        vectors = vectors * areas[:, None]
        axes = np.eye(3)
        root = vectors[:, ~flat] / np.sqrt(values[~flat])
        return Roughness(np.kron(vectors[:, flat], axes), np.kron(root, axes))


@dataclass(frozen=True, eq=False)
class Smoothed:
    """The likeliest forces.

    Attributes:
        forces: Flat, three for each node, N.
        total_covariance: Of the sum of the forces, N^2.
        noise_mm: Standard deviation that the displacements show, or the stated one if larger.
    """

    forces: Float[np.ndarray, " f"]
    total_covariance: Float[np.ndarray, "3 3"]
    noise_mm: float


def smoothed(
    compliance: Float[np.ndarray, "d f"],
    plane: Float[np.ndarray, "d p"],
    wanted: Float[np.ndarray, " d"],
    prior: Roughness,
    noise_mm: float,
) -> Smoothed:
    """Find the forces behind displacements that are known but for a plane.

    Args:
        compliance: Displacement under unit forces, mm/N.
        plane: Displacements that may be added freely, mm.
        wanted: Displacements to explain, mm.
        prior: What is rough.
        noise_mm: Standard deviation of the displacements; taken larger where they show that.
    """
    free = np.hstack([compliance @ prior.uniform, plane])
    basis, _ = np.linalg.qr(free)
    bent = compliance @ prior.rough
    apart = bent - basis @ (basis.T @ bent)
    rest = wanted - basis @ (basis.T @ wanted)
    values, vectors = np.linalg.eigh(apart.T @ apart)
    values = np.maximum(values, 0.0)
    modes = vectors.T @ (apart.T @ rest)
    count = len(wanted) - free.shape[1]
    spectrum = _Spectrum(values, modes, float(rest @ rest), count, noise_mm)
    weight = spectrum.weight()
    amplitudes = vectors @ (modes / (values + weight))
    uniform = np.linalg.lstsq(free, wanted - bent @ amplitudes, rcond=None)[0]
    n = prior.uniform.shape[1]
    forces = prior.rough @ amplitudes + prior.uniform @ uniform[:n]
    every = np.hstack([bent, free])
    precision = every.T @ every
    precision[np.diag_indices(len(amplitudes))] += weight
    total = np.hstack([_sums(prior.rough), _sums(prior.uniform), np.zeros((3, plane.shape[1]))])
    variance = spectrum.variance(weight)
    load_matrix = np.linalg.lstsq(precision, total.T, rcond=None)[0]
    return Smoothed(forces, variance * total @ load_matrix, float(np.sqrt(variance)))


def _sums(forces: Float[np.ndarray, "f c"]) -> Float[np.ndarray, "3 c"]:
    return forces.reshape(len(forces) // 3, 3, forces.shape[1]).sum(axis=0)


@dataclass(frozen=True, eq=False)
class _Spectrum:
    """Displacements and rough tractions, seen along the latter's principal axes.

    Attributes:
        values: Squared displacement of each axis.
        modes: Displacements' product with each axis.
        size: Of the displacements, squared.
        count: Of displacements, less what is free.
        noise_mm: That is stated.
    """

    values: Float[np.ndarray, " r"]
    modes: Float[np.ndarray, " r"]
    size: float
    count: int
    noise_mm: float

    def weight(self) -> float:
        """Return the weight of smoothness, variance of noise over that of roughness."""
        scale = np.log(max(float(self.values.max(initial=0.0)), 1e-300))
        tried = scale + np.log(10.0) * _WEIGHTS
        best = int(np.argmin([self._unlikely(x) for x in tried]))
        around = tried[max(best - 1, 0)], tried[min(best + 1, len(tried) - 1)]
        found = minimize_scalar(self._unlikely, bounds=around, method="bounded")
        return float(np.exp(found.x))

    def variance(self, weight: float) -> float:
        """Return the variance of noise: what the displacements show, or the stated if larger."""
        shown = self.size - float((self.modes**2 / (self.values + weight)).sum())
        return max(shown / max(self.count, 1), self.noise_mm**2, 1e-300)

    def _unlikely(self, log_weight: float) -> float:
        """Minus twice the logarithm of the restricted likelihood, but for a constant."""
        weight = float(np.exp(log_weight))
        shown = self.size - float((self.modes**2 / (self.values + weight)).sum())
        variance = self.variance(weight)
        volume = float(np.log1p(self.values / weight).sum())
        return shown / variance + self.count * np.log(variance) + volume
