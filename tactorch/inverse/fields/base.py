"""Fields of Young's modulus: the unknown of an inversion, with the prior of its coefficients."""

from abc import ABC, abstractmethod

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float

from tactorch.errors import ConfigError
from tactorch.inverse.problem import Evaluation

Vector = Float[np.ndarray, " size"]


class FieldPoint(ABC):
    """A field at one vector of coefficients x, with derivatives.

    Attributes:
        youngs: Young's modulus, MPa, of each element, or of each quadrature point of each element.
        penalty: Negative logarithm of the prior, without its weight.
        penalty_gradient: Its gradient with respect to x.
        penalty_curvature: Positive semi-definite approximation of its Hessian.
    """

    youngs: Float[np.ndarray, "m *q"]
    penalty: float
    penalty_gradient: Vector
    penalty_curvature: sp.csr_matrix

    @abstractmethod
    def youngs_change(self, change: Vector) -> Float[np.ndarray, "m *q"]:
        """Return the change of `youngs` (MPa) by a change of x, to first order."""

    @abstractmethod
    def transpose_times(self, weights: Float[np.ndarray, "m *q"]) -> Vector:
        """Return the transpose of d youngs / d x times weights."""

    @abstractmethod
    def jacobian(self, evaluation: Evaluation) -> Float[np.ndarray, "data size"]:
        """Return d residuals / d x."""

    def second_derivative_times(
        self, weights: Float[np.ndarray, "m *q"], change: Vector
    ) -> Vector:  # pragma: no cover
        """Return the sum of d^2 youngs / d x^2 times weights, times a change of x.

        Raises:
            ConfigError: the field has no second derivative.
        """
        raise ConfigError(
            f"{type(self).__name__} has no second derivative; use the Gauss-Newton Hessian."
        )


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
