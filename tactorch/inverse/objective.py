"""The objective: half the sum of squared residuals plus a weighted prior."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

from tactorch.errors import ConvergenceError, TactorchError
from tactorch.inverse.nuisance import NuisanceEstimate, NuisancePrior
from tactorch.inverse.parameterization import Parameterization
from tactorch.inverse.problem import Evaluation, InverseProblem
from tactorch.inverse.regularization.base import Regularizer
from tactorch.linalg import DenseCholesky

_MAX_NUISANCE_STEP = 3.0  # prior standard deviations per step
_MAX_DENSE = 12_000  # parameters up to which the normal matrix (1.2 GB) is formed


@dataclass(frozen=True, eq=False)
class Point:
    """The terms of the objective at one vector of parameters x.

    Attributes:
        x: Parameters: one per element (or group of elements), then z of the nuisance parameters.
        evaluation: Predictions.
        objective: The objective.
    """

    x: Float[np.ndarray, " size"]
    evaluation: Evaluation
    objective: "Objective"

    @property
    def youngs(self) -> Float[np.ndarray, " m"]:
        """The map, MPa."""
        return self.evaluation.youngs

    @property
    def elements(self) -> Float[np.ndarray, " m"]:
        """The elements' part of x."""
        return self.x[: self.objective.n_moduli]

    @property
    def z(self) -> Float[np.ndarray, " k"]:
        """The nuisance parameters' part of x, in prior standard deviations."""
        return self.x[self.objective.n_moduli :]

    @cached_property
    def _moduli(self) -> Float[np.ndarray, " m"]:
        """Young's modulus by each parameter of the map, MPa."""
        return self.objective.moduli(self.elements)

    @cached_property
    def _field(self) -> Float[np.ndarray, " m"]:
        return np.log(self._moduli)

    @cached_property
    def _slope(self) -> Float[np.ndarray, " m"]:
        return self.objective.parameterization.slope(self.elements)

    @cached_property
    def penalty(self) -> float:
        """The prior on the map, without its weight."""
        return self.objective.prior.value(self._field)

    @cached_property
    def penalty_gradient(self) -> Float[np.ndarray, " size"]:
        """Gradient of the prior on the map with respect to x, without its weight."""
        inner = self._slope / self._moduli * self.objective.prior.gradient(self._field)
        return np.concatenate([inner, np.zeros(len(self.z))])

    @cached_property
    def penalty_curvature(self) -> sp.csr_matrix:
        """Curvature of the prior on the map with respect to x, without its weight."""
        chain = sp.diags(self._slope / self._moduli)
        inner = chain @ self.objective.prior.curvature(self._field) @ chain
        k = len(self.z)
        return sp.block_diag((inner, sp.csr_matrix((k, k))), format="csr") if k else inner.tocsr()

    def prior_value(self, weight: float) -> float:
        """Return the objective without the misfit: the weighted penalty and the prior of z."""
        return weight * self.penalty + 0.5 * float(self.z @ self.z)

    def prior_gradient(self, weight: float) -> Float[np.ndarray, " size"]:
        """Return the gradient of `prior_value`."""
        # A prior without weight may have an infinite gradient.
        gradient = weight * self.penalty_gradient if weight else np.zeros_like(self.x)
        gradient[self.objective.n_moduli :] += self.z
        return gradient

    def prior_curvature(self, weight: float) -> sp.csr_matrix:
        """Return the curvature of `prior_value`."""
        curvature = weight * self.penalty_curvature
        normal = np.arange(len(self.x)) >= self.objective.n_moduli
        return (curvature + sp.diags(1.0 * normal)).tocsr() if len(self.z) else curvature

    @cached_property
    def _nuisance_jacobian(self) -> Float[np.ndarray, "data k"]:
        nuisance = self.objective.nuisance
        return self.evaluation.nuisance_jacobian(nuisance.names) * nuisance.slopes()

    @cached_property
    def jacobian(self) -> Float[np.ndarray, "data size"]:
        """D residuals / d x, by one solve per datum, or per group of elements and press."""
        groups = self.objective.groups
        if groups is None:
            elements = self.evaluation.jacobian() * self._slope
        else:
            changes = (np.where(groups == g, slope, 0.0) for g, slope in enumerate(self._slope))
            elements = np.column_stack([self.evaluation.jacobian_times(c) for c in changes])
        return np.hstack([elements, self._nuisance_jacobian]) if len(self.z) else elements

    @cached_property
    def data_gradient(self) -> Float[np.ndarray, " size"]:
        """Gradient of half the sum of squared residuals with respect to x, by adjoints."""
        return self.transpose_times(self.evaluation.residuals)

    def jacobian_times(self, change: Float[np.ndarray, " size"]) -> Float[np.ndarray, " data"]:
        """Return the change of the residuals by a change of x, by one solve per press."""
        m = self.objective.n_moduli
        elements = self.evaluation.jacobian_times(self.objective.expand(self._slope * change[:m]))
        return elements + self._nuisance_jacobian @ change[m:] if len(self.z) else elements

    def transpose_times(self, weights: Float[np.ndarray, " data"]) -> Float[np.ndarray, " size"]:
        """Return the Jacobian's transpose times `weights`, by one solve per press."""
        elements = self._slope * self.objective.collect(self.evaluation.transpose_times(weights))
        if not len(self.z):
            return elements
        return np.concatenate([elements, self._nuisance_jacobian.T @ weights])

    def second_order_times(self, change: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """Return the part of the misfit's Hessian that Gauss-Newton omits times a change of x.

        It needs a parameter for each element, and no nuisance parameters.
        """
        second = self.objective.parameterization.second_derivative(self.x)
        inner = self._slope * self.evaluation.second_order_times(self._slope * change)
        return inner + self.data_gradient / self._slope * second * change

    def value(self, weight: float) -> float:
        """Return the objective with this weight of the prior."""
        residuals = self.evaluation.residuals
        return 0.5 * float(residuals @ residuals) + self.prior_value(weight)

    def nuisance_estimates(self, weight: float) -> dict[str, NuisanceEstimate]:
        """Return the nuisance parameters by name, at a solution with this weight of the prior.

        Deviations are those of the Laplace approximation with the map unknown too.
        """
        priors, values = self.objective.nuisance, self.evaluation.nuisance
        if not priors.size:
            return {}
        deviations = priors.parts(priors.slopes() * self._deviation_of_z(weight))
        return {
            name: NuisanceEstimate(
                np.atleast_1d(getattr(values, name)), deviation, getattr(priors, name)
            )
            for name, deviation in deviations.items()
        }

    def _deviation_of_z(self, weight: float) -> Float[np.ndarray, " k"]:
        k = len(self.z)
        if len(self.x) > _MAX_DENSE:
            return np.full(k, np.nan)
        try:
            precision = self.jacobian.T @ self.jacobian
        except ConvergenceError:  # an unstable equilibrium, at which the search has ended
            return np.full(k, np.nan)
        prior = self.prior_curvature(weight)
        # Elements that neither data nor prior determine would break the factorisation; the shift
        # has no visible effect on the variances of z.
        shift = 1e-12 * (precision.diagonal() + prior.diagonal()).max()
        factor = DenseCholesky.of(precision, prior + shift * sp.identity(len(self.x)))
        if factor is None:
            raise TactorchError("the posterior of the nuisance parameters is not definite")
        unit = np.eye(len(self.x), k, k - len(self.x))  # the columns of z
        covariance = np.column_stack([factor.solve(column) for column in unit.T])
        return np.sqrt(covariance[-k:].diagonal())


@dataclass(frozen=True, eq=False)
class Objective:
    """Data, parameterisation and prior.

    Attributes:
        problem: The data.
        parameterization: Relation between the elements' part of x and Young's modulus.
        prior: The penalty on log-moduli.
        weight: Weight of the prior; None where the optimizer chooses it.
        nuisance: Nuisance parameters that are estimated too.
        groups: Group of each element, where all elements of a group share one modulus; the prior
            then acts on the groups. None where each element has its own.
        stable_only: Whether points without derivatives count as points without equilibrium.
    """

    problem: InverseProblem
    parameterization: Parameterization
    prior: Regularizer
    nuisance: NuisancePrior = field(default_factory=NuisancePrior)
    weight: float | None = None
    groups: Int[np.ndarray, " elements"] | None = None
    stable_only: bool = False

    @cached_property
    def n_moduli(self) -> int:
        """Number of parameters of the map."""
        return self.problem.n_elements if self.groups is None else int(self.groups.max()) + 1

    @property
    def size(self) -> int:
        """Number of parameters."""
        return self.n_moduli + self.nuisance.size

    def moduli(self, x: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """Return the moduli of the map's parameters within the bounds, MPa."""
        bounds = self.parameterization.bounds
        return np.clip(self.parameterization.youngs(x), bounds.lower, bounds.upper)

    def expand(self, values: Float[np.ndarray, " m"]) -> Float[np.ndarray, " elements"]:
        """Return values by element from values by parameter of the map."""
        return values if self.groups is None else values[self.groups]

    def collect(self, values: Float[np.ndarray, " elements"]) -> Float[np.ndarray, " m"]:
        """Return the transpose of `expand`: sums over the elements of each parameter."""
        if self.groups is None:
            return values
        return np.bincount(self.groups, values, minlength=self.n_moduli)

    def start(self, youngs: Float[np.ndarray, " m"]) -> Float[np.ndarray, " size"]:
        """Return the parameters of a map (MPa), nuisance parameters as assumed."""
        x = self.parameterization.parameters(youngs)
        return np.concatenate([x, np.zeros(self.nuisance.size)])

    @property
    def limits(self) -> tuple[Float[np.ndarray, " size"], Float[np.ndarray, " size"]]:
        """Bounds of x."""
        limits = self.parameterization.limits, self.nuisance.limits(self.problem.assumed)
        ends = zip(*limits, strict=True)
        low, high = (np.concatenate([np.full(self.n_moduli, end), other]) for end, other in ends)
        return low, high

    @property
    def max_step(self) -> Float[np.ndarray, " size"]:
        """Largest change of each parameter in one damped Newton step."""
        sizes = [self.n_moduli, self.nuisance.size]
        return np.repeat([self.parameterization.max_step, _MAX_NUISANCE_STEP], sizes)

    def at(
        self, x: Float[np.ndarray, " size"], near: Point | None = None, *, take_over: bool = False
    ) -> Point:
        """Evaluate at x, starting the equilibria from a nearby point.

        `take_over` passes the factorisations of `near` on; see `InverseProblem.evaluate`.

        Raises:
            ConvergenceError: a press has no equilibrium at these moduli.
        """
        m = self.n_moduli
        youngs = self.expand(self.moduli(x[:m]))
        nuisance = self.nuisance.nuisance(x[m:], self.problem.assumed)
        before = None if near is None else near.evaluation
        evaluation = self.problem.evaluate(youngs, before, nuisance, take_over)
        if self.stable_only:
            for sensitivity in evaluation.sensitivities:
                sensitivity.linearization.factor()
        return Point(x, evaluation, self)
