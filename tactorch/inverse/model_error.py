"""What the mesh gets wrong: plain tetrahedra are too stiff, by more than a good sensor's noise.

On the paper's meshes the linear tetrahedron misses the displacements by about 3 %, and an
inversion that knows of white noise alone turns that into structure. The error hardly depends on
the map, so it is estimated at a uniform one, as the difference that quadratic elements make on
the same mesh (the approximation error method, Kaipio and Somersalo, 2007, with one sample):
it is taken off the data, and a share of it stays as uncertainty. It is proportional to the
displacement, so where the object is stiffer or softer under a press than the uniform map has it,
the difference is scaled by the displacement observed. What it does not see is that elements which
a boundary cuts have one modulus each; on meshes much coarser than the paper's that is the larger
error.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import orth

from tactorch.errors import ConfigError, ConvergenceError
from tactorch.fem import SoftBody
from tactorch.inverse.correlated_noise import CorrelatedNoise
from tactorch.inverse.evaluation import Observation
from tactorch.inverse.nuisance import Nuisance
from tactorch.inverse.problem import InverseProblem
from tactorch.inverse.settings import RESIDUAL_MODEL_ERROR
from tactorch.recording import Recording

_TRIALS, _STIFFER = 6, 1.3


def resolve_model_error(name: str, recording: Recording, element: str) -> str:
    """Resolve "auto": correct, unless the presses come from the very model that is inverted.

    The provenance says so (`inverse_crime`) for presses that were computed on the recording's own
    mesh. Quadratic elements have nothing better to be compared with.
    """
    if name != "auto":
        return name
    same_model = bool(recording.provenance.get("inverse_crime")) or element != "tet4"
    return "none" if same_model else "discretisation"


@dataclass(frozen=True, eq=False)
class ModelError:
    """Error of the model's predictions.

    Attributes:
        offset: What the model lacks at the observed degrees of freedom of each press, mm.
        deviation: Standard deviation of the error that the offset leaves, one a press, mm.
    """

    offset: list[Float[np.ndarray, " _"]]
    deviation: list[float]


def discretisation_error(
    problem: InverseProblem,
    youngs_mpa: float,
    nuisance: Nuisance | None = None,
    left: float = RESIDUAL_MODEL_ERROR,
    finer: SoftBody | None = None,
) -> ModelError:
    """Estimate what the mesh gets wrong, at a uniform modulus (MPa) and nuisance values.

    Args:
        problem: Of plain tetrahedra.
        youngs_mpa: The modulus.
        nuisance: By default what the recording states.
        left: Share of the error that stays as uncertainty once it is taken off, 0 to 1.
        finer: The same body of quadratic elements, where one is there already.

    Raises:
        ConfigError: the problem has quadratic elements, with which there is nothing to compare.
        ConvergenceError: a press has no equilibrium, at this modulus or a few times as much.
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
    for trial in range(_TRIALS):
        try:
            plain, fine = (_predicted(p, youngs, nuisance) for p in (problem, quadratic))
            break
        except ConvergenceError:
            # The fit is of the stiffer model: at its edge the softer one may collapse.
            if trial == _TRIALS - 1:
                raise
            youngs *= _STIFFER
    offset = [
        _extent(seen, b) * (b - a)
        for seen, a, b in zip(problem.observations, plain, fine, strict=True)
    ]
    return ModelError(offset, [left * float(np.sqrt(np.mean(d * d))) for d in offset])


def _predicted(
    problem: InverseProblem, youngs_mpa: float, nuisance: Nuisance | None
) -> list[np.ndarray]:
    uniform = np.full(problem.n_elements, youngs_mpa)
    found = problem.evaluate(uniform, nuisance=nuisance, chained=True)
    return [
        u.ravel()[seen.index] for u, seen in zip(found.reported, problem.observations, strict=True)
    ]


def _extent(seen: Observation, predicted: Float[np.ndarray, " p"]) -> float:
    """How many times the predicted displacement of a press was observed, by least squares."""
    weighted = seen.scale**2 * predicted
    return max(float(weighted @ seen.displacement), 0.0) / float(weighted @ predicted)


def apply_model_error(problem: InverseProblem, error: ModelError) -> None:
    """Take the model's error off the problem's observations, and widen their deviations.

    What the offset leaves is partly rough, and counted as white noise, and partly smooth: it
    shifts and stretches the whole contact, at every pressure alike. That part is common to all
    presses on one place, and without it the data would seem to know small uniform motions, such as
    those of the springs below, better than they do.
    """
    before = np.concatenate([seen.scale for seen in problem.observations])
    problem.observations = [
        replace(
            seen,
            displacement=seen.displacement - offset,
            scale=seen.scale / np.sqrt(1.0 + (deviation * seen.scale) ** 2),
        )
        for seen, offset, deviation in zip(
            problem.observations, error.offset, error.deviation, strict=True
        )
    ]
    after = np.concatenate([seen.scale for seen in problem.observations])
    problem.sure_noise = float(np.mean((after / before) ** 2))
    problem.common = CorrelatedNoise(_smooth_patterns(problem, error))
    problem.model_deviation = error.deviation


def _smooth_patterns(problem: InverseProblem, error: ModelError) -> Float[np.ndarray, "data k"]:
    """Affine fields over each place that is pressed, in deviations of the white noise."""
    seen = problem.observations
    begins = np.cumsum([0, *(len(one.index) for one in seen)])
    places: dict[bytes, list[int]] = {}
    for i, one in enumerate(seen):
        places.setdefault(one.index.tobytes(), []).append(i)
    blocks = []
    for members in places.values():
        parts = [
            smooth_pattern(problem.recording.mesh.points, seen[i], error.deviation[i])
            for i in members
        ]
        block = np.zeros((begins[-1], parts[0].shape[1]))
        for i, part in zip(members, parts, strict=True):
            block[begins[i] : begins[i + 1]] = part
        blocks.append(block)
    return np.hstack(blocks)


def smooth_pattern(
    points: Float[np.ndarray, "n 3"], seen: Observation, deviation: float
) -> Float[np.ndarray, "data k"]:
    """Affine fields over one place, each as large as an error of this deviation (mm).

    One of them may hold all of the error, so each has the size of the whole. In deviations of the
    white noise.
    """
    fields = _affine(points, seen.index)
    height = deviation * np.sqrt(len(fields) / 3.0)  # a field moves one component
    return height * seen.scale[:, None] * fields


def _affine(
    points: Float[np.ndarray, "n 3"], index: Int[np.ndarray, " p"]
) -> Float[np.ndarray, "p k"]:
    """Return orthonormal affine displacement fields at observed unknowns, at most twelve."""
    positions = points[index // 3]
    extent = np.ptp(positions, axis=0).max()
    positions = (positions - positions.mean(axis=0)) / (extent if extent > 0 else 1.0)
    shapes = np.column_stack([np.ones(len(index)), positions])
    fields = [shapes * (index % 3 == axis)[:, None] for axis in range(3)]
    return orth(np.hstack(fields), rcond=1e-6)
