"""Posterior under total variation with estimated widths, by variational Bayes.

The Laplace approximation takes the curvature of total variation at the map, which depends on the
edge at which the penalty is rounded off, and the weight at which the inversion stopped. Here both
are unknowns. Under the prior p(x | w) ~ w^(m-1) exp(-w sum_f a_f |jump_f|) the normal distribution
nearest to the posterior (of a linear model with flat log w) has

    precision    H = J^T J + w D^T diag(a_f / s_f) D
    each jump's size        s_f^2 = E[jump_f^2] = jump(mean)_f^2 + variance of jump_f
    weight       w = (m - 1) / sum_f a_f s_f

(Babacan, Molina and Katsaggelos, 2009), D taking log-moduli to their jumps and a_f the areas of
faces. A jump that the data cannot tell is as wide as they leave it, not as the edge; and the
uncertainty of a flat map says something about w. The equations are iterated.

Two limits. Like all of its kind the distribution is narrow: deviations were a quarter below those
of samples from the same posterior on 40 elements. And its intervals hold over all elements of many
objects, not within inclusions by themselves, which total variation draws towards what surrounds
them (`benchmarks/calibration.py` counts both).
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
import torch
from jaxtyping import Float, Int
from scipy.sparse.csgraph import connected_components

from tactorch.errors import ConfigError
from tactorch.inverse import Point
from tactorch.inverse.regularization.jumps import jumps, relative_areas
from tactorch.linalg import DenseCholesky
from tactorch.uncertainty.laplace import LaplacePosterior

_TOLERANCE = 0.02  # of the weight, and of every jump's size: deviations go by their root
_MAX_ITERATIONS = 60
_MIN_SIZE = 1e-6  # log-modulus


@dataclass(frozen=True, eq=False)
class VariationalPosterior(LaplacePosterior):
    """A normal distribution of the parameters; its mean is near the map but not the map.

    Attributes:
        weight: Weight of total variation that the data and the map speak for.
        sizes: Root mean square of the jump of log-moduli across each face.
        iterations: How many it took.
    """

    weight: float
    sizes: Float[np.ndarray, " faces"]
    iterations: int


@dataclass(frozen=True, eq=False)
class _Jumps:
    """Jumps of the log-moduli across faces, to first order in x.

    Attributes:
        matrix: Their derivative by x.
        pairs: The elements on either side.
        chain: Derivative of each log-modulus by its parameter.
        now: Their values at the map.
        areas: Relative areas of the faces.
        free: How many directions in the space of maps change some jump.
    """

    matrix: sp.csr_matrix
    pairs: Int[np.ndarray, "faces 2"]
    chain: Float[np.ndarray, " m"]
    now: Float[np.ndarray, " faces"]
    areas: Float[np.ndarray, " faces"]
    free: int

    @staticmethod
    def at(point: Point) -> "_Jumps":
        mesh = point.objective.problem.recording.mesh
        difference = jumps(mesh)
        chain = point.objective.parameterization.slope(point.elements) / point.youngs
        beside = sp.csr_matrix((difference.shape[0], len(point.z)))
        parts, _ = connected_components(difference.T @ difference, directed=False)
        return _Jumps(
            sp.hstack([difference @ sp.diags(chain), beside], format="csr"),
            mesh.adjacency.pairs,
            chain,
            difference @ np.log(point.youngs),
            relative_areas(mesh),
            mesh.n_tets - int(parts),
        )

    def sizes(self, step: np.ndarray, covariance: np.ndarray) -> Float[np.ndarray, " faces"]:
        """Return the root mean square of each jump under a normal distribution of x."""
        (i, j), c = self.pairs.T, self.chain
        own = c**2 * covariance.diagonal()[: len(c)]
        spread = own[i] + own[j] - 2.0 * c[i] * c[j] * covariance[i, j]
        return np.sqrt((self.now + self.matrix @ step) ** 2 + np.maximum(spread, 0.0))

    def weight(self, sizes: np.ndarray) -> float:
        """Return the weight that jumps of these sizes speak for."""
        return self.free / float(self.areas @ sizes)


def has_variational_posterior(point: Point, weight: float) -> bool:
    """Whether `variational_posterior` applies: total variation without a mean, of some weight."""
    return weight > 0 and point.objective.prior.variation is not None


def variational_posterior(
    point: Point,
    weight: float,
    *,
    sizes: Float[np.ndarray, " faces"] | None = None,
    tolerance: float = _TOLERANCE,
    max_iterations: int = _MAX_ITERATIONS,
) -> VariationalPosterior:
    """Take the posterior under total variation near a solution; linear in the data there.

    Costs some tens of inversions of a dense matrix of the unknowns: fit for a thousand or two.

    Args:
        point: The solution.
        weight: Weight of the prior there: the start of the iteration, no more.
        sizes: Of the jumps where the iteration starts; by default those of the map.
        tolerance: Largest relative change of the weight and of the sizes at which it ends.
        max_iterations: After so many it is taken as it is.

    Raises:
        ConfigError: the prior is not total variation, the weight is not positive, or data and
            prior leave something undetermined.
    """
    variation = point.objective.prior.variation
    if variation is None:
        raise ConfigError(
            "the variational posterior is that of total variation without a mean; use "
            "LaplacePosterior with other priors."
        )
    if not weight > 0:
        raise ConfigError(f"weight={weight} of the prior must be above 0.")
    parts = _Jumps.at(point)
    if sizes is None:
        sizes = np.maximum(np.abs(parts.now), variation.edge)
    sizes = np.maximum(sizes, _MIN_SIZE)  # a uniform map has no jumps
    hessian, iterations = point.jacobian.T @ point.jacobian, 0
    while iterations < max_iterations:
        iterations += 1
        factor, step = _solve(point, parts, hessian, weight * parts.areas / sizes)
        before = sizes, weight
        sizes = parts.sizes(step, torch.cholesky_inverse(factor.lower).numpy())
        weight = parts.weight(sizes)
        moved = max(np.abs(np.log(sizes / before[0])).max(), abs(np.log(weight / before[1])))
        if moved < tolerance:
            break
    factor, step = _solve(point, parts, hessian, weight * parts.areas / sizes)
    return VariationalPosterior(
        mean=point.elements + step[: len(point.elements)],
        jacobian=point.jacobian,
        factor=factor,
        parameterization=point.objective.parameterization,
        weight=weight,
        sizes=sizes,
        iterations=iterations,
    )


def _solve(
    point: Point, parts: _Jumps, hessian: np.ndarray, stiffness: np.ndarray
) -> tuple[DenseCholesky, Float[np.ndarray, " unknowns"]]:
    """Return the factored precision, and the way from the map to the mean."""
    weighted = parts.matrix.T @ sp.diags(stiffness)
    # Weight 0 leaves the prior of the global unknowns.
    rest = (weighted @ parts.matrix + point.prior_curvature(0.0)).tocoo()
    precision = hessian.copy()
    np.add.at(precision, (rest.row, rest.col), rest.data)
    factor = DenseCholesky.of(precision)
    if factor is None:
        raise ConfigError("data and prior leave some moduli undetermined; add presses.")
    gradient = point.data_gradient + weighted @ parts.now + point.prior_gradient(0.0)
    return factor, -factor.solve(gradient)
