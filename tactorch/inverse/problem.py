"""The inverse problem: predicted against observed displacements of all presses (eq. 7)."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Float, Int

from tactorch.errors import ConvergenceError
from tactorch.fem import Equilibrated, Newton, NewtonOptions, SoftBody, Supports, map_cases
from tactorch.fem.body import check_youngs
from tactorch.fem.materials import make_material
from tactorch.fem.sensitivity import Sensitivity
from tactorch.inverse.noise import NoiseModel
from tactorch.recording import Press, Recording

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


class Evaluation:
    """All presses at one map of moduli; derivatives are computed when asked for.

    Attributes:
        youngs: The map, MPa.
        residuals: Predicted minus observed, all presses in a row, in standard deviations.
        misfit_mm2: Half the sum of squared differences (eq. 7), mm^2.
    """

    def __init__(
        self,
        youngs: Float[np.ndarray, " m"],
        observations: list[Observation],
        presses: list[tuple[Newton, Equilibrated]],
    ) -> None:
        """Compare predictions with observations."""
        self.youngs = youngs
        self._observations = observations
        self._presses = presses
        difference = [
            found.displacement.ravel()[seen.index] - seen.displacement
            for (_, found), seen in zip(presses, observations, strict=True)
        ]
        self.misfit_mm2 = 0.5 * float(sum(d @ d for d in difference))
        self.residuals = np.concatenate(
            [d * seen.scale for d, seen in zip(difference, observations, strict=True)]
        )

    @property
    def chi2(self) -> float:
        """Mean squared residual; one when the data are fitted to their noise."""
        return float(np.mean(self.residuals**2))

    @property
    def displacements(self) -> list[Float[np.ndarray, "nodes 3"]]:
        """Predicted displacement of each press, mm."""
        return [found.displacement for _, found in self._presses]

    @cached_property
    def sensitivities(self) -> list[Sensitivity]:
        """Linearisation of each press, factored once."""

        def work(i: int) -> Sensitivity:
            newton, found = self._presses[i]
            assert found.response is not None
            tangent = newton.linearize(found)
            index = self._observations[i].index
            return Sensitivity(newton.assembly, found.response, tangent, index)

        return map_cases(work, len(self._presses))

    def jacobian(self) -> Float[np.ndarray, "data m"]:
        """Return d residuals / d youngs, 1/MPa, by one solve per observed unknown."""
        self.sensitivities  # noqa: B018  (outside the threads, which share it)

        def work(i: int) -> np.ndarray:
            return self.sensitivities[i].matrix() * self._observations[i].scale[:, None]

        return np.concatenate(map_cases(work, len(self._presses)))

    def jacobian_times(self, change: Float[np.ndarray, " m"]) -> Float[np.ndarray, " data"]:
        """Return the change of the residuals by a change of the moduli (MPa), one solve a press."""
        self.sensitivities  # noqa: B018

        def work(i: int) -> np.ndarray:
            return self.sensitivities[i].times(change) * self._observations[i].scale

        return np.concatenate(map_cases(work, len(self._presses)))

    def transpose_times(self, weights: Float[np.ndarray, " data"]) -> Float[np.ndarray, " m"]:
        """Return the transpose of d residuals / d youngs times `weights`, one solve a press."""
        ends = np.cumsum([len(seen.index) for seen in self._observations])[:-1]
        parts = np.split(weights, ends)
        self.sensitivities  # noqa: B018

        def work(i: int) -> np.ndarray:
            return self.sensitivities[i].transpose_times(parts[i] * self._observations[i].scale)

        return np.sum(map_cases(work, len(self._presses)), axis=0)

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
        newton, found = self._presses[i]
        shift = self.sensitivities[i].displacement_change(change)
        guess = found.displacement + shift
        return guess if newton.assembly.respond(guess) is not None else found.displacement


class InverseProblem:
    """A recording seen as an inverse problem.

    Args:
        recording: Presses, mesh and material. Its truth and reference are never read.
        element: Element type.
        solver: Linear solver.
        noise: Standard deviations for presses that do not state theirs.
        newton: Settings of the equilibrium search.
    """

    def __init__(
        self,
        recording: Recording,
        *,
        element: str = "tet4",
        solver: str = "auto",
        noise: NoiseModel | None = None,
        newton: NewtonOptions | None = None,
    ) -> None:
        """Set up the body and the observations."""
        spec = recording.material
        material = make_material(spec.name, spec.poisson, **spec.parameters)
        self.recording = recording
        self.body = SoftBody(
            recording.mesh, material, element=element, solver=solver, newton=newton
        )
        self.noise = noise or NoiseModel()
        deviations = self.noise.deviations(recording)
        self.observations = [
            _observe(press, deviation)
            for press, deviation in zip(recording.presses, deviations, strict=True)
        ]
        self._weight = self._body_force()
        self.evaluations = 0

    @property
    def n_data(self) -> int:
        """Number of observed degrees of freedom over all presses."""
        return sum(len(seen.index) for seen in self.observations)

    @property
    def n_unknowns(self) -> int:
        """Number of moduli."""
        return self.recording.mesh.n_tets

    def _body_force(self) -> Float[np.ndarray, "nodes 3"]:
        recording = self.recording
        if not recording.density:
            return np.zeros((self.body.n_nodes, 3))
        gravity = torch.tensor(recording.gravity)
        return self.body.gravity(recording.density, gravity).numpy()

    def evaluate(
        self, youngs: Float[np.ndarray, " m"], near: Evaluation | None = None
    ) -> Evaluation:
        """Solve all presses at these moduli, side by side.

        Args:
            youngs: The map, MPa.
            near: An evaluation at similar moduli to start from.

        Raises:
            ConvergenceError: a press has no equilibrium; names the press.
        """
        check_youngs(youngs, self.n_unknowns)
        starts = None if near is None else near.predict(youngs)

        def work(i: int) -> tuple[Newton, Equilibrated]:
            press = self.recording.presses[i]
            supports = Supports(press.fixed, press.prescribed, press.springs)
            forces = self.body.discretisation.spread(press.forces) + self._weight
            newton = self.body.search(youngs, forces, supports)
            found = newton.run(None if starts is None else starts[i])
            if not found.converged:
                raise ConvergenceError(f"{press.label} (index {i}): {found.reason}")
            return newton, found

        self.evaluations += 1
        return Evaluation(youngs, self.observations, map_cases(work, len(self.observations)))


def _observe(press: Press, deviation: float) -> Observation:
    weights = np.ones_like(press.forces) if press.weights is None else press.weights
    # Data of no weight are left out: they would make the mean squared residual look too good.
    index = np.flatnonzero(press.data & (weights > 0))
    relative = weights.ravel()[index]
    return Observation(index, press.displacement.ravel()[index], relative / deviation)
