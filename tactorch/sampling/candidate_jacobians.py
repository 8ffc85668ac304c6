"""What presses tell of the map: those made, and those that might be made."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConvergenceError
from tactorch.inverse import CorrelatedNoise, InverseProblem, Point, Settings, smooth_pattern
from tactorch.recording import Press


def credibilities(point: Point) -> Float[np.ndarray, "presses m"]:
    """Return the square of L (eq. 15) of each press by itself, as a precision.

    L is by the parameter, in standard deviations of the noise, and of an element of mean volume:
    else small elements would count as hardly felt.
    """
    mesh = point.objective.problem.recording.mesh
    counts = [len(seen.index) for seen in point.objective.problem.data.observations]
    rows = np.split(point.jacobian[:, : mesh.n_tets], np.cumsum(counts)[:-1])
    felt = np.array([np.abs(part).max(axis=0) for part in rows])
    return (felt * mesh.volumes.mean() / mesh.volumes) ** 2


def foretold(
    presses: Sequence[Press], point: Point, settings: Settings
) -> list[Float[np.ndarray, "data m"] | None]:
    """Return the Jacobians of presses not made yet, side by side, at the present map.

    Their errors are what the inversion takes the present data to have: the sensor's noise, and
    what the mesh gets wrong, rough and smooth.

    Args:
        presses: As they would be reported; their displacements do not matter.
        point: The present map, with the presses made so far.
        settings: Of its inversion.

    Returns:
        Derivatives of each press's data by the parameters, in standard deviations; None for a
        press under which the body would collapse.
    """
    scales = np.concatenate([seen.scale for seen in point.objective.problem.data.observations])
    noise = float(1.0 / np.median(scales))
    # Displacements do not matter here; presses that moved nothing are refused as data.
    nothing = np.full(presses[0].forces.shape, noise)
    planned = [replace(press, displacement=nothing, noise_mm=noise) for press in presses]
    try:
        return list(_rows(planned, point, settings))
    except ConvergenceError:
        return [_rows_or_none(press, point, settings) for press in planned]


def _rows_or_none(press: Press, point: Point, settings: Settings) -> np.ndarray | None:
    try:
        return _rows([press], point, settings)[0]
    except ConvergenceError:
        return None


def _rows(presses: Sequence[Press], point: Point, settings: Settings) -> list[np.ndarray]:
    made = point.objective.problem
    # Presses yet to be made are without displacement, so units are not told by it.
    recording = replace(made.recording, presses=tuple(presses), check_units=False)
    problem = InverseProblem(recording, newton=settings.newton, body=made.body)
    slope = point.objective.parameterization.slope(point.elements)
    counts = [len(seen.index) for seen in problem.data.observations]
    rows = problem.evaluate(point.youngs).jacobian() * slope
    parts = np.split(rows, np.cumsum(counts)[:-1])
    known = made.data.model_deviation
    if known is None:
        return parts
    left, points = float(np.median(known)), recording.mesh.points
    smooth = [smooth_pattern(points, seen, left) for seen in problem.data.observations]
    return [CorrelatedNoise(s).whiten(part) for s, part in zip(smooth, parts, strict=True)]
