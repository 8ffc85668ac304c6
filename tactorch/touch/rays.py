"""First points of surfaces along z, from below. Lengths in mm."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from tactorch.mesh import BodyFile, Shape, TetMesh
from tactorch.mesh.curved import curved_offsets
from tactorch.mesh.geometry import area_vectors
from tactorch.mesh.values import Points, Triangles
from tactorch.sensor.poses import Pose, transform_points

_MIN_FACING = 0.2  # cosine of the angle between z and the normal of a surface that is seen
_INSIDE = -1e-9  # barycentric coordinate of a point on an edge
_MARGIN = 1e-6  # of the circle about a triangle, over its radius
_MAX_STEPS = 100  # of a ray along a signed distance
_ON_SURFACE_MM = 1e-7

Rays = Float[np.ndarray, "q 2"]


class Hits(NamedTuple):
    """Lowest points of a surface on rays along z.

    Attributes:
        triangles: Triangle of each; -1 where a ray meets none.
        barycentric: Its barycentric coordinates.
        z_mm: Height; infinite where a ray meets none.
    """

    triangles: Int[np.ndarray, " q"]
    barycentric: Float[np.ndarray, "q 3"]
    z_mm: Float[np.ndarray, " q"]


def first_hits(points: Points, triangles: Triangles, rays: Rays) -> Hits:
    """Return the lowest points of outward triangles that face -z, on rays at x and y (mm)."""
    corners = points[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.maximum(np.linalg.norm(normals, axis=1), 1e-300)
    facing = np.flatnonzero(normals[:, 2] < -_MIN_FACING * lengths)
    hits = Hits(np.full(len(rays), -1), np.zeros((len(rays), 3)), np.full(len(rays), np.inf))
    row, ray = _near(corners[facing, :, :2], rays)
    shares = _barycentric(corners[facing[row], :, :2], rays[ray])
    inside = (shares >= _INSIDE).all(axis=1)
    row, ray, shares = row[inside], ray[inside], shares[inside]
    heights = (shares * corners[facing[row], :, 2]).sum(axis=1)
    order = np.lexsort((row, heights, ray))
    met, first = np.unique(ray[order], return_index=True)
    lowest = order[first]
    hits.triangles[met], hits.z_mm[met] = facing[row[lowest]], heights[lowest]
    hits.barycentric[met] = shares[lowest]
    return hits


def _near(
    flat: Float[np.ndarray, "t 3 2"], rays: Rays
) -> tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"]]:
    """Return the triangles and rays of all pairs in which a ray is in a circle about a triangle."""
    middles = flat.mean(axis=1)
    radii = np.linalg.norm(flat - middles[:, None], axis=2).max(axis=1)
    found = cKDTree(rays).query_ball_point(middles, (1.0 + _MARGIN) * radii)
    counts = [len(one) for one in found]
    none = np.zeros(0, dtype=np.int64)
    pairs = np.concatenate([none, *(np.array(one, dtype=np.int64) for one in found)])
    return np.repeat(np.arange(len(flat)), counts), pairs


def _barycentric(
    flat: Float[np.ndarray, "p 3 2"], rays: Float[np.ndarray, "p 2"]
) -> Float[np.ndarray, "p 3"]:
    """Return the barycentric coordinates of each ray in a triangle."""
    first = flat[:, 0]
    u, v, offset = flat[:, 1] - first, flat[:, 2] - first, rays - first
    area = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    second = (offset[:, 0] * v[:, 1] - offset[:, 1] * v[:, 0]) / area
    third = (u[:, 0] * offset[:, 1] - u[:, 1] * offset[:, 0]) / area
    return np.column_stack([1.0 - second - third, second, third])


def surface_heights(shape: Shape | TetMesh, pose: Pose, rays: Rays) -> Float[np.ndarray, " q"]:
    """Return the lowest z of a shape in the frame of a pose; infinite where a ray misses it.

    The surface of a mesh is curved between its nodes, see `tactorch.mesh.curved`. Shapes of files
    are their triangles; rays go along the signed distance of others. The pose is the transform from
    the frame of the rays to that of the shape.
    """
    inverse = np.linalg.inv(pose)
    if isinstance(shape, TetMesh):
        return _curved_heights(shape, inverse, rays)
    low, high = shape.bounds()
    if isinstance(shape, BodyFile):
        vertices, triangles = shape.surface()
        return first_hits(transform_points(inverse, vertices), triangles, rays).z_mm
    middle = transform_points(inverse, ((low + high) / 2)[None])[0, 2]
    reach = 0.5 * float(np.linalg.norm(high - low))
    at = np.column_stack([rays, np.full(len(rays), middle - reach)])
    active = np.arange(len(rays))
    z = np.full(len(rays), np.inf)
    for _ in range(_MAX_STEPS):
        away = shape.signed_distance(transform_points(pose, at[active]))
        on = away < _ON_SURFACE_MM
        z[active[on]] = at[active[on], 2]
        at[active, 2] += away
        active = active[~on & (at[active, 2] < middle + reach)]
        if not len(active):
            break
    return z


def _curved_heights(mesh: TetMesh, inverse: Pose, rays: Rays) -> Float[np.ndarray, " q"]:
    points, triangles = transform_points(inverse, mesh.points), mesh.surface.triangles
    hits = first_hits(points, triangles, rays)
    heights, met = hits.z_mm, hits.triangles >= 0
    chosen = hits.triangles[met]
    offsets = curved_offsets(points, triangles, chosen, hits.barycentric[met])
    normals = area_vectors(points, triangles[chosen])
    heights[met] += (offsets * normals).sum(axis=1) / normals[:, 2]
    return heights
