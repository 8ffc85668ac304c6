"""Smooth tractions that explain noisy displacements.

The prior penalizes differences of the traction between neighbors. Its weight maximizes the
restricted likelihood of the displacements (REML; Patterson and Thompson, 1971). A uniform traction
is not penalized, so that the prior does not bias the total force.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import minimize_scalar

_NULL_EIGENVALUE = 1e-9  # of the roughness, relative to the largest
_LOG10_WEIGHTS = np.arange(-14.0, 4.0, 0.5)  # relative to the largest eigenvalue


@dataclass(frozen=True, eq=False)
class Roughness:
    """Basis of nodal forces: uniform tractions, and rough tractions of unit prior variance.

    Attributes:
        uniform: Nodal forces of a uniform traction, for each part of the contact and axis.
        rough: Nodal forces of tractions with equal roughness.
    """

    uniform: Float[np.ndarray, "f u"]
    rough: Float[np.ndarray, "f r"]

    @staticmethod
    def from_edges(edges: Int[np.ndarray, "e 2"], areas: Float[np.ndarray, " n"]) -> "Roughness":
        """Measure roughness by squared differences of the traction along edges.

        Args:
            edges: Pairs of neighbors among n nodes.
            areas: Area of each node, mm^2.

        Returns:
            The basis.
        """
        laplacian = np.zeros((len(areas), len(areas)))
        first, second = edges.T
        np.add.at(laplacian, (first, first), 1.0)
        np.add.at(laplacian, (second, second), 1.0)
        np.add.at(laplacian, (first, second), -1.0)
        np.add.at(laplacian, (second, first), -1.0)
        values, vectors = np.linalg.eigh(laplacian)
        uniform = values <= _NULL_EIGENVALUE * max(values.max(), 1.0)
        vectors = vectors * areas[:, None]
        axes = np.eye(3)
        rough = vectors[:, ~uniform] / np.sqrt(values[~uniform])
        return Roughness(np.kron(vectors[:, uniform], axes), np.kron(rough, axes))


@dataclass(frozen=True, eq=False)
class SmoothForces:
    """Most likely smooth forces.

    Attributes:
        forces: Forces, three per node, N.
        total_covariance: Covariance of the sum of the forces, N^2.
        noise_mm: Estimated standard deviation of the displacements, at least the given one.
    """

    forces: Float[np.ndarray, " f"]
    total_covariance: Float[np.ndarray, "3 3"]
    noise_mm: float


def fit_smooth_forces(
    compliance: Float[np.ndarray, "d f"],
    plane: Float[np.ndarray, "d p"],
    target: Float[np.ndarray, " d"],
    prior: Roughness,
    noise_mm: float,
) -> SmoothForces:
    """Fit smooth forces to displacements that are known up to free modes.

    Args:
        compliance: Displacements for unit forces, mm/N.
        plane: Displacement modes that are not known, mm.
        target: Measured displacements, mm.
        prior: Basis of the forces.
        noise_mm: Lower bound of the standard deviation of the displacements.

    Returns:
        The forces.
    """
    free = np.hstack([compliance @ prior.uniform, plane])
    basis, _ = np.linalg.qr(free)
    rough = compliance @ prior.rough
    projected = rough - basis @ (basis.T @ rough)
    residual = target - basis @ (basis.T @ target)
    values, vectors = np.linalg.eigh(projected.T @ projected)
    values = np.maximum(values, 0.0)
    modes = vectors.T @ (projected.T @ residual)
    count = len(target) - free.shape[1]
    likelihood = _RestrictedLikelihood(values, modes, float(residual @ residual), count, noise_mm)
    weight = likelihood.best_weight()
    amplitudes = vectors @ (modes / (values + weight))
    uniform = np.linalg.lstsq(free, target - rough @ amplitudes, rcond=None)[0]
    n = prior.uniform.shape[1]
    forces = prior.rough @ amplitudes + prior.uniform @ uniform[:n]
    design = np.hstack([rough, free])
    precision = design.T @ design
    precision[np.diag_indices(len(amplitudes))] += weight
    total = np.hstack(
        [
            _component_sums(prior.rough),
            _component_sums(prior.uniform),
            np.zeros((3, plane.shape[1])),
        ]
    )
    variance = likelihood.variance(weight)
    covariance = np.linalg.lstsq(precision, total.T, rcond=None)[0]
    return SmoothForces(forces, variance * total @ covariance, float(np.sqrt(variance)))


def _component_sums(forces: Float[np.ndarray, "f c"]) -> Float[np.ndarray, "3 c"]:
    return forces.reshape(len(forces) // 3, 3, forces.shape[1]).sum(axis=0)


@dataclass(frozen=True, eq=False)
class _RestrictedLikelihood:
    """Restricted likelihood of the displacements, in the principal axes of the rough tractions.

    Attributes:
        values: Eigenvalues: squared displacement of each axis.
        modes: Product of the displacements with each axis.
        squared_norm: Squared norm of the displacements.
        count: Number of displacements less that of free modes.
        noise_mm: Lower bound of the standard deviation.
    """

    values: Float[np.ndarray, " r"]
    modes: Float[np.ndarray, " r"]
    squared_norm: float
    count: int
    noise_mm: float

    def best_weight(self) -> float:
        """Return the weight of the prior: variance of the noise over that of the roughness."""
        scale = np.log(max(float(self.values.max(initial=0.0)), 1e-300))
        grid = scale + np.log(10.0) * _LOG10_WEIGHTS
        best = int(np.argmin([self._negative_log(x) for x in grid]))
        bounds = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
        minimum = minimize_scalar(self._negative_log, bounds=bounds, method="bounded")
        return float(np.exp(minimum.x))

    def variance(self, weight: float) -> float:
        """Return the variance of the noise: estimated, at least the given one."""
        return max(self._misfit(weight) / max(self.count, 1), self.noise_mm**2, 1e-300)

    def _misfit(self, weight: float) -> float:
        return self.squared_norm - float((self.modes**2 / (self.values + weight)).sum())

    def _negative_log(self, log_weight: float) -> float:
        """Minus twice the logarithm of the restricted likelihood, up to a constant."""
        weight = float(np.exp(log_weight))
        variance = self.variance(weight)
        log_determinant = float(np.log1p(self.values / weight).sum())
        return self._misfit(weight) / variance + self.count * np.log(variance) + log_determinant
