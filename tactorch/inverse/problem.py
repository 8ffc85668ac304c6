"""The inverse problem: predicted against observed displacements of all presses (eq. 7)."""

import numpy as np
import torch
from jaxtyping import Float

from tactorch.errors import ConvergenceError
from tactorch.fem import Newton, NewtonOptions, SoftBody, Supports, make_material
from tactorch.fem.body import check_youngs
from tactorch.inverse.correlated_noise import CorrelatedNoise
from tactorch.inverse.evaluation import Evaluation, Observation, PressSolution
from tactorch.inverse.misfit import Misfit, Squares
from tactorch.inverse.noise import NoiseModel
from tactorch.inverse.nuisance import Nuisance, NuisancePrior, PressModelFactory
from tactorch.linalg import SolverOptions, map_cases
from tactorch.recording import Press, Recording


class InverseProblem:
    """A recording seen as an inverse problem.

    Args:
        recording: Presses, mesh and material. Its truth and reference are never read.
        element: Element type.
        solver: Linear solver.
        noise: Standard deviations for presses that do not state theirs.
        newton: Settings of the equilibrium search.
        misfit: What a residual costs; its square by default.
        body: Of this mesh, material, element and solver, where one is there already.
    """

    def __init__(
        self,
        recording: Recording,
        *,
        element: str = "tet4",
        solver: str | SolverOptions = "auto",
        noise: NoiseModel | None = None,
        newton: NewtonOptions | None = None,
        misfit: Misfit | None = None,
        body: SoftBody | None = None,
    ) -> None:
        """Set up the body and the observations."""
        self.recording = recording
        self.body = body or body_of(recording, element, solver, newton)
        self.noise = noise or NoiseModel()
        deviations = self.noise.deviations(recording)
        self.observations = [
            _observe(press, deviation)
            for press, deviation in zip(recording.presses, deviations, strict=True)
        ]
        self.assumed = Nuisance.assumed(recording)
        self.placing = PressModelFactory(recording)
        self.common: CorrelatedNoise | None = None
        self.model_deviation: list[float] | None = None  # mm, of each press, if it is counted
        self.sure_noise = 1.0  # share of the data's variance that is noise, and no model's error
        self.nuisance = NuisancePrior()  # that are estimated beside the map, for starts to know
        self.misfit = misfit or Squares()
        self._weight = self._body_force()
        self.evaluations = 0

    @property
    def n_data(self) -> int:
        """Number of observed degrees of freedom over all presses."""
        return sum(len(seen.index) for seen in self.observations)

    @property
    def n_elements(self) -> int:
        """Number of moduli."""
        return self.recording.mesh.n_tets

    def _body_force(self) -> Float[np.ndarray, "nodes 3"]:
        recording = self.recording
        if not recording.density:
            return np.zeros((self.body.n_nodes, 3))
        gravity = torch.tensor(recording.gravity)
        return self.body.gravity(recording.density, gravity).numpy()

    def evaluate(
        self,
        youngs: Float[np.ndarray, " m"],
        near: Evaluation | None = None,
        nuisance: Nuisance | None = None,
        take_over: bool = False,
        chained: bool = False,
    ) -> Evaluation:
        """Solve all presses at these moduli, side by side.

        Args:
            youngs: The map, MPa.
            near: An evaluation at similar moduli to start from.
            nuisance: What else the predictions depend on; by default what the recording states.
            take_over: Whether to take the factorisations of `near` over, which must then factor
                anew for its derivatives. It saves time and half the memory.
            chained: Whether to solve one press after the other, each taking over the factorisation
                of the one before: the memory of one press, where no derivatives are wanted.

        Raises:
            ConvergenceError: a press has no equilibrium; names the press.
        """
        check_youngs(youngs, self.n_elements)
        values = self.assumed if nuisance is None else nuisance
        assembly = self.body.with_parameters(values.poisson, self.placing.rest_points(values))
        weight = self._weight * values.rest_scale.prod()
        starts = None if near is None else near.predict(youngs)

        def work(i: int, after: Newton | None = None) -> PressSolution:
            press, placed = self.recording.presses[i], self.placing.at(values, i)
            supports = Supports(press.fixed, press.prescribed, press.springs)
            forces = self.body.discretisation.consistent_loads(placed.forces) + weight
            if near is not None and take_over:
                after = near.search(i)
            newton = self.body.search(youngs, forces, supports, assembly=assembly, after=after)
            found = newton.run(None if starts is None else starts[i])
            if not found.converged:
                raise ConvergenceError(f"{press.label} (index {i}): {found.reason}")
            return PressSolution(self.observations[i], placed, weight, newton, found)

        self.evaluations += 1
        if chained:
            solved = [work(0)]
            for i in range(1, len(self.observations)):
                solved.append(work(i, solved[-1].newton))
        else:
            solved = map_cases(work, len(self.observations))
        return Evaluation(youngs, values, solved, self.common, self.misfit)


def body_of(
    recording: Recording,
    element: str,
    solver: str | SolverOptions,
    newton: NewtonOptions | None = None,
) -> SoftBody:
    """Return the object of a recording as a body to be solved."""
    spec = recording.material
    material = make_material(spec.name, spec.poisson, **spec.parameters)
    return SoftBody(recording.mesh, material, element=element, solver=solver, newton=newton)


def _observe(press: Press, deviation: float) -> Observation:
    weights = np.ones_like(press.forces) if press.weights is None else press.weights
    # Data of no weight are left out: they would make the mean squared residual look too good.
    index = np.flatnonzero(press.data & (weights > 0))
    relative = weights.ravel()[index]
    return Observation(index, press.displacement.ravel()[index], relative / deviation)
