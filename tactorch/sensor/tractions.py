"""Smooth tractions that explain noisy displacements.

The prior penalizes differences of the traction between neighbors. Its weight maximizes the
restricted likelihood of the displacements (REML; Patterson and Thompson, 1971). A uniform traction
is not penalized, so that the prior does not bias the total force.
"""

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import minimize_scalar
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import laplacian

_NULL_EIGENVALUE = 1e-9  # of the roughness, relative to the largest
_LOG10_WEIGHTS = np.arange(-14.0, 4.0, 0.5)  # relative to the largest eigenvalue


def traction_basis(
    edges: Int[np.ndarray, "e 2"], areas: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "f u"], Float[np.ndarray, "f r"]]:
    """Return nodal forces of uniform tractions, and of rough tractions of unit prior variance.

    Each part of the contact and axis has a uniform traction. Roughness is the sum of squared
    differences of the traction along edges; `areas` of the nodes are in mm^2.
    """
    adjacency = coo_matrix((np.ones(len(edges)), edges.T), shape=(len(areas), len(areas)))
    values, vectors = np.linalg.eigh(laplacian(adjacency + adjacency.T).toarray())
    uniform = values <= _NULL_EIGENVALUE * max(values.max(), 1.0)
    vectors = vectors * areas[:, None]
    rough = vectors[:, ~uniform] / np.sqrt(values[~uniform])
    return np.kron(vectors[:, uniform], np.eye(3)), np.kron(rough, np.eye(3))


def fit_smooth_forces(
    compliance: Float[np.ndarray, "d f"],
    plane: Float[np.ndarray, "d p"],
    target: Float[np.ndarray, " d"],
    basis: tuple[Float[np.ndarray, "f u"], Float[np.ndarray, "f r"]],
    noise_mm: float,
) -> tuple[Float[np.ndarray, " f"], Float[np.ndarray, "3 3"], float]:
    """Fit smooth forces, with a `traction_basis`, to displacements known up to modes `plane`.

    Returns:
        Nodal forces, N; covariance of their sum, N^2; estimated standard deviation of the
        displacements, at least `noise_mm`.
    """
    free = np.hstack([compliance @ basis[0], plane])
    rough = compliance @ basis[1]
    axes, _ = np.linalg.qr(free)
    projected = rough - axes @ (axes.T @ rough)
    residual = target - axes @ (axes.T @ target)
    values, vectors = np.linalg.eigh(projected.T @ projected)
    values = np.maximum(values, 0.0)
    modes = vectors.T @ (projected.T @ residual)
    count = len(target) - free.shape[1]
    weight, variance = _estimate_weight(values, modes, float(residual @ residual), count, noise_mm)
    amplitudes = vectors @ (modes / (values + weight))
    uniform = np.linalg.lstsq(free, target - rough @ amplitudes, rcond=None)[0]
    forces = basis[1] @ amplitudes + basis[0] @ uniform[: basis[0].shape[1]]
    design = np.hstack([rough, free])
    precision = design.T @ design
    precision[np.diag_indices(len(amplitudes))] += weight
    sums = np.tile(np.eye(3), len(forces) // 3)
    total = np.hstack([sums @ basis[1], sums @ basis[0], np.zeros((3, plane.shape[1]))])
    covariance = np.linalg.lstsq(precision, total.T, rcond=None)[0]
    return forces, variance * total @ covariance, float(np.sqrt(variance))


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
