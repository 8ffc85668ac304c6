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

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.linalg import orth

from tactorch.errors import ConfigError, ConvergenceError
from tactorch.fem import SoftBody
from tactorch.inverse.data.nuisance import Nuisance
from tactorch.inverse.data.observations import CorrelatedNoise, Observation
from tactorch.inverse.errors.base import ErrorSource, MeasuredPresses
from tactorch.inverse.forward.problem import InverseProblem
from tactorch.recording import Recording

# What the correction for the mesh leaves of its error, measured with truth on cubes whose balls are
# two to four elements across: 0.13 to 0.41. It is less where elements are small relative to the
# features: 0.00 to 0.15 on random balls in a mesh of 65,000 elements (`benchmarks/breast.py`).
RESIDUAL_MODEL_ERROR = 1.0 / 3.0
_REMAINING = 0.3  # of the correction of each contact by finer meshes, over the correction
_MAX_TRIALS, _STIFFENING = 6, 1.3


class DiscretisationRemainder(ErrorSource):
    """Errors of the corrections of the discretisation, over the corrections."""

    name = "discretisation"

    def least(self, presses: MeasuredPresses) -> float | None:
        """Return what remains of a correction, if there is one."""
        return None if presses.corrections_mm is None else _REMAINING

    def patterns(self, presses: MeasuredPresses) -> Float[np.ndarray, "data contacts"]:
        data, offsets = presses.problem.data.observations, presses.corrections_mm
        assert offsets is not None
        return presses.joined(
            {i: (offsets[i] * data[i].scale)[:, None] for i in numbers}
            for numbers in presses.contacts
        )


class ModelError(NamedTuple):
    """Error of the model's prediction of one press."""

    offset: Float[np.ndarray, " data"]  # better minus present prediction, mm, N or N mm
    deviation_mm: float  # standard deviation of what remains of displacements
    deviation_n: float = 0.0  # the same of forces and moments, N or N mm


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
            linear, fine = (
                p.evaluate(np.full(p.n_elements, youngs), nuisance=nuisance, chained=True).predicted
                for p in (problem, quadratic)
            )
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


def corrected(problem: InverseProblem, errors: Sequence[ModelError]) -> InverseProblem:
    """Return the presses with the error subtracted from the data, and its remainder as uncertainty.

    The remainder is partly rough, and counted as white noise, and partly smooth: it shifts and
    stretches the whole contact, equally at every pressure. That part is common to all presses at
    one place; without it the data would seem to determine small uniform motions, such as those of
    the springs below, better than they do.
    """
    data, points = problem.data, problem.recording.mesh.points
    presses, observations = MeasuredPresses(problem), []
    places: dict[bytes, dict[int, np.ndarray]] = {}
    for i, (before, error) in enumerate(zip(data.observations, errors, strict=True)):
        scale = before.scale.copy()
        for part, deviation in zip(before.units, error[1:], strict=True):
            scale[part] /= np.sqrt(1.0 + (deviation * scale[part]) ** 2)
        observations.append(replace(before, values=before.values - error.offset, scale=scale))
        pattern = smooth_pattern(points, observations[-1], error.deviation_mm)
        places.setdefault(before.index.tobytes(), {})[i] = pattern
    changed = replace(
        data,
        observations=tuple(observations),
        correlated=CorrelatedNoise(presses.joined(places.values())),
        model_deviation=tuple(error.deviation_mm for error in errors),
    )
    share = float(np.mean((changed.scale / data.scale) ** 2))
    return problem.with_data(replace(changed, noise_fraction=share))


def smooth_pattern(
    points: Float[np.ndarray, "n 3"], observation: Observation, deviation: float
) -> Float[np.ndarray, "p k"]:
    """Return affine fields over one place, each as large as an error of this deviation (mm).

    They are fields of the nodal displacements. A single one may hold all of the error, so each has
    its full size. The unit is the standard deviation of the white noise.
    """
    index = observation.index
    if not len(index):
        return np.zeros((0, 0))
    positions = points[index // 3]
    extent = np.ptp(positions, axis=0).max()
    positions = (positions - positions.mean(axis=0)) / (extent if extent > 0 else 1.0)
    shapes = np.column_stack([np.ones(len(index)), positions])
    # At most twelve orthonormal fields.
    fields = orth(np.hstack([shapes * (index % 3 == a)[:, None] for a in range(3)]), rcond=1e-6)
    height = deviation * np.sqrt(len(fields) / 3.0)  # a field moves one component
    return height * observation.scale[observation.nodal, None] * fields
