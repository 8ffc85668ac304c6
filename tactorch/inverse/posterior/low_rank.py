"""Laplace posterior for large meshes: the prior, updated along a few informative directions.

The precision is H = J^T J + P as in `LaplacePosterior`, but J is applied to vectors only and P is
sparse. With the pairs J^T J v = lambda P v, V^T P V = 1 (Lanczos), the covariance is

    H^-1 = P^-1 - V diag(lambda / (1 + lambda)) V^T

(Flath et al., 2011; Bui-Thanh et al., 2013). Omitted pairs only increase the variances, by at most
`excess`. The prior's variances are exact, from its factorisation.

**Improper priors.** Total variation and smoothness are invariant under a shift of all log-moduli,
so their precision is singular. The mean log-modulus therefore has a normal prior of deviation
`MEAN_DEVIATION`: the term 1 / (m MEAN_DEVIATION^2) on the diagonal. That allows a factor of e^10
either way, more than the range of all solids; its effect in other directions is negligible.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla
from jaxtyping import Float, Int

from tactorch.errors import ConfigError
from tactorch.inverse.fields.parameterization import Parameterization
from tactorch.inverse.fit.objective import Point
from tactorch.inverse.posterior.gaussian import Field, GaussianPosterior
from tactorch.inverse.posterior.laplace import check_weight
from tactorch.linalg.superlu import SparseFactor

Product = Callable[[np.ndarray], np.ndarray]

#: Prior standard deviation of the mean log-modulus.
MEAN_DEVIATION = 10.0


@dataclass(frozen=True, eq=False)
class LowRankPosterior(GaussianPosterior):
    """Normal distribution of the parameters x without a dense matrix.

    Attributes:
        precision: Precision P of the prior; rows beyond the elements are nuisance parameters.
        factor: Factorisation of the precision.
        eigenvalues: Lambda in descending order: precision of data over prior, by direction.
        directions: V, one per column.
    """

    mean: Field
    precision: sp.csr_matrix
    factor: SparseFactor
    eigenvalues: Float[np.ndarray, " r"]
    directions: Float[np.ndarray, "unknowns r"]
    parameterization: Parameterization

    @staticmethod
    def at(point: Point, weight: float, rank: int = 100, *, seed: int = 0) -> "LowRankPosterior":
        """Return the posterior at a point of the objective, by Jacobian-vector products.

        Costs about 3 `rank` products with J and its transpose, each one solve per press.

        Args:
            point: The solution.
            weight: Weight of the prior.
            rank: Number of directions; sufficient if `excess` is small against the variance.
            seed: Seed of the first Lanczos vector.

        Raises:
            ConfigError: the weight is negative, or the prior leaves more than the mean
                undetermined (as with weight 0).
        """
        check_weight(weight)
        slope = point.objective.elements.parameterization.slope(point.coefficients) / point.youngs
        mean_prior = np.zeros(len(point.x))
        mean_prior[: len(slope)] = slope**2 / (len(slope) * MEAN_DEVIATION**2)
        return LowRankPosterior.of(
            point.coefficients,
            lambda v: point.transpose_times(point.jacobian_times(v)),
            sp.csr_matrix(point.prior_curvature(weight) + sp.diags(mean_prior)),
            point.objective.elements.parameterization,
            rank,
            seed=seed,
        )

    @staticmethod
    def of(
        mean: Field,
        data_hessian: Product,
        precision: sp.csr_matrix,
        parameterization: Parameterization,
        rank: int,
        *,
        seed: int = 0,
    ) -> "LowRankPosterior":
        """Return the posterior of a linear model; see `at`.

        `data_hessian` multiplies a vector by J^T J, and `precision` is that of the prior.
        """
        size = precision.shape[0]
        if not 0 < rank < size:
            raise ConfigError(f"rank={rank} must be at least 1 and below the {size} unknowns.")
        factor = SparseFactor.of(precision)
        if factor is None:
            raise ConfigError(
                "the prior's precision is not positive definite: it leaves moduli undetermined; "
                "give a prior, and a weight above 0."
            )
        hessian, inverse = (
            spla.LinearOperator((size, size), matvec=product, dtype=np.float64)
            for product in (data_hessian, factor.solve)
        )
        start = np.random.default_rng(seed).standard_normal(size)
        values, vectors = spla.eigsh(hessian, rank, M=precision, Minv=inverse, v0=start)
        # Zero eigenvalues may be negative by round-off.
        values, vectors = np.maximum(values[::-1], 0.0), np.ascontiguousarray(vectors[:, ::-1])
        return LowRankPosterior(mean, precision, factor, values, vectors, parameterization)

    def excess(self) -> Field:
        """Return an upper bound of each variance's error by the finite rank.

        No omitted eigenvalue exceeds the last one, and the omitted directions share the prior
        variance that the included ones leave.
        """
        remaining = self.factor.inverse_diagonal - (self.directions**2).sum(axis=1)
        return np.maximum(self._reduction[-1] * remaining[: len(self.mean)], 0.0)

    @property
    def _reduction(self) -> Float[np.ndarray, " r"]:
        """Relative reduction of the prior variance by the data along each direction."""
        return self.eigenvalues / (1.0 + self.eigenvalues)

    def variance(self) -> Field:
        variance = self.factor.inverse_diagonal - self.directions**2 @ self._reduction
        return variance[: len(self.mean)]

    def covariance(self, elements: Int[np.ndarray, " k"]) -> Float[np.ndarray, "k k"]:
        """See `GaussianPosterior.covariance`; one sparse solve per element."""
        columns = np.zeros((len(self.factor.pivots), len(elements)))
        columns[elements, np.arange(len(elements))] = 1.0
        rows = self.directions[elements]
        prior = self.factor.solve(columns)[elements]
        return 0.5 * (prior + prior.T) - (rows * self._reduction) @ rows.T

    def resolution_diagonal(self) -> Field:
        weighted = self.precision @ self.directions
        return ((self.directions * weighted) @ self._reduction)[: len(self.mean)]

    def sample(self, rng: np.random.Generator, n: int) -> Float[np.ndarray, "n m"]:
        sample = self.factor.correlated(rng.standard_normal((len(self.factor.pivots), n)))
        along = self.directions.T @ (self.precision @ sample)
        shrink = 1.0 - 1.0 / np.sqrt(1.0 + self.eigenvalues)
        sample -= self.directions @ (shrink[:, None] * along)
        return self.mean + sample[: len(self.mean)].T
