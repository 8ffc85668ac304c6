"""Smooth tractions that explain noisy displacements.

The prior penalizes differences of the traction between neighbors. Its weight maximizes the
restricted likelihood of the displacements (REML; Patterson and Thompson, 1971). A uniform traction
is not penalized, so that the prior does not bias the total force.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import minimize_scalar
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import laplacian

_NULL_EIGENVALUE = 1e-9  # of the roughness, relative to the largest
_LOG10_WEIGHTS = np.arange(-14.0, 4.0, 0.5)  # relative to the largest eigenvalue

Basis = tuple[Float[np.ndarray, "f u"], Float[np.ndarray, "f r"]]
Target = Float[np.ndarray, " d"]
Forces = Float[np.ndarray, " f"]


def traction_basis(
    edges: Int[np.ndarray, "e 2"], areas: Float[np.ndarray, " n"], axes: Sequence[int] = (0, 1, 2)
) -> Basis:
    """Return nodal forces of uniform tractions, and of rough tractions of unit prior variance.

    Each part of the contact and axis has a uniform traction. Roughness is the sum of squared
    differences of the traction along edges; `areas` of the nodes are in mm^2. Only components along
    `axes` act.
    """
    adjacency = coo_matrix((np.ones(len(edges)), edges.T), shape=(len(areas), len(areas)))
    values, vectors = np.linalg.eigh(laplacian(adjacency + adjacency.T).toarray())
    uniform = values <= _NULL_EIGENVALUE * max(values.max(), 1.0)
    vectors = vectors * areas[:, None]
    rough = vectors[:, ~uniform] / np.sqrt(values[~uniform])
    components = np.eye(3)[:, list(axes)]
    return np.kron(vectors[:, uniform], components), np.kron(rough, components)


class SmoothFit:
    """Fit of smooth forces to displacements, prepared for several displacements of one contact.

    Args:
        compliance: Displacements by unit nodal forces, (d, f), mm/N.
        plane: Displacements that the data do not determine, such as a constant and tilts, (d, p).
        basis: Result of `traction_basis`, (f, u) and (f, r).
    """

    def __init__(
        self, compliance: Float[np.ndarray, "d f"], plane: Float[np.ndarray, "d p"], basis: Basis
    ) -> None:
        self.basis, self._n_plane = basis, plane.shape[1]
        self._free = np.hstack([compliance @ basis[0], plane])
        self._rough = compliance @ basis[1]
        self._axes, triangle = np.linalg.qr(self._free)
        self._inverse = np.linalg.pinv(triangle)  # of the free modes, after the rotation to axes
        self._projected = self._rough - self._axes @ (self._axes.T @ self._rough)
        values, self._vectors = np.linalg.eigh(self._projected.T @ self._projected)
        self._values, self._weight = np.maximum(values, 0.0), 0.0
        self._variance = 1.0

    def fit(
        self, target: Target, noise_mm: float
    ) -> tuple[Forces, Float[np.ndarray, "3 3"], float]:
        """Fit smooth forces to displacements.

        Returns:
            Nodal forces, N; covariance of their sum, N^2; estimated standard deviation of the
            displacements, at least `noise_mm`.
        """
        residual, modes = self._project(target)
        count, square = len(target) - self._free.shape[1], float(residual @ residual)
        weight, variance = _estimate_weight(self._values, modes, square, count, noise_mm)
        self._weight, self._variance = weight, variance
        return self.refit(target), variance * self._covariance(weight), float(np.sqrt(variance))

    def refit(self, target: Target) -> Forces:
        """Return the forces for displacements with the weight of the last `fit`: a linear map."""
        _, modes = self._project(target)
        amplitudes = self._vectors @ (modes / (self._values + self._weight))
        left = target - self._rough @ amplitudes
        uniform = self._inverse @ (self._axes.T @ left)
        forces = self.basis[1] @ amplitudes + self.basis[0] @ uniform[: self.basis[0].shape[1]]
        return np.asarray(forces)

    def _project(self, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Displacements without the free modes, and their products with the principal axes."""
        residual = target - self._axes @ (self._axes.T @ target)
        return residual, self._vectors.T @ (self._projected.T @ residual)

    def errors(self) -> Float[np.ndarray, "f m"]:
        """Return independent errors of unit deviation of the forces of the last `fit`."""
        modes = np.hstack([self._free, self._rough])
        precision = modes.T @ modes
        n_free, n_uniform = self._free.shape[1], self.basis[0].shape[1]
        rough = np.arange(n_free, len(precision))
        precision[rough, rough] += self._weight
        values, vectors = np.linalg.eigh(precision)
        known = values > _NULL_EIGENVALUE * values[-1]
        root = vectors[:, known] * np.sqrt(self._variance / values[known])
        return self.basis[0] @ root[:n_uniform] + self.basis[1] @ root[n_free:]

    def _covariance(self, weight: float) -> Float[np.ndarray, "3 3"]:
        """Covariance of the sum of the forces at unit variance; free modes are eliminated."""
        uniform, rough = (
            part.reshape(len(part) // 3, 3, part.shape[1]).sum(axis=0) for part in self.basis
        )
        free = np.hstack([uniform, np.zeros((3, self._n_plane))]) @ self._inverse
        along = (rough - free @ (self._axes.T @ self._rough)) @ self._vectors
        return free @ free.T + (along / (self._values + weight)) @ along.T


def _estimate_weight(
    values: np.ndarray, modes: np.ndarray, squared_norm: float, count: int, noise_mm: float
) -> tuple[float, float]:
    """Weight of the prior (variance of the noise over that of the roughness), and noise variance.

    `values` are squared displacements of the principal axes of the rough tractions, `modes` their
    products with the displacements, whose squared norm is given, `count` displacements less modes.
    """

    def misfit(weight: float) -> float:
        return squared_norm - float((modes**2 / (values + weight)).sum())

    def variance(weight: float) -> float:
        return max(misfit(weight) / max(count, 1), noise_mm**2, 1e-300)

    def negative_log(log_weight: float) -> float:  # of the restricted likelihood, doubled
        weight = float(np.exp(log_weight))
        noise, log_determinant = variance(weight), float(np.log1p(values / weight).sum())
        return misfit(weight) / noise + count * np.log(noise) + log_determinant

    scale = np.log(max(float(values.max(initial=0.0)), 1e-300))
    grid = scale + np.log(10.0) * _LOG10_WEIGHTS
    best = int(np.argmin([negative_log(x) for x in grid]))
    bounds = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
    weight = float(np.exp(minimize_scalar(negative_log, bounds=bounds, method="bounded").x))
    return weight, variance(weight)
