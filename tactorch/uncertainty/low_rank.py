"""The Laplace posterior of large meshes: the prior, and the few directions in which data tell more.

The precision is H = J^T J + P as in `posterior`, but J is known by its products alone and P is
sparse. With the pairs J^T J v = lambda P v, V^T P V = 1 (Lanczos), the covariance is

    H^-1 = P^-1 - V diag(lambda / (1 + lambda)) V^T

(Flath et al., 2011; Bui-Thanh et al., 2013). Pairs that are left out can only make variances too
large, and `excess` says by how much at most: what is stated errs on the safe side. The prior's
variances come from its factorisation, exactly.

**Priors that leave the mean free.** Total variation and smoothness are blind to a change of all
log-moduli alike, so their precision is singular. The mean log-modulus is therefore given a normal
separate prior of deviation `MEAN_DEVIATION`: the term 1 / (m MEAN_DEVIATION^2) on the diagonal.
That is a factor of e^10 either way, more than the moduli of all solids, and its share in any other
direction is as small as it is there.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla
from jaxtyping import Float, Int

from tactorch.errors import ConfigError
from tactorch.inverse import Parameterization, Point
from tactorch.uncertainty.gaussian import GaussianPosterior
from tactorch.uncertainty.laplace import check_weight
from tactorch.uncertainty.selected_inverse import SparseFactor

Product = Callable[[np.ndarray], np.ndarray]

#: Prior standard deviation of the mean log-modulus.
MEAN_DEVIATION = 10.0


@dataclass(frozen=True, eq=False)
class LowRankPosterior(GaussianPosterior):
    """A normal distribution of the parameters x that holds no dense matrix.

    Attributes:
        mean: Parameters at the solution, elements only.
        precision: P, the prior's; rows beyond the elements are global unknowns.
        factor: Its factorisation.
        eigenvalues: Lambda, falling: how much more the data tell than the prior, by direction.
        directions: V, one a column.
        parameterization: What x means.
    """

    mean: Float[np.ndarray, " m"]
    precision: sp.csr_matrix
    factor: SparseFactor
    eigenvalues: Float[np.ndarray, " r"]
    directions: Float[np.ndarray, "unknowns r"]
    parameterization: Parameterization

    @staticmethod
    def at(point: Point, weight: float, rank: int = 100, *, seed: int = 0) -> "LowRankPosterior":
        """Take the posterior at a point of the objective, by its products with vectors.

        Costs some three times `rank` products with J and its transpose, each one solve a press.

        Args:
            point: The solution.
            weight: Weight of the prior there.
            rank: Number of directions; enough where `excess` is small beside the variance.
            seed: Of the first vector.

        Raises:
            ConfigError: the weight is negative, or the prior leaves more undetermined than the
                mean (as with weight 0).
        """
        check_weight(weight)
        slope = point.objective.parameterization.slope(point.elements) / point.youngs
        mean_prior = np.zeros(len(point.x))
        mean_prior[: len(slope)] = slope**2 / (len(slope) * MEAN_DEVIATION**2)
        return LowRankPosterior.of(
            point.elements,
            lambda v: point.transpose_times(point.jacobian_times(v)),
            sp.csr_matrix(point.prior_curvature(weight) + sp.diags(mean_prior)),
            point.objective.parameterization,
            rank,
            seed=seed,
        )

    @staticmethod
    def of(
        mean: Float[np.ndarray, " m"],
        data_hessian: Product,
        precision: sp.csr_matrix,
        parameterization: Parameterization,
        rank: int,
        *,
        seed: int = 0,
    ) -> "LowRankPosterior":
        """Take the posterior of a linear model; see `at`.

        Args:
            mean: Parameters at the solution.
            data_hessian: Multiplies a vector by J^T J.
            precision: The prior's, positive definite.
            parameterization: What the parameters mean.
            rank: Number of directions, at most one less than the unknowns.
            seed: Of the first vector.

        Raises:
            ConfigError: the rank cannot be used, or the precision is not positive definite.
        """
        size = precision.shape[0]
        if not 0 < rank < size:
            raise ConfigError(f"rank={rank} must be at least 1 and below the {size} unknowns.")
        factor = SparseFactor.of(precision)
        if factor is None:
            raise ConfigError(
                "the prior's precision is not positive definite: it leaves moduli undetermined "
                "that no rank makes up for; give a prior, and a weight above 0."
            )
        values, vectors = spla.eigsh(
            spla.LinearOperator((size, size), matvec=data_hessian, dtype=np.float64),
            rank,
            M=precision,
            Minv=spla.LinearOperator((size, size), matvec=factor.solve, dtype=np.float64),
            v0=np.random.default_rng(seed).standard_normal(size),
        )
        # Round-off makes zeros negative.
        falling, vectors = np.maximum(values[::-1], 0.0), np.ascontiguousarray(vectors[:, ::-1])
        return LowRankPosterior(mean, precision, factor, falling, vectors, parameterization)

    def excess(self) -> Float[np.ndarray, " m"]:
        """Return by how much each variance may be too large at most, for the rank's sake.

        No direction left out tells more than the last one taken, and together they hold what the
        ones taken leave of the prior's variance.
        """
        left = self.factor.inverse_diagonal - (self.directions**2).sum(axis=1)
        return np.maximum(self._known[-1] * left[: len(self.mean)], 0.0)

    @property
    def _known(self) -> Float[np.ndarray, " r"]:
        """Share of the prior's variance that the data take away along each direction."""
        return self.eigenvalues / (1.0 + self.eigenvalues)

    @cached_property
    def _variance(self) -> Float[np.ndarray, " unknowns"]:
        return self.factor.inverse_diagonal - self.directions**2 @ self._known

    def prior_variance(self) -> Float[np.ndarray, " m"]:
        """Return the variance of each element's parameter before the data."""
        return self.factor.inverse_diagonal[: len(self.mean)].copy()

    def variance(self) -> Float[np.ndarray, " m"]:
        """See `GaussianPosterior.variance`."""
        return self._variance[: len(self.mean)].copy()

    def covariance(self, elements: Int[np.ndarray, " k"]) -> Float[np.ndarray, "k k"]:
        """See `GaussianPosterior.covariance`; one sparse solve an element."""
        columns = np.zeros((len(self.factor.pivots), len(elements)))
        columns[elements, np.arange(len(elements))] = 1.0
        chosen = self.directions[elements]
        prior = self.factor.solve(columns)[elements]
        return 0.5 * (prior + prior.T) - (chosen * self._known) @ chosen.T

    def resolution_diagonal(self) -> Float[np.ndarray, " m"]:
        """See `GaussianPosterior.resolution_diagonal`."""
        turned = self.precision @ self.directions
        return ((self.directions * turned) @ self._known)[: len(self.mean)]

    def sample(self, rng: np.random.Generator, n: int) -> Float[np.ndarray, "n m"]:
        """See `GaussianPosterior.sample`."""
        drawn = self.factor.correlated(rng.standard_normal((len(self.factor.pivots), n)))
        along = self.directions.T @ (self.precision @ drawn)
        shrink = 1.0 - 1.0 / np.sqrt(1.0 + self.eigenvalues)
        drawn -= self.directions @ (shrink[:, None] * along)
        return self.mean + drawn[: len(self.mean)].T

    def log_det(self) -> float:
        """See `GaussianPosterior.log_det`; from below, by what the directions leave out."""
        return self.factor.log_det() + float(np.log1p(self.eigenvalues).sum())
