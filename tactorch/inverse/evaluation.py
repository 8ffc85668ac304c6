"""Predictions of all presses at one map of moduli, compared with what was observed."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from tactorch.fem import EquilibriumResult, Newton, Sensitivity
from tactorch.inverse.data import DataModel, Observation
from tactorch.inverse.nuisance import Nuisance, PressModel
from tactorch.linalg import map_cases

_MAX_RELATIVE_CHANGE = 0.5  # of a modulus, for which du/de predicts u


@dataclass(frozen=True, eq=False)
class PressSolution:
    """The equilibrium of one press.

    Attributes:
        observation: Observed displacements.
        model: The press at the nuisance values.
        weight: Weight of the object at the nodes, N.
        newton: The equilibrium search.
        equilibrium: Its result.
    """

    observation: Observation
    model: PressModel
    weight: Float[np.ndarray, "nodes 3"]
    newton: Newton
    equilibrium: EquilibriumResult

    @property
    def reported(self) -> Float[np.ndarray, "n 3"]:
        """Displacement that the sensor reports, as predicted, mm."""
        return self.model.reported(self.equilibrium.displacement)

    def sensitivity(self) -> Sensitivity:
        """Return the linearisation, factored."""
        values = self.model.values
        frame = values.rotation if values.rotation_rad.any() else None
        return Sensitivity(self.newton.linearize(self.equilibrium), self.observation.index, frame)

    def nuisance_columns(
        self, names: tuple[str, ...], sensitivity: Sensitivity
    ) -> Float[np.ndarray, "p k"]:
        """Return the change of the observed report by each component of parameters, mm.

        The implicit function theorem: K du = df - dR, with K already factored.
        """
        columns = []
        for name in names:
            forces = self._unbalance(name, sensitivity)
            moved = sensitivity.linearization.force_response(
                np.reshape(forces, (-1, *self.weight.shape))
            )
            direct = self.model.report_rates(name, self.equilibrium.displacement)
            indirect = [sensitivity.observe(field) for field in moved]
            observed = [field.ravel()[self.observation.index] for field in direct]
            if indirect and observed:
                columns += [a + b for a, b in zip(indirect, observed, strict=True)]
            else:
                columns += indirect or observed
        return np.column_stack(columns)

    def _unbalance(self, name: str, sensitivity: Sensitivity) -> list[Float[np.ndarray, "nodes 3"]]:
        """Change of the forces on the nodes by each component, the displacement unchanged, N."""
        linearization = sensitivity.linearization
        if name == "poisson":
            return [-rate for rate in linearization.parameter_forces(poisson=True)]
        if name == "rest_scale":
            return [self.weight - rate for rate in linearization.parameter_forces(stretch=True)]
        loads = self.newton.assembly.discretisation.consistent_loads
        return [loads(change) for change in self.model.force_rates(name)]


class Evaluation:
    """All presses at one map of moduli; derivatives are computed on demand.

    Attributes:
        youngs: Young's modulus of each element, MPa.
        nuisance: Nuisance values.
        residuals: Half their square is minimised: predicted minus observed of all presses, in
            standard deviations, transformed by the misfit.
        misfit_mm2: Half the sum of squared differences (eq. 7), mm^2.
    """

    def __init__(
        self,
        youngs: Float[np.ndarray, " m"],
        nuisance: Nuisance,
        presses: list[PressSolution],
        data: DataModel,
    ) -> None:
        """Compare predictions with observations."""
        self.youngs, self.nuisance = youngs, nuisance
        self._presses, self._data, self._misfit = presses, data, data.misfit
        difference = [
            press.reported.ravel()[observation.index] - observation.displacement
            for press, observation in zip(presses, data.observations, strict=True)
        ]
        self.misfit_mm2 = 0.5 * float(sum(d @ d for d in difference))
        self._begins = data.begins
        self._white = data.whiten(np.concatenate(difference) * data.scale)
        self.residuals = self._misfit.residuals(self._white, self._begins)

    def _join(self, parts: list[np.ndarray]) -> Float[np.ndarray, "data *k"]:
        """Derivatives of the residuals from those of each press in standard deviations."""
        white = self._data.whiten(np.concatenate(parts))
        return self._misfit.derivative(self._white, self._begins, white)

    @property
    def chi2(self) -> float:
        """Mean squared deviation, or a robust estimate; one when the data are fitted to noise."""
        return self._misfit.chi2(self._white, self._begins)

    @property
    def chi2_of_presses(self) -> Float[np.ndarray, " presses"]:
        """Mean squared deviation of each press."""
        return np.array([np.mean(r**2) for r in self.deviations])

    @property
    def deviations(self) -> list[Float[np.ndarray, " _"]]:
        """Predicted minus observed, each press, in independent standard deviations."""
        return np.split(self._white, self._begins[1:])

    @property
    def displacements(self) -> list[Float[np.ndarray, "nodes 3"]]:
        """Predicted displacement of each press, mm."""
        return [press.equilibrium.displacement for press in self._presses]

    @property
    def reported(self) -> list[Float[np.ndarray, "n 3"]]:
        """Predicted displacement that the sensor reports, each press, mm."""
        return [press.reported for press in self._presses]

    def observed(self, i: int) -> Float[np.ndarray, " p"]:
        """Return the observed displacements of press i, mm, in the order of its residuals."""
        return self._data.observations[i].displacement

    def search(self, i: int) -> Newton:
        """Return the equilibrium search of press i."""
        return self._presses[i].newton

    @cached_property
    def sensitivities(self) -> list[Sensitivity]:
        """Linearisation of each press, factored once."""
        return map_cases(lambda i: self._presses[i].sensitivity(), len(self._presses))

    def jacobian(self) -> Float[np.ndarray, "data m"]:
        """Return d residuals / d youngs, 1/MPa, by one solve per observed degree of freedom."""
        self.sensitivities  # noqa: B018  (outside the threads, which share it)

        def work(i: int) -> np.ndarray:
            return self.sensitivities[i].matrix() * self._data.observations[i].scale[:, None]

        return self._join(map_cases(work, len(self._presses)))

    def nuisance_jacobian(self, names: tuple[str, ...]) -> Float[np.ndarray, "data k"]:
        """Return d residuals / d nuisance parameters, by one solve per component and press.

        For scales the derivative is by the logarithm. Rotation is by the vector's components.
        """
        self.sensitivities  # noqa: B018

        def work(i: int) -> np.ndarray:
            press, sensitivity = self._presses[i], self.sensitivities[i]
            columns = press.nuisance_columns(names, sensitivity)
            return columns * press.observation.scale[:, None]

        return self._join(map_cases(work, len(self._presses)))

    def jacobian_times(self, change: Float[np.ndarray, " m"]) -> Float[np.ndarray, " data"]:
        """Return the change of the residuals by a change of the moduli (MPa)."""
        self.sensitivities  # noqa: B018

        def work(i: int) -> np.ndarray:
            return self.sensitivities[i].times(change) * self._data.observations[i].scale

        return self._join(map_cases(work, len(self._presses)))

    def transpose_times(self, weights: Float[np.ndarray, " data"]) -> Float[np.ndarray, " m"]:
        """Return the transpose of d residuals / d youngs times `weights`."""
        parts = self._split(weights)
        self.sensitivities  # noqa: B018
        gradients = map_cases(
            lambda i: self.sensitivities[i].transpose_times(parts[i]), len(self._presses)
        )
        return np.sum(gradients, axis=0)

    def adjoints(self, weights: Float[np.ndarray, " data"]) -> list[Float[np.ndarray, "nodes 3"]]:
        """Return each press's adjoint displacement for weights of the residuals, 1/N."""
        parts = self._split(weights)
        self.sensitivities  # noqa: B018
        return map_cases(lambda i: self.sensitivities[i].adjoint(parts[i]), len(self._presses))

    def _split(self, weights: Float[np.ndarray, " data"]) -> list[Float[np.ndarray, " p"]]:
        """Weights of the residuals as weights of each press's observed displacements, 1/mm."""
        white = self._data.whiten(self._misfit.derivative(self._white, self._begins, weights))
        parts = zip(np.split(white, self._begins[1:]), self._data.observations, strict=True)
        return [part * observation.scale for part, observation in parts]

    def gradient(self) -> Float[np.ndarray, " m"]:
        """Return the gradient of half the sum of squared residuals, by one adjoint solve per press.

        This is eq. (9) to (13), without the paper's second minus.
        """
        return self.transpose_times(self.residuals)

    def predict(self, youngs: Float[np.ndarray, " m"]) -> list[Float[np.ndarray, "nodes 3"]]:
        """Predict the displacements at other moduli, to first order where the change is small."""
        change = youngs - self.youngs
        if np.abs(change / self.youngs).max() > _MAX_RELATIVE_CHANGE:
            return self.displacements
        self.sensitivities  # noqa: B018
        return map_cases(lambda i: self._predict(i, change), len(self._presses))

    def _predict(self, i: int, change: np.ndarray) -> np.ndarray:
        newton, equilibrium = self._presses[i].newton, self._presses[i].equilibrium
        shift = self.sensitivities[i].linearization.displacement_change(change)
        guess = equilibrium.displacement + shift
        return guess if newton.assembly.respond(guess) is not None else equilibrium.displacement
