"""Presses linearised in the logarithms of the moduli about a body: a reduced model.

An inclusion of contrast c in a uniform strain changes the far field by its volume times (c - 1) /
(c + 3/2) (Eshelby, 1957, for nearly incompressible bodies), which for contrasts of up to five is
2/5 log c within 3 %. The Born approximation in log E is therefore much better than that in E. It
needs the sensitivities of one body only, such as a uniform one, and an evaluation takes one product
of matrices.
"""

from collections.abc import Sequence
from copy import copy
from typing import Any

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError
from tactorch.fem.body import check_youngs
from tactorch.inverse.data.observations import DataModel
from tactorch.inverse.forward.problem import (
    Changes,
    Columns,
    Evaluation,
    InverseProblem,
    Moduli,
    NodalFields,
)


class ReducedProblem(InverseProblem):
    """The presses of a problem with predictions that are linear in log E; see `InverseProblem`.

    Args:
        problem: The presses.
        evaluation: Its presses at the moduli of elements about which they are linearised.

    Attributes:
        rates: Derivatives of the data by the logarithm of the modulus of each element, in their
            units (mm, N or N mm), in single precision.
    """

    def __init__(self, problem: InverseProblem, evaluation: Evaluation) -> None:
        vars(self).update(vars(problem))
        rates = evaluation.log_rates().astype(np.float32, copy=False)
        self.rates: Float[np.ndarray, "data m"] = rates
        self._log_youngs = np.log(_means(evaluation.youngs))
        self._at_reference = evaluation.predicted

    @staticmethod
    def about_uniform(problem: InverseProblem, youngs_mpa: float) -> "ReducedProblem":
        """Return the presses about a uniform body."""
        return ReducedProblem(problem, problem.evaluate(np.full(problem.n_elements, youngs_mpa)))

    @staticmethod
    def joined(problem: InverseProblem, parts: Sequence["ReducedProblem"]) -> "ReducedProblem":
        """Return the presses of a problem, each of which is linearised already."""
        whole = copy(parts[0])
        vars(whole).update(vars(problem))
        whole.rates = np.concatenate([part.rates for part in parts])
        whole._at_reference = [values for part in parts for values in part._at_reference]
        return whole

    def evaluate(self, youngs: Moduli, *_near: Any, **_options: Any) -> "ReducedEvaluation":
        """Return all presses at these moduli; the other arguments have no effect."""
        check_youngs(youngs, (len(self._log_youngs), youngs.shape[-1]))
        return ReducedEvaluation(self, youngs, self.data)

    def predicted(self, youngs: Moduli) -> list[Float[np.ndarray, " _"]]:
        """Return the predicted data of each press, in their units."""
        changes = np.log(_means(youngs)) - self._log_youngs
        moved = (self.rates @ changes.astype(np.float32)).astype(np.float64)
        parts = np.split(moved, self.data.begins[1:])
        return [a + b for a, b in zip(self._at_reference, parts, strict=True)]


class ReducedEvaluation(Evaluation):
    """All presses of a reduced model at one map of moduli; see `Evaluation`."""

    def __init__(self, problem: ReducedProblem, youngs: Moduli, data: DataModel) -> None:
        self._problem, self._means = problem, _means(youngs)
        self._predicted = problem.predicted(youngs)
        super().__init__(youngs, problem.assumed, np.zeros((0, 3)), [], data)

    @property
    def predicted(self) -> list[Float[np.ndarray, " _"]]:
        """Predicted data of each press, in their units."""
        return self._predicted

    @property
    def sensitivities(self) -> list[Any]:
        """Not known: displacements of nodes have no derivatives here."""
        raise ConfigError("A reduced model has no sensitivities of displacements.")

    def factor(self) -> None:
        """Do nothing: a linear model has no instability."""

    def jacobian(self) -> Float[np.ndarray, "data m"]:
        return self._of_residuals(self._problem.rates / self._means * self.data.scale[:, None])

    def transpose_times(self, weights: Float[np.ndarray, " data"]) -> Moduli:
        rows = self._problem.rates.T @ (self._of_data(weights) * self.data.scale)
        moduli = self.youngs.size // len(self._means)  # of an element, which share its change
        return np.repeat(rows / self._means / moduli, moduli).reshape(self.youngs.shape)

    def _respond(self, changes: Changes) -> tuple[Columns, list[NodalFields]]:
        """Return the changes of the data, in their units; displacements are not known."""
        by_element = changes.reshape(len(changes), len(self._means), -1).mean(axis=2)
        logs = by_element / self._means
        return (self._problem.rates @ logs.T.astype(np.float32)).astype(np.float64), []


def _means(youngs: Moduli) -> Float[np.ndarray, " m"]:
    """Return the mean modulus of each element."""
    return youngs.reshape(len(youngs), -1).mean(axis=1)
