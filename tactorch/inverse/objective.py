"""What is minimised: half the sum of squared residuals plus a weighted prior."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float

from tactorch.inverse.evaluation import Evaluation
from tactorch.inverse.nuisance import NuisancePrior
from tactorch.inverse.parameterization import Parameterization
from tactorch.inverse.problem import InverseProblem
from tactorch.inverse.regularization import Regularizer

_FARTHEST = 3.0  # prior deviations that a nuisance parameter may move in one step


@dataclass(frozen=True, eq=False)
class Point:
    """The objective's parts at one vector of parameters x.

    Attributes:
        x: Parameters: one an element, then the nuisance parameters' z.
        evaluation: Predictions there.
        objective: The objective that made it.
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
        return self.x[: len(self.youngs)]

    @property
    def z(self) -> Float[np.ndarray, " k"]:
        """The nuisance parameters' part of x, in prior standard deviations."""
        return self.x[len(self.youngs) :]

    @cached_property
    def _field(self) -> Float[np.ndarray, " m"]:
        return np.log(self.youngs)

    @cached_property
    def penalty(self) -> float:
        """The prior on the map, without its weight."""
        return self.objective.prior.value(self._field)

    @cached_property
    def _slope(self) -> Float[np.ndarray, " m"]:
        return self.objective.parameterization.slope(self.elements)

    @cached_property
    def penalty_curvature(self) -> sp.csr_matrix:
        """Curvature of the prior on the map with respect to x, without its weight."""
        chain = sp.diags(self._slope / self.youngs)
        inner = chain @ self.objective.prior.curvature(self._field) @ chain
        k = len(self.z)
        return sp.block_diag((inner, sp.csr_matrix((k, k))), format="csr") if k else inner.tocsr()

    @cached_property
    def penalty_gradient(self) -> Float[np.ndarray, " size"]:
        """Gradient of the prior on the map with respect to x, without its weight."""
        inner = self._slope / self.youngs * self.objective.prior.gradient(self._field)
        return np.concatenate([inner, np.zeros(len(self.z))])

    def prior_value(self, weight: float) -> float:
        """All that is minimised but the misfit: the weighted penalty, and the prior of z."""
        return weight * self.penalty + 0.5 * float(self.z @ self.z)

    def prior_gradient(self, weight: float) -> Float[np.ndarray, " size"]:
        """Return the gradient of `prior_value`."""
        # A prior without weight may be infinitely steep: zero times that is no number.
        gradient = weight * self.penalty_gradient if weight else np.zeros_like(self.x)
        gradient[len(self.youngs) :] += self.z
        return gradient

    def prior_curvature(self, weight: float) -> sp.csr_matrix:
        """Return the curvature of `prior_value`."""
        normal = np.zeros_like(self.x)
        normal[len(self.youngs) :] = 1.0
        curvature = weight * self.penalty_curvature
        return (curvature + sp.diags(normal)).tocsr() if len(self.z) else curvature

    @cached_property
    def _nuisance_jacobian(self) -> Float[np.ndarray, "data k"]:
        nuisance = self.objective.nuisance
        return self.evaluation.nuisance_jacobian(nuisance.names) * nuisance.slopes()

    @cached_property
    def jacobian(self) -> Float[np.ndarray, "data size"]:
        """D residuals / d x."""
        elements = self.evaluation.jacobian() * self._slope
        return np.hstack([elements, self._nuisance_jacobian]) if len(self.z) else elements

    @cached_property
    def data_gradient(self) -> Float[np.ndarray, " size"]:
        """Gradient of half the sum of squared residuals with respect to x, by adjoints."""
        return self.transpose_times(self.evaluation.residuals)

    def jacobian_times(self, change: Float[np.ndarray, " size"]) -> Float[np.ndarray, " data"]:
        """Return the change of the residuals by a change of x, by one solve a press."""
        m = len(self.youngs)
        moved = self.evaluation.jacobian_times(self._slope * change[:m])
        return moved + self._nuisance_jacobian @ change[m:] if len(self.z) else moved

    def transpose_times(self, weights: Float[np.ndarray, " data"]) -> Float[np.ndarray, " size"]:
        """Return the Jacobian's transpose times `weights`, by one solve a press."""
        elements = self._slope * self.evaluation.transpose_times(weights)
        if not len(self.z):
            return elements
        return np.concatenate([elements, self._nuisance_jacobian.T @ weights])

    def value(self, weight: float) -> float:
        """The objective with this weight of the prior."""
        residuals = self.evaluation.residuals
        return 0.5 * float(residuals @ residuals) + self.prior_value(weight)


@dataclass(frozen=True, eq=False)
class Objective:
    """Data, parameterisation and prior, combined.

    Attributes:
        problem: The data.
        parameterization: What the elements' part of x means.
        prior: The penalty on log-moduli.
        weight: Weight of the prior; None where the optimizer chooses it.
        nuisance: Nuisance parameters that are estimated too.
    """

    problem: InverseProblem
    parameterization: Parameterization
    prior: Regularizer
    nuisance: NuisancePrior = field(default_factory=NuisancePrior)
    weight: float | None = None

    @property
    def size(self) -> int:
        """Number of parameters."""
        return self.problem.n_elements + self.nuisance.size

    def start(self, youngs: Float[np.ndarray, " m"]) -> Float[np.ndarray, " size"]:
        """Return the parameters of a map (MPa), nuisance parameters as assumed."""
        return np.concatenate(
            [self.parameterization.parameters(youngs), np.zeros(self.nuisance.size)]
        )

    @property
    def limits(self) -> tuple[Float[np.ndarray, " size"], Float[np.ndarray, " size"]]:
        """Bounds of x."""
        m, beside = self.problem.n_elements, self.nuisance.limits(self.problem.assumed)
        ends = zip(self.parameterization.limits, beside, strict=True)
        low, high = (np.concatenate([np.full(m, end), other]) for end, other in ends)
        return low, high

    @property
    def max_step(self) -> Float[np.ndarray, " size"]:
        """Largest change of each parameter in one Gauss-Newton step."""
        m = self.problem.n_elements
        cap = self.parameterization.max_step
        return np.concatenate([np.full(m, cap), np.full(self.nuisance.size, _FARTHEST)])

    def at(
        self, x: Float[np.ndarray, " size"], near: Point | None = None, *, take_over: bool = False
    ) -> Point:
        """Evaluate at x, starting the equilibria from a nearby point.

        `take_over` passes the factorisations of `near` on: see `InverseProblem.evaluate`.

        Raises:
            ConvergenceError: a press has no equilibrium at these moduli.
        """
        m = self.problem.n_elements
        youngs = self.parameterization.youngs(x[:m])
        bounds = self.parameterization.bounds
        youngs = np.clip(youngs, bounds.lower, bounds.upper)
        nuisance = self.nuisance.nuisance(x[m:], self.problem.assumed)
        before = None if near is None else near.evaluation
        found = self.problem.evaluate(youngs, before, nuisance, take_over)
        return Point(x, found, self)
