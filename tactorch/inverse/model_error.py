"""Discretisation error of the mesh: linear tetrahedra are too stiff by more than a sensor's noise.

On the paper's meshes the linear tetrahedron misses the displacements by about 3 %, and an inversion
that assumes white noise turns that into structure. The error hardly depends on the map, so it is
estimated at a uniform one, as the difference to quadratic elements on the same mesh (the
approximation error method, Kaipio and Somersalo, 2007, with one sample). It is subtracted from the
data, and a fraction of it remains as uncertainty. It is proportional to the displacement, so where
the object is stiffer or softer under a press than the uniform map, the difference is scaled by the
observed displacement. It excludes the error of elements that a boundary cuts, which have one
modulus each; on meshes much coarser than the paper's that error is larger.
"""

import numpy as np

from tactorch.errors import ConfigError, ConvergenceError
from tactorch.fem import SoftBody
from tactorch.inverse.data import ModelError
from tactorch.inverse.nuisance import Nuisance
from tactorch.inverse.problem import InverseProblem
from tactorch.inverse.settings import RESIDUAL_MODEL_ERROR
from tactorch.recording import Recording

_MAX_TRIALS, _STIFFENING = 6, 1.3


def resolve_model_error(name: str, recording: Recording, element: str) -> str:
    """Resolve "auto": "discretisation", unless the presses come from the same model.

    The provenance states that (`inverse_crime`) for presses that were computed on the recording's
    mesh. For quadratic elements there is no better model to compare with.
    """
    if name != "auto":
        return name
    same_model = bool(recording.provenance.get("inverse_crime")) or element != "tet4"
    return "none" if same_model else "discretisation"


def discretisation_error(
    problem: InverseProblem,
    youngs_mpa: float,
    nuisance: Nuisance | None = None,
    remaining: float = RESIDUAL_MODEL_ERROR,
    finer: SoftBody | None = None,
) -> tuple[ModelError, ...]:
    """Estimate the error of each press at a uniform modulus (MPa) and nuisance values.

    The fraction `remaining` of the error is left as uncertainty. `finer` is the body of quadratic
    elements on the same mesh, where it exists already.
    """
    if problem.body.discretisation.element.quadratic:
        raise ConfigError(
            "model_error=discretisation compares plain tetrahedra with quadratic ones; with "
            "element=tet10 choose model_error=none."
        )
    quadratic = InverseProblem(
        problem.recording,
        element="tet10",
        solver=problem.body.solver,
        noise=problem.noise,
        newton=problem.body.newton,
        body=finer,
    )
    youngs = youngs_mpa
    for trial in range(_MAX_TRIALS):
        try:
            linear, fine = (_predict(p, youngs, nuisance) for p in (problem, quadratic))
            break
        except ConvergenceError:
            # The modulus fits the stiffer model; near its limit the softer one may collapse.
            if trial == _MAX_TRIALS - 1:
                raise
            youngs *= _STIFFENING
    errors = []
    for observation, present, better in zip(problem.data.observations, linear, fine, strict=True):
        weighted = observation.scale**2 * better
        # Observed over predicted data, by least squares.
        relative = max(float(weighted @ observation.values), 0.0) / float(weighted @ better)
        offset = relative * (better - present)
        parts = [offset[part] for part in observation.units]
        sizes = [float(np.linalg.norm(p)) / np.sqrt(max(len(p), 1)) for p in parts]
        errors.append(ModelError(offset, *(remaining * size for size in sizes)))
    return tuple(errors)


def _predict(
    problem: InverseProblem, youngs_mpa: float, nuisance: Nuisance | None
) -> list[np.ndarray]:
    """Predicted data of each press."""
    uniform = np.full(problem.n_elements, youngs_mpa)
    return problem.evaluate(uniform, nuisance=nuisance, chained=True).predicted
