"""The inverse problem: predicted against observed displacements of all presses (eq. 7)."""

from copy import copy

import numpy as np
import torch
from jaxtyping import Float

from tactorch.errors import ConvergenceError
from tactorch.fem import Newton, NewtonOptions, SoftBody, Supports, make_material
from tactorch.fem.body import check_youngs
from tactorch.inverse.data import DataModel, NoiseModel
from tactorch.inverse.evaluation import Evaluation, PressSolution
from tactorch.inverse.misfit import Misfit, Squares
from tactorch.inverse.nuisance import Nuisance, NuisancePrior, PressModelFactory
from tactorch.linalg import SolverOptions, map_cases
from tactorch.recording import Recording


class InverseProblem:
    """A recording as an inverse problem.

    Args:
        recording: Presses, mesh and material. Its truth and reference are never read.
        element: Element type.
        solver: Linear solver.
        noise: Standard deviations for presses that do not state theirs.
        newton: Settings of the equilibrium search.
        misfit: Cost of the residuals; squares by default.
        nuisance: Nuisance parameters that are estimated together with the map, for starts.
        body: Body of this mesh, material, element and solver, where it exists already.

    Attributes:
        data: Observations and the statistics of their errors.
        assumed: Nuisance values that the recording states.
        evaluations: Number of evaluations so far.
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
        nuisance: NuisancePrior | None = None,
        body: SoftBody | None = None,
    ) -> None:
        """Set up the body and the observations."""
        self.recording = recording
        self.body = body or body_of(recording, element, solver, newton)
        self.noise = noise or NoiseModel()
        self.data = DataModel.of(recording, self.noise, misfit or Squares())
        self.nuisance = nuisance or NuisancePrior()
        self.assumed = Nuisance.assumed(recording)
        self._press_models = PressModelFactory(recording)
        self._weight = self._body_force()
        self.evaluations = 0

    @property
    def n_data(self) -> int:
        """Number of observed degrees of freedom over all presses."""
        return self.data.size

    @property
    def n_elements(self) -> int:
        """Number of moduli."""
        return self.recording.mesh.n_tets

    def with_data(self, data: DataModel) -> "InverseProblem":
        """Return the problem with other data, on the same body."""
        problem = copy(self)
        problem.data = data
        return problem

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
        """Solve all presses at these moduli, in parallel.

        Args:
            youngs: Young's modulus of each element, MPa.
            near: Evaluation at similar moduli to start from.
            nuisance: Nuisance values; by default those that the recording states.
            take_over: Whether to take over the factorisations of `near`, which must then factor
                again for its derivatives. It saves time and half the memory.
            chained: Whether to solve the presses one after the other, each with the factorisation
                of the one before. It needs the memory of one press, but gives no derivatives.

        Raises:
            ConvergenceError: a press has no equilibrium; names the press.
        """
        check_youngs(youngs, self.n_elements)
        values = self.assumed if nuisance is None else nuisance
        assembly = self.body.with_parameters(values.poisson, self._press_models.rest_points(values))
        weight = self._weight * values.rest_scale.prod()
        starts = None if near is None else near.predict(youngs)

        def work(i: int, after: Newton | None = None) -> PressSolution:
            press, model = self.recording.presses[i], self._press_models.at(values, i)
            supports = Supports(press.fixed, press.prescribed, press.springs)
            forces = self.body.discretisation.consistent_loads(model.forces) + weight
            if near is not None and take_over:
                after = near.search(i)
            newton = self.body.search(youngs, forces, supports, assembly=assembly, after=after)
            equilibrium = newton.run(None if starts is None else starts[i])
            if not equilibrium.converged:
                raise ConvergenceError(f"{press.label} (index {i}): {equilibrium.reason}")
            return PressSolution(self.data.observations[i], model, weight, newton, equilibrium)

        self.evaluations += 1
        if chained:
            solutions = [work(0)]
            for i in range(1, len(self.data.observations)):
                solutions.append(work(i, solutions[-1].newton))
        else:
            solutions = map_cases(work, len(self.data.observations))
        return Evaluation(youngs, values, solutions, self.data)


def body_of(
    recording: Recording,
    element: str,
    solver: str | SolverOptions,
    newton: NewtonOptions | None = None,
) -> SoftBody:
    """Return the body of a recording."""
    spec = recording.material
    material = make_material(spec.name, spec.poisson, **spec.parameters)
    return SoftBody(recording.mesh, material, element=element, solver=solver, newton=newton)
