"""The objective: half the sum of squared residuals plus a weighted prior."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float

from tactorch.errors import ConfigError, ConvergenceError, TactorchError
from tactorch.inverse.data.nuisance import NuisanceEstimate, NuisancePrior
from tactorch.inverse.fields import ElementField, FieldPoint, ModulusField
from tactorch.inverse.forward.problem import Evaluation, InverseProblem
from tactorch.linalg import DenseCholesky

_MAX_NUISANCE_STEP = 3.0  # prior standard deviations per step
_MAX_DENSE = 12_000  # parameters up to which the normal matrix (1.2 GB) is formed


@dataclass(frozen=True, eq=False)
class Point:
    """The terms of the objective at one vector of parameters x.

    Attributes:
        x: Parameters: the coefficients of the field, then z of the nuisance parameters.
        field: The field at its coefficients.
        evaluation: Predictions.
        objective: The objective.
    """

    x: Float[np.ndarray, " size"]
    field: FieldPoint
    evaluation: Evaluation
    objective: "Objective"

    @property
    def youngs(self) -> Float[np.ndarray, "m *q"]:
        """The map, MPa, by element, or by quadrature point of each element."""
        return self.evaluation.youngs

    @property
    def coefficients(self) -> Float[np.ndarray, " m"]:
        """The field's part of x."""
        return self.x[: self.objective.field.size]

    @property
    def z(self) -> Float[np.ndarray, " k"]:
        """The nuisance parameters' part of x, in prior standard deviations."""
        return self.x[self.objective.field.size :]

    @property
    def penalty(self) -> float:
        """The prior on the map, without its weight."""
        return self.field.penalty

    @cached_property
    def penalty_gradient(self) -> Float[np.ndarray, " size"]:
        """Gradient of the prior on the map with respect to x, without its weight."""
        return np.concatenate([self.field.penalty_gradient, np.zeros(len(self.z))])

    @cached_property
    def penalty_curvature(self) -> sp.csr_matrix:
        """Curvature of the prior on the map with respect to x, without its weight."""
        inner, k = self.field.penalty_curvature, len(self.z)
        return sp.block_diag((inner, sp.csr_matrix((k, k))), format="csr") if k else inner

    def prior_gradient(self, weight: float) -> Float[np.ndarray, " size"]:
        """Return the gradient of the weighted prior on the map and of that of z."""
        # A prior without weight may have an infinite gradient.
        gradient = weight * self.penalty_gradient if weight else np.zeros_like(self.x)
        gradient[self.objective.field.size :] += self.z
        return gradient

    def prior_curvature(self, weight: float) -> sp.csr_matrix:
        """Return the curvature of the weighted prior on the map and of that of z."""
        curvature = weight * self.penalty_curvature
        normal = np.arange(len(self.x)) >= self.objective.field.size
        return (curvature + sp.diags(1.0 * normal)).tocsr() if len(self.z) else curvature

    @cached_property
    def _nuisance_jacobian(self) -> Float[np.ndarray, "data k"]:
        nuisance = self.objective.nuisance
        if not nuisance.size:
            return np.zeros((len(self.evaluation.residuals), 0))
        return self.evaluation.nuisance_jacobian(nuisance.names) * nuisance.slopes()

    @cached_property
    def jacobian(self) -> Float[np.ndarray, "data size"]:
        """D residuals / d x."""
        inner = self.field.jacobian(self.evaluation)
        return np.hstack([inner, self._nuisance_jacobian]) if len(self.z) else inner

    @cached_property
    def data_gradient(self) -> Float[np.ndarray, " size"]:
        """Gradient of half the sum of squared residuals with respect to x, by adjoints."""
        inner = self.field.transpose_times(self._youngs_gradient)
        return np.concatenate([inner, self._nuisance_jacobian.T @ self.evaluation.residuals])

    @cached_property
    def _youngs_gradient(self) -> Float[np.ndarray, "m *q"]:
        return self.evaluation.gradient()

    def jacobian_times(self, change: Float[np.ndarray, " size"]) -> Float[np.ndarray, " data"]:
        """Return the change of the residuals by a change of x, by one solve per press."""
        m = self.objective.field.size
        inner = self.evaluation.jacobian_times(self.field.youngs_change(change[:m]))
        return inner + self._nuisance_jacobian @ change[m:]

    def transpose_times(self, weights: Float[np.ndarray, " data"]) -> Float[np.ndarray, " size"]:
        """Return the Jacobian's transpose times `weights`, by one solve per press."""
        inner = self.field.transpose_times(self.evaluation.transpose_times(weights))
        return np.concatenate([inner, self._nuisance_jacobian.T @ weights])

    def second_order_times(self, change: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """Return the part of the misfit's Hessian that Gauss-Newton omits times a change of x.

        It needs a coefficient for each element, and no nuisance parameters.

        Raises:
            ConfigError: the field has not one modulus per element.
        """
        parameterization = self.objective.elements.parameterization
        by_youngs = self.evaluation.second_order_times(self.field.youngs_change(change))
        inner = self.field.transpose_times(by_youngs)
        second = parameterization.second_derivative(self.coefficients)
        return inner + second * self._youngs_gradient * change

    def value(self, weight: float) -> float:
        """Return the objective with this weight of the prior."""
        residuals = self.evaluation.residuals
        prior = weight * self.penalty + 0.5 * float(self.z @ self.z)
        return 0.5 * float(residuals @ residuals) + prior

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
    """Data, field and prior.

    Attributes:
        problem: The data.
        field: The family of maps, with its prior.
        nuisance: Nuisance parameters that are estimated too.
        weight: Weight of the prior; None where the optimizer chooses it.
        stable_only: Whether points without derivatives count as points without equilibrium.
        strong_contrast: Whether first steps are cut by their limits, so that their misfit is not
            that of the weight of the prior, which then starts higher and is kept.
    """

    problem: InverseProblem
    field: ModulusField
    nuisance: NuisancePrior = dataclasses.field(default_factory=NuisancePrior)
    weight: float | None = None
    stable_only: bool = False
    strong_contrast: bool = False

    @property
    def size(self) -> int:
        """Number of parameters."""
        return self.field.size + self.nuisance.size

    @property
    def elements(self) -> ElementField:
        """The field, where it has one modulus per element.

        Raises:
            ConfigError: it is another.
        """
        if not isinstance(self.field, ElementField):
            raise ConfigError("this needs a map with one modulus per element.")
        return self.field

    def start(self, youngs: Float[np.ndarray, " m"]) -> Float[np.ndarray, " size"]:
        """Return the parameters of a map by element (MPa), nuisance parameters as assumed."""
        x = self.elements.parameterization.parameters(youngs)
        return np.concatenate([x, np.zeros(self.nuisance.size)])

    @property
    def limits(self) -> tuple[Float[np.ndarray, " size"], Float[np.ndarray, " size"]]:
        """Bounds of x."""
        limits = self.field.limits, self.nuisance.limits(self.problem.assumed)
        low, high = (np.concatenate(ends) for ends in zip(*limits, strict=True))
        return low, high

    @property
    def max_step(self) -> Float[np.ndarray, " size"]:
        """Largest change of each parameter in one damped Newton step."""
        steps = [self.field.max_step, np.full(self.nuisance.size, _MAX_NUISANCE_STEP)]
        return np.concatenate(steps)

    def at(
        self,
        x: Float[np.ndarray, " size"],
        near: Point | None = None,
        *,
        take_over: bool = False,
        starts: Sequence[np.ndarray] | None = None,
    ) -> Point:
        """Evaluate at x, starting the equilibria from a nearby point, or from displacements (mm).

        `take_over` passes the factorisations of `near` on; see `InverseProblem.evaluate`.

        Raises:
            ConvergenceError: a press has no equilibrium at these moduli.
        """
        m = self.field.size
        field = self.field.at(x[:m])
        nuisance = self.nuisance.nuisance(x[m:], self.problem.assumed)
        before = None if near is None else near.evaluation
        evaluation = self.problem.evaluate(field.youngs, before, nuisance, take_over, starts=starts)
        if self.stable_only:
            evaluation.factor()
        return Point(x, field, evaluation, self)
