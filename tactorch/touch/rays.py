"""First points of surfaces along z, from below. Lengths in mm."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from tactorch.mesh import BodyFile, Shape, TetMesh
from tactorch.mesh.curved import curved_offsets
from tactorch.mesh.geometry import area_vectors
from tactorch.mesh.values import Points, Triangles
from tactorch.sensor.poses import Pose, transform_points

_MIN_FACING = 0.2  # cosine of the angle between z and the normal of a surface that is seen
_INSIDE = -1e-9  # barycentric coordinate of a point on an edge
_CHUNK = 1_000_000  # pairs of rays and triangles at once
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
    found = np.full(len(rays), -1), np.zeros((len(rays), 3)), np.full(len(rays), np.inf)
    if len(facing):
        step = max(1, _CHUNK // len(facing))
        for begin in range(0, len(rays), step):
            part = slice(begin, begin + step)
            row, shares, z = _lowest(corners[facing], rays[part])
            found[0][part] = np.where(np.isfinite(z), facing[row], -1)
            found[1][part], found[2][part] = shares, z
    return Hits(*found)


def _lowest(
    corners: Float[np.ndarray, "t 3 3"], rays: Rays
) -> tuple[Int[np.ndarray, " q"], Float[np.ndarray, "q 3"], Float[np.ndarray, " q"]]:
    first = corners[:, 0, :2]
    u, v = corners[:, 1, :2] - first, corners[:, 2, :2] - first
    area = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    offset = rays[:, None] - first
    second = (offset[..., 0] * v[:, 1] - offset[..., 1] * v[:, 0]) / area
    third = (u[:, 0] * offset[..., 1] - u[:, 1] * offset[..., 0]) / area
    shares = np.stack([1.0 - second - third, second, third], axis=-1)
    inside = (shares >= _INSIDE).all(axis=-1)
    heights = np.where(inside, np.einsum("qtc,tc->qt", shares, corners[..., 2]), np.inf)
    row = heights.argmin(axis=1)
    every = np.arange(len(rays))
    return row, shares[every, row], heights[every, row]


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
