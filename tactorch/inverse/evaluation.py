"""Predictions of all presses at one map of moduli, compared with what was observed."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from tactorch.fem import EquilibriumResult, Newton, Sensitivity
from tactorch.inverse.correlated_noise import CorrelatedNoise
from tactorch.inverse.misfit import Misfit, Squares
from tactorch.inverse.nuisance import Nuisance, PressModel
from tactorch.linalg import map_cases

_PREDICTABLE = 0.5  # largest relative change of a modulus for which du/de foretells u


@dataclass(frozen=True, eq=False)
class Observation:
    """What one press observed.

    Attributes:
        index: Observed unknowns, 3 node + axis.
        displacement: Their displacement, mm.
        scale: Weight over standard deviation of each, 1/mm.
    """

    index: Int[np.ndarray, " p"]
    displacement: Float[np.ndarray, " p"]
    scale: Float[np.ndarray, " p"]


@dataclass(frozen=True, eq=False)
class PressSolution:
    """One press, solved.

    Attributes:
        seen: What was observed.
        placed: The press at the nuisance values.
        weight: The object's own weight at the nodes, N.
        newton: The equilibrium search.
        found: What it found.
    """

    seen: Observation
    placed: PressModel
    weight: Float[np.ndarray, "nodes 3"]
    newton: Newton
    found: EquilibriumResult

    @property
    def reported(self) -> Float[np.ndarray, "n 3"]:
        """Predicted report of the sensor, mm."""
        return self.placed.reported(self.found.displacement)

    def sensitivity(self) -> Sensitivity:
        """Return the linearisation, factored."""
        values = self.placed.values
        frame = values.rotation if values.rotation_rad.any() else None
        return Sensitivity(self.newton.linearize(self.found), self.seen.index, frame)

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
            direct = self.placed.report_rates(name, self.found.displacement)
            seen = [sensitivity.observe(field) for field in moved]
            plain = [field.ravel()[self.seen.index] for field in direct]
            if seen and plain:
                columns += [a + b for a, b in zip(seen, plain, strict=True)]
            else:
                columns += seen or plain
        return np.column_stack(columns)

    def _unbalance(self, name: str, sensitivity: Sensitivity) -> list[Float[np.ndarray, "nodes 3"]]:
        """Change of the forces on the nodes by each component, the displacement unchanged, N."""
        linearization = sensitivity.linearization
        if name == "poisson":
            return [-rate for rate in linearization.parameter_forces(poisson=True)]
        if name == "rest_scale":
            return [self.weight - rate for rate in linearization.parameter_forces(stretch=True)]
        loads = self.newton.assembly.discretisation.consistent_loads
        return [loads(change) for change in self.placed.force_rates(name)]


class Evaluation:
    """All presses at one map of moduli; derivatives are computed when asked for.

    Attributes:
        youngs: The map, MPa.
        nuisance: What else the predictions depend on.
        residuals: Half their square is minimised: predicted minus observed, all presses in a row,
            in standard deviations, or what the misfit makes of that.
        misfit_mm2: Half the sum of squared differences (eq. 7), mm^2.
    """

    def __init__(
        self,
        youngs: Float[np.ndarray, " m"],
        nuisance: Nuisance,
        presses: list[PressSolution],
        common: CorrelatedNoise | None = None,
        misfit: Misfit | None = None,
    ) -> None:
        """Compare predictions with observations, whose errors may have something in common."""
        self._common = common
        self._misfit = misfit or Squares()
        self.youngs = youngs
        self.nuisance = nuisance
        self._presses = presses
        self._observations = [press.seen for press in presses]
        difference = [
            press.reported.ravel()[press.seen.index] - press.seen.displacement for press in presses
        ]
        self.misfit_mm2 = 0.5 * float(sum(d @ d for d in difference))
        scaled = [d * seen.scale for d, seen in zip(difference, self._observations, strict=True)]
        self._begins = np.cumsum([0, *(len(d) for d in difference[:-1])])
        self._white = self._whiten(np.concatenate(scaled))
        self.residuals = self._misfit.residuals(self._white, self._begins)

    def _whiten(self, values: Float[np.ndarray, "data *k"]) -> Float[np.ndarray, "data *k"]:
        """From standard deviations of each datum by itself to independent ones; symmetric."""
        return values if self._common is None else self._common.whiten(values)

    def _join(self, parts: list[np.ndarray]) -> Float[np.ndarray, "data *k"]:
        """Derivatives of the residuals from those of each press in standard deviations."""
        white = self._whiten(np.concatenate(parts))
        return self._misfit.derivative(self._white, self._begins, white)

    @property
    def chi2(self) -> float:
        """Mean squared deviation, or a robust stand-in; one when the data are fitted to noise."""
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
        return [press.found.displacement for press in self._presses]

    @property
    def reported(self) -> list[Float[np.ndarray, "n 3"]]:
        """Predicted report of the sensor, each press, mm."""
        return [press.reported for press in self._presses]

    def observed(self, i: int) -> Float[np.ndarray, " p"]:
        """Return the observed displacements of press i, mm, in the order of its residuals."""
        return self._observations[i].displacement

    def search(self, i: int) -> Newton:
        """Return the equilibrium search of press i."""
        return self._presses[i].newton

    @cached_property
    def sensitivities(self) -> list[Sensitivity]:
        """Linearisation of each press, factored once."""
        return map_cases(lambda i: self._presses[i].sensitivity(), len(self._presses))

    def jacobian(self) -> Float[np.ndarray, "data m"]:
        """Return d residuals / d youngs, 1/MPa, by one solve per observed unknown."""
        self.sensitivities  # noqa: B018  (outside the threads, which share it)

        def work(i: int) -> np.ndarray:
            return self.sensitivities[i].matrix() * self._observations[i].scale[:, None]

        return self._join(map_cases(work, len(self._presses)))

    def nuisance_jacobian(self, names: tuple[str, ...]) -> Float[np.ndarray, "data k"]:
        """Return d residuals / d nuisance parameters, one column a component, a solve each.

        For scales the derivative is by the logarithm. Rotation is by the vector's components.
        """
        self.sensitivities  # noqa: B018

        def work(i: int) -> np.ndarray:
            press, sensitivity = self._presses[i], self.sensitivities[i]
            columns = press.nuisance_columns(names, sensitivity)
            return columns * press.seen.scale[:, None]

        return self._join(map_cases(work, len(self._presses)))

    def jacobian_times(self, change: Float[np.ndarray, " m"]) -> Float[np.ndarray, " data"]:
        """Return the change of the residuals by a change of the moduli (MPa), one solve a press."""
        self.sensitivities  # noqa: B018

        def work(i: int) -> np.ndarray:
            return self.sensitivities[i].times(change) * self._observations[i].scale

        return self._join(map_cases(work, len(self._presses)))

    def transpose_times(self, weights: Float[np.ndarray, " data"]) -> Float[np.ndarray, " m"]:
        """Return the transpose of d residuals / d youngs times `weights`, one solve a press."""
        parts = self._split(weights)
        self.sensitivities  # noqa: B018
        found = map_cases(
            lambda i: self.sensitivities[i].transpose_times(parts[i]), len(self._presses)
        )
        return np.sum(found, axis=0)

    def adjoints(self, weights: Float[np.ndarray, " data"]) -> list[Float[np.ndarray, "nodes 3"]]:
        """Return each press's adjoint displacement for weights of the residuals, 1/N."""
        parts = self._split(weights)
        self.sensitivities  # noqa: B018
        return map_cases(lambda i: self.sensitivities[i].adjoint(parts[i]), len(self._presses))

    def _split(self, weights: Float[np.ndarray, " data"]) -> list[Float[np.ndarray, " p"]]:
        """Weights of the residuals as weights of each press's observed displacements, 1/mm."""
        white = self._whiten(self._misfit.derivative(self._white, self._begins, weights))
        parts = zip(np.split(white, self._begins[1:]), self._observations, strict=True)
        return [part * seen.scale for part, seen in parts]

    def gradient(self) -> Float[np.ndarray, " m"]:
        """Return the gradient of half the sum of squared residuals, by one adjoint solve a press.

        This is eq. (9) to (13), with the paper's second minus dropped.
        """
        return self.transpose_times(self.residuals)

    def predict(self, youngs: Float[np.ndarray, " m"]) -> list[Float[np.ndarray, "nodes 3"]]:
        """Foretell the displacements at other moduli, to first order where that is sound."""
        change = youngs - self.youngs
        if np.abs(change / self.youngs).max() > _PREDICTABLE:
            return self.displacements
        self.sensitivities  # noqa: B018
        return map_cases(lambda i: self._predict(i, change), len(self._presses))

    def _predict(self, i: int, change: np.ndarray) -> np.ndarray:
        newton, found = self._presses[i].newton, self._presses[i].found
        shift = self.sensitivities[i].linearization.displacement_change(change)
        guess = found.displacement + shift
        return guess if newton.assembly.respond(guess) is not None else found.displacement
