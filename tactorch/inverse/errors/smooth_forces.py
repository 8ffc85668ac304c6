"""Smooth relative errors of the forces of a palpation over the surface.

The base under an object, its sides, and the normals of a curved surface are known roughly only, and
so is the contact. The forces that a model predicts are then wrong by a factor that varies smoothly
over the surface, with the depth, and close to the border of the palpated area, where the object
ends or changes. Taken for structure, such errors would be explained by wide inclusions and by ones
at the border. The factor is a Gaussian process over the places (Rasmussen and Williams, Gaussian
Processes for Machine Learning, 2006), independently for its mean over the depths, its slope, and
what falls with the distance from the border.
"""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from tactorch.inverse.errors.base import ErrorSource, MeasuredPresses
from tactorch.inverse.forward.palpation import PalpationProblem

_BORDER = 2.0  # distance from the border where errors are larger, over the ball's radius
_LENGTH = 0.25  # of the correlation, over the square root of the palpated area
_SMALLEST = 1e-3  # variance of a mode of the process that is left out, over the largest
_NARROW = 0.1  # width of the palpated area over its length, at least
_NEIGHBOURS = 12  # nearest places, among which those at the border have a gap
_GAP = 2.0 * np.pi / 3.0  # between the directions to neighbours


class SmoothForces(ErrorSource):
    """Errors of the forces of a palpation, over the forces; see `smooth_error_patterns`."""

    name, elements, proposal = "smooth_forces", "linear", "forces wrong by {:.0%}"
    levels = (0.05, 0.15)
    note = (
        "The forces differ from the model by about {:.0%}, smoothly over the surface; the "
        "intervals of the lumps account for it. Check the depth of the object and its base."
    )

    def least(self, presses: MeasuredPresses) -> float | None:
        """Return zero, or None without a palpation."""
        return 0.0 if isinstance(presses.problem, PalpationProblem) else None

    def patterns(self, presses: MeasuredPresses) -> Float[np.ndarray, "data k"]:
        problem = presses.problem
        assert isinstance(problem, PalpationProblem)
        contacts = np.array([place.contact_mm for place in problem.indentation.places])
        forces = np.concatenate(presses.evaluation.predicted) * problem.data.scale
        border = _BORDER * float(np.median(problem.indentation.balls_mm))
        place_of, depths = (x[problem.press_of] for x in (problem.places, problem.depths_mm))
        return smooth_error_patterns(contacts, place_of, depths, forces, border)


def smooth_error_patterns(
    contacts_mm: Float[np.ndarray, "places 3"],
    place_of: Int[np.ndarray, " data"],
    depths_mm: Float[np.ndarray, " data"],
    forces: Float[np.ndarray, " data"],
    border_mm: float,
) -> Float[np.ndarray, "data k"]:
    """Return patterns of errors of relative standard deviation one.

    Predicted forces are in standard deviations of the white noise. Errors are larger within
    `border_mm` of the border of the palpated area.
    """
    modes = _modes(contacts_mm)
    near = np.exp(-0.5 * (border_distances(contacts_mm) / border_mm) ** 2)
    slope = (depths_mm / depths_mm.mean() - 1.0)[:, None] * modes[place_of]
    return forces[:, None] * np.hstack([
        modes[place_of], slope, (near[:, None] * modes)[place_of]
    ])  # fmt: skip


def _modes(points: Float[np.ndarray, "places 3"]) -> Float[np.ndarray, "places k"]:
    """Return modes of a Gaussian process over the places, of unit variance and zero mean.

    The mean over the places is the modulus of the background.
    """
    length = correlation_length(points)
    apart = np.linalg.norm(points[:, None] - points, axis=2)
    variances, vectors = np.linalg.eigh(np.exp(-0.5 * (apart / length) ** 2))
    kept = variances > _SMALLEST * variances[-1]
    modes = vectors[:, kept] * np.sqrt(variances[kept])
    return modes - modes.mean(axis=0)


def correlation_length(points: Float[np.ndarray, "places 3"]) -> float:
    """Return the correlation length for places that fill an area (mm).

    The area is that of the rectangle with the second moments of the places.
    """
    sides = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    sides = sides * np.sqrt(12.0 / len(points))
    area = sides[0] * max(sides[1] if len(sides) > 1 else 0.0, _NARROW * sides[0])
    return _LENGTH * float(np.sqrt(area)) or 1.0


def border_distances(points: Float[np.ndarray, "places 3"]) -> Float[np.ndarray, " places"]:
    """Return the distance of each place to the nearest one at the border of the area, mm."""
    if len(points) <= _NEIGHBOURS:
        return np.zeros(len(points))
    at_border = _is_at_border(points)
    if not at_border.any():
        return np.full(len(points), np.inf)
    return cKDTree(points[at_border]).query(points)[0]


def _is_at_border(points: Float[np.ndarray, "places 3"]) -> Bool[np.ndarray, " places"]:
    """Whether the neighbours of each place leave a wide gap of directions in the surface."""
    centred = points - points.mean(axis=0)
    flat = centred @ np.linalg.svd(centred, full_matrices=False)[2][:2].T
    _, neighbours = cKDTree(flat).query(flat, _NEIGHBOURS + 1)
    apart = flat[neighbours[:, 1:]] - flat[:, None]
    angles = np.sort(np.arctan2(apart[..., 1], apart[..., 0]), axis=1)
    around = np.concatenate([angles, angles[:, :1] + 2.0 * np.pi], axis=1)
    return np.diff(around, axis=1).max(axis=1) > _GAP
