"""What is minimised: half the sum of squared residuals plus a weighted prior."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float

from tactorch.inverse.parameterization import Parameterization
from tactorch.inverse.problem import Evaluation, InverseProblem
from tactorch.inverse.regularization import Regularizer


@dataclass(frozen=True, eq=False)
class Point:
    """The objective's parts at one vector of parameters x.

    Attributes:
        x: Parameters.
        evaluation: Predictions there.
        objective: The objective that made it.
    """

    x: Float[np.ndarray, " m"]
    evaluation: Evaluation
    objective: "Objective"

    @property
    def youngs(self) -> Float[np.ndarray, " m"]:
        """The map, MPa."""
        return self.evaluation.youngs

    @cached_property
    def _field(self) -> Float[np.ndarray, " m"]:
        return np.log(self.youngs)

    @cached_property
    def penalty(self) -> float:
        """The prior, without its weight."""
        return self.objective.prior.value(self._field)

    @cached_property
    def _slope(self) -> Float[np.ndarray, " m"]:
        return self.objective.parameterization.slope(self.x)

    @cached_property
    def penalty_curvature(self) -> sp.csr_matrix:
        """Curvature of the prior with respect to x, without its weight."""
        chain = sp.diags(self._slope / self.youngs)
        return (chain @ self.objective.prior.curvature(self._field) @ chain).tocsr()

    @cached_property
    def penalty_gradient(self) -> Float[np.ndarray, " m"]:
        """Gradient of the prior with respect to x, without its weight."""
        return self._slope / self.youngs * self.objective.prior.gradient(self._field)

    @cached_property
    def jacobian(self) -> Float[np.ndarray, "data m"]:
        """D residuals / d x."""
        return self.evaluation.jacobian() * self._slope

    @cached_property
    def data_gradient(self) -> Float[np.ndarray, " m"]:
        """Gradient of half the sum of squared residuals with respect to x, by adjoints."""
        return self.evaluation.gradient() * self._slope

    def jacobian_times(self, change: Float[np.ndarray, " m"]) -> Float[np.ndarray, " data"]:
        """Return the change of the residuals by a change of x, by one solve a press."""
        return self.evaluation.jacobian_times(self._slope * change)

    def transpose_times(self, weights: Float[np.ndarray, " data"]) -> Float[np.ndarray, " m"]:
        """Return the Jacobian's transpose times `weights`, by one solve a press."""
        return self._slope * self.evaluation.transpose_times(weights)

    def value(self, weight: float) -> float:
        """The objective with this weight of the prior."""
        residuals = self.evaluation.residuals
        return 0.5 * float(residuals @ residuals) + weight * self.penalty


@dataclass(frozen=True, eq=False)
class Objective:
    """Data, parameterisation and prior, combined.

    Attributes:
        problem: The data.
        parameterization: What x means.
        prior: The penalty on log-moduli.
    """

    problem: InverseProblem
    parameterization: Parameterization
    prior: Regularizer

    def at(self, x: Float[np.ndarray, " m"], near: Point | None = None) -> Point:
        """Evaluate at x, starting the equilibria from a nearby point.

        Raises:
            ConvergenceError: a press has no equilibrium at these moduli.
        """
        youngs = self.parameterization.youngs(x)
        bounds = self.parameterization.bounds
        youngs = np.clip(youngs, bounds.lower, bounds.upper)
        evaluation = self.problem.evaluate(youngs, None if near is None else near.evaluation)
        return Point(x, evaluation, self)
