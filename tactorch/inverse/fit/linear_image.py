"""A linear image from presses on a coarse grid, cheap and independent of the mesh.

The presses are linearised at the best uniform modulus, and log E over it gets a Gaussian prior on
the cells of the body's box; image and certainty are then one small dense solve (Tarantola, 2005,
eq. 3.37 and 3.38). Lengths are shares of the box, so the prior has no unit.
"""

from functools import lru_cache

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float
from scipy.linalg import cho_factor, cho_solve

from tactorch.inverse.fit.starts import uniform_fit
from tactorch.inverse.forward.problem import Evaluation, InverseProblem
from tactorch.mesh import TetMesh, VoxelGrid
from tactorch.recording import Recording

# Of the prior: standard deviation of log E, correlation length, and deviation of the mean.
_SPREAD, _LENGTH, _SHIFT = 0.7, 0.2, 0.3
# Error of mesh and linearisation relative to a press's displacement.
_FLOOR = 0.02
_MAX_ENTRIES = 5e7  # of a dense sensitivity matrix: 400 MB


def linear_map(recording: Recording, count: int = 8) -> Float[np.ndarray, " m"]:
    """Return the linear image of a recording at its elements, MPa.

    It approximates a reconstruction at the cost of one Gauss-Newton step, with equal blur and noise
    but softer edges. There are `count` cells in each direction.
    """
    problem = InverseProblem(recording)
    fit = uniform_fit(problem)
    evaluation = problem.evaluate(np.full(problem.n_elements, fit.youngs_mpa))
    deviations = problem.noise.deviations(recording)
    image, _ = linear_image(evaluation, recording.mesh, deviations, count)
    return fit.youngs_mpa * np.exp(VoxelGrid(recording.mesh, count).at_elements(image))


def linear_image(
    evaluation: Evaluation, mesh: TetMesh, deviations: list[float], count: int
) -> tuple[Float[np.ndarray, "v v v"], Float[np.ndarray, "v v v"]]:
    """Return log E over the uniform modulus, and the explained fraction of its variance.

    The evaluation is that of a uniform map, with the standard deviation (mm) of each press's data.
    """
    parts = []
    for observation, deviation in zip(evaluation.data.observations, deviations, strict=True):
        spread = 1.0 / observation.scale
        spread[observation.nodal] = deviation
        for part in observation.units:
            observed, known = observation.values[part], spread[part]
            floor = _FLOOR * np.linalg.norm(observed) / np.sqrt(max(len(observed), 1))
            parts.append(known / np.hypot(known, floor))
    weights = np.concatenate(parts)  # of data with the floor, relative to those in the residuals
    chain = sp.diags(evaluation.youngs) @ VoxelGrid(mesh, count).element_weights
    # One solve per datum where the matrix over all elements is small, else one per cell.
    if len(evaluation.residuals) * len(evaluation.youngs) <= _MAX_ENTRIES:
        by_cells = evaluation.jacobian() @ chain
    else:
        columns = (chain[:, [c]].toarray()[:, 0] for c in range(chain.shape[1]))
        by_cells = np.column_stack([evaluation.jacobian_times(column) for column in columns])
    jacobian = weights[:, None] * by_cells
    precision = _prior_precision(count) + jacobian.T @ jacobian
    factor = cho_factor(precision, lower=True, check_finite=False)
    image = -cho_solve(factor, jacobian.T @ (weights * evaluation.residuals))
    variance = cho_solve(factor, np.eye(count**3)).diagonal()
    explained = 1.0 - variance / (_SPREAD**2 + _SHIFT**2)
    return image.reshape((count,) * 3), explained.reshape((count,) * 3)


@lru_cache(maxsize=4)
def _prior_precision(count: int) -> Float[np.ndarray, "cells cells"]:
    axis = (np.arange(count) + 0.5) / count
    cells = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    distance = np.linalg.norm(cells[:, None] - cells[None], axis=-1)
    return np.linalg.inv(_SPREAD**2 * np.exp(-distance / _LENGTH) + _SHIFT**2)
