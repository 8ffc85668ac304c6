"""Fields of Young's modulus: the unknown of an inversion, with the prior of its coefficients."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

from tactorch.inverse.fields.parameterization import Parameterization
from tactorch.inverse.fields.regularization.base import Regularizer
from tactorch.inverse.forward.problem import Evaluation, Moduli

Vector = Float[np.ndarray, " size"]


class FieldPoint(ABC):
    """A field at one vector of coefficients x, with derivatives.

    Attributes:
        youngs: Young's modulus, MPa, of each element, or of each quadrature point of each element.
        penalty: Negative logarithm of the prior, without its weight.
        penalty_gradient: Its gradient with respect to x.
        penalty_curvature: Positive semi-definite approximation of its Hessian.
    """

    youngs: Moduli
    penalty: float
    penalty_gradient: Vector
    penalty_curvature: sp.csr_matrix

    @abstractmethod
    def youngs_change(self, change: Vector) -> Moduli:
        """Return the change of `youngs` (MPa) by a change of x, to first order."""

    @abstractmethod
    def transpose_times(self, weights: Moduli) -> Vector:
        """Return the transpose of d youngs / d x times weights."""

    @abstractmethod
    def jacobian(self, evaluation: Evaluation) -> Float[np.ndarray, "data size"]:
        """Return d residuals / d x."""


class ModulusField(ABC):
    """A family of fields.

    Attributes:
        size: Number of coefficients.
        limits: Bounds of the coefficients.
        max_step: Largest change of each coefficient in one damped Newton step.
    """

    size: int
    limits: tuple[Vector, Vector]
    max_step: Vector

    @abstractmethod
    def at(self, x: Vector) -> FieldPoint:
        """Return the field with these coefficients."""


@dataclass(frozen=True, eq=False)
class ElementField(ModulusField):
    """One modulus per element, or per group of elements.

    Attributes:
        parameterization: Relation between a coefficient and Young's modulus.
        prior: Penalty on the log-moduli.
        n_elements: Number of elements.
        groups: Group of each element, where all elements of a group share one modulus; the prior
            then acts on the groups.
    """

    parameterization: Parameterization
    prior: Regularizer
    n_elements: int
    groups: Int[np.ndarray, " elements"] | None = None

    @cached_property
    def size(self) -> int:  # type: ignore[override]
        """Number of elements, or of groups."""
        return self.n_elements if self.groups is None else int(self.groups.max()) + 1

    @property
    def limits(self) -> tuple[Vector, Vector]:  # type: ignore[override]
        low, high = self.parameterization.limits
        return np.full(self.size, low), np.full(self.size, high)

    @property
    def max_step(self) -> Vector:  # type: ignore[override]
        return np.full(self.size, self.parameterization.max_step)

    def at(self, x: Vector) -> FieldPoint:
        return _ElementPoint(self, x)


@dataclass(frozen=True, eq=False)
class _ElementPoint(FieldPoint):
    field: ElementField
    x: Vector

    @cached_property
    def _moduli(self) -> Vector:
        """Young's modulus by coefficient, MPa."""
        bounds = self.field.parameterization.bounds
        return np.clip(self.field.parameterization.youngs(self.x), bounds.lower, bounds.upper)

    @cached_property
    def _slope(self) -> Vector:
        return self.field.parameterization.slope(self.x)

    @cached_property
    def youngs(self) -> Moduli:  # type: ignore[override]
        groups = self.field.groups
        return self._moduli if groups is None else self._moduli[groups]

    @cached_property
    def penalty(self) -> float:  # type: ignore[override]
        return self.field.prior.value(np.log(self._moduli))

    @cached_property
    def penalty_gradient(self) -> Vector:  # type: ignore[override]
        return self._slope / self._moduli * self.field.prior.gradient(np.log(self._moduli))

    @cached_property
    def penalty_curvature(self) -> sp.csr_matrix:
        chain = sp.diags(self._slope / self._moduli)
        return (chain @ self.field.prior.curvature(np.log(self._moduli)) @ chain).tocsr()

    def youngs_change(self, change: Vector) -> Moduli:
        values, groups = self._slope * change, self.field.groups
        return values if groups is None else values[groups]

    def transpose_times(self, weights: Moduli) -> Vector:
        groups = self.field.groups
        if groups is not None:
            weights = np.bincount(groups, weights, minlength=self.field.size)
        return self._slope * weights

    def jacobian(self, evaluation: Evaluation) -> Float[np.ndarray, "data size"]:
        """Return d residuals / d x, by one solve per datum, or per group of elements and press."""
        if self.field.groups is None:
            return evaluation.jacobian() * self._slope
        changes = (self.youngs_change(unit) for unit in np.eye(self.field.size))
        return np.column_stack([evaluation.jacobian_times(change) for change in changes])
