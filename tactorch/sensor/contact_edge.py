"""Distance of points of the gel's face from the edge of a contact.

The edge is seen in the image, where the face comes up again, and known from the shape of the object
where the gel is wider than it.
"""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.interpolate import LinearNDInterpolator
from scipy.ndimage import distance_transform_edt, map_coordinates

from tactorch.mesh.closest import closest_points
from tactorch.mesh.topology import triangle_edges
from tactorch.sensor.description import SensorDescription
from tactorch.sensor.gel import EdgeDistance

Nodes = Float[np.ndarray, "k 3"]
Positions = Float[np.ndarray, "n 2"]
Distances = Float[np.ndarray, " n"]


def image_edge(
    sensor: SensorDescription,
    contact: Bool[np.ndarray, "h w"],
    points: Nodes,
    displacement: Nodes,
    margin_mm: float = 0.0,
) -> EdgeDistance:
    """Return the distance from the edge of the contact in an image, which is widened by a margin.

    `points` are those of the face at rest, mm, with displacements that are NaN where unknown.
    """
    sampling = sensor.mm_per_px[::-1]
    inside = distance_transform_edt(contact, sampling=sampling)
    outside = distance_transform_edt(~contact, sampling=sampling)
    # The edge is half way between pixels.
    half = 0.5 * float(np.mean(sampling))
    signed = np.where(contact, inside - half, half - outside) + margin_mm
    known = np.isfinite(displacement[:, :2]).all(axis=1)
    moved = (
        LinearNDInterpolator(points[known, :2], displacement[known, :2])
        if known.sum() > 3
        else lambda rest: np.zeros(rest.shape)
    )

    def distance(rest: Positions) -> Distances:
        columns, rows = sensor.to_px(rest + np.nan_to_num(moved(rest))).T
        return map_coordinates(signed, [rows, columns], order=1, mode="nearest")

    return distance


def surface_edge(
    points: Float[np.ndarray, "n 3"], triangles: Int[np.ndarray, "t 3"]
) -> EdgeDistance:
    """Return the distance from the outline of triangles in the frame of the sensor, along z."""
    flat = np.pad(points[:, :2], ((0, 0), (0, 1)))
    unique, counts = np.unique(triangle_edges(triangles), axis=0, return_counts=True)
    starts, ends = points[unique[counts == 1].T, :2]

    def distance(rest: Positions) -> Distances:
        away = _segment_distances(rest, starts, ends).min(axis=1)
        queries = np.pad(rest, ((0, 0), (0, 1)))
        within = closest_points(flat, triangles, queries).distances < 1e-9
        return np.where(within, away, -away)

    return distance


def common_edge(first: EdgeDistance, second: EdgeDistance) -> EdgeDistance:
    """Return the distance from the edge of the region that two regions have in common."""
    return lambda rest: np.minimum(first(rest), second(rest))


def _segment_distances(
    points: Positions, starts: Float[np.ndarray, "s 2"], ends: Float[np.ndarray, "s 2"]
) -> Float[np.ndarray, "n s"]:
    along = ends - starts
    relative = points[:, None] - starts
    share = (relative * along).sum(axis=2) / np.maximum((along**2).sum(axis=1), 1e-300)
    nearest = relative - np.clip(share, 0.0, 1.0)[..., None] * along
    return np.asarray(np.linalg.norm(nearest, axis=2))
