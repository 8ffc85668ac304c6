"""Sensitivity of presses to the map: presses made, and candidates predicted."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConvergenceError
from tactorch.inverse import InverseProblem, Point, Settings
from tactorch.inverse.data import CorrelatedNoise, smooth_pattern
from tactorch.recording import Press


def press_credibility(point: Point) -> Float[np.ndarray, "presses m"]:
    """Return the square of L (eq. 15) of each press by itself, as a precision.

    L is by the parameter, in standard deviations of the noise, and scaled to an element of mean
    volume, so that small elements do not count as less sensitive.
    """
    mesh = point.objective.problem.recording.mesh
    blocks = _split(point.jacobian[:, : mesh.n_tets], point.objective.problem)
    sensitivity = np.array([np.abs(block).max(axis=0) for block in blocks])
    return (sensitivity * mesh.volumes.mean() / mesh.volumes) ** 2


def predict_jacobians(
    presses: Sequence[Press], point: Point, settings: Settings
) -> list[Float[np.ndarray, "data m"] | None]:
    """Predict the Jacobians of candidate presses at the current map.

    Their noise is that of the current data: the sensor's noise, and the model error of the mesh,
    white and smooth.

    Args:
        presses: Candidates as they would be recorded; their displacements are ignored.
        point: Solution of the presses made so far.
        settings: Settings of its inversion.

    Returns:
        Derivatives of each press's data by the parameters, in standard deviations; None for a
        press under which the body collapses.
    """
    scales = np.concatenate([data.scale for data in point.objective.problem.data.observations])
    noise = float(1.0 / np.median(scales))
    # The Jacobian does not depend on the measured displacement, but presses with none are refused.
    nonzero = np.full(presses[0].forces.shape, noise)
    planned = [replace(press, displacement=nonzero, noise_mm=noise) for press in presses]
    try:
        return list(_jacobians(planned, point, settings))
    except ConvergenceError:
        return [_jacobian_or_none(press, point, settings) for press in planned]


def _jacobian_or_none(press: Press, point: Point, settings: Settings) -> np.ndarray | None:
    try:
        return _jacobians([press], point, settings)[0]
    except ConvergenceError:
        return None


def _jacobians(presses: Sequence[Press], point: Point, settings: Settings) -> list[np.ndarray]:
    current = point.objective.problem
    # Planned displacements are no measurements, so their magnitude is not checked.
    recording = replace(current.recording, presses=tuple(presses), check_units=False)
    problem = InverseProblem(recording, newton=settings.newton, body=current.body)
    slope = point.objective.parameterization.slope(point.elements)
    blocks = _split(problem.evaluate(point.youngs).jacobian() * slope, problem)
    if current.data.model_deviation is None:
        return blocks
    deviation, points = float(np.median(current.data.model_deviation)), recording.mesh.points
    patterns = [smooth_pattern(points, data, deviation) for data in problem.data.observations]
    return [CorrelatedNoise(s).whiten(block) for s, block in zip(patterns, blocks, strict=True)]


def _split(rows: np.ndarray, problem: InverseProblem) -> list[np.ndarray]:
    """Rows of each press."""
    counts = [len(data.index) for data in problem.data.observations]
    return np.split(rows, np.cumsum(counts)[:-1])
