"""The curved surface through the nodes of a mesh. Lengths in mm.

Triangles are chords of a curved body: with edges of 4 mm on a ball of 30 mm they are up to 0.14 mm
inside it, and the curved surface 0.02 mm. Sides of triangles are parabolas, perpendicular to the
normals at both ends where these are symmetric (simplified from T. Nagata, "Simple local
interpolation of surfaces using normal vectors", Comput. Aided Geom. Des. 22 (2005), 327-347).
Normals are not averaged across sharp edges.
"""

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

from tactorch.mesh.closest import closest_points
from tactorch.mesh.geometry import area_vectors, unit_rows, without_flat_elements
from tactorch.mesh.tetmesh import TetMesh
from tactorch.mesh.values import Points, Triangles

_SHARP = np.cos(np.deg2rad(40.0))  # cosine of the angle between normals at a sharp edge


def curved_offsets(
    points: Points,
    triangles: Triangles,
    chosen: Int[np.ndarray, " q"],
    barycentric: Float[np.ndarray, "q 3"],
) -> Float[np.ndarray, "q 3"]:
    """Return the offsets of the curved surface from places in triangles, mm.

    Args:
        points: Nodes, mm.
        triangles: Triangles of the closed surface.
        chosen: Triangle of each place.
        barycentric: Place in the triangle.
    """
    normals, corners = _corner_normals(points, triangles)[chosen], points[triangles[chosen]]
    offsets = np.zeros((len(chosen), 3))
    for i in range(3):
        j = (i + 1) % 3
        first, second, side = normals[:, i], normals[:, j], corners[:, j] - corners[:, i]
        rise = ((second - first) * side).sum(axis=1) / (1.0 + (first * second).sum(axis=1))
        share = 0.5 * barycentric[:, i] * barycentric[:, j] * rise
        offsets += share[:, None] * (first + second)
    return offsets


def onto_curved_surface(fine: TetMesh, coarse: TetMesh) -> TetMesh:
    """Move the boundary nodes that a refinement adds onto the curved surface of the coarse mesh.

    Nodes of elements that would become flat move by less.
    """
    nodes = fine.surface.nodes()
    nodes = nodes[nodes >= coarse.n_points]
    if not len(nodes):
        return fine
    triangles = coarse.surface.triangles
    closest = closest_points(coarse.points, triangles, fine.points[nodes])
    places = closest.triangles, closest.barycentric
    target = fine.points.copy()
    target[nodes] += curved_offsets(coarse.points, triangles, *places)
    points = without_flat_elements(fine.points, target, fine.tets)
    return TetMesh(points, fine.tets, fine.regions)


def _corner_normals(points: Points, triangles: Triangles) -> Float[np.ndarray, "t 3 3"]:
    """Return the normal at each corner of each triangle.

    It is the mean over the triangles that meet there without a sharp edge, weighted by angles.
    """
    normals = unit_rows(area_vectors(points, triangles))
    corners = points[triangles]
    after, before = (unit_rows((np.roll(corners, s, 1) - corners).reshape(-1, 3)) for s in (-1, 1))
    angles = np.arccos(np.clip((after * before).sum(axis=1), -1.0, 1.0))
    count = triangles.size
    at = sp.csr_matrix((np.ones(count), (triangles.ravel(), np.arange(count))))
    own, other = (at.T @ at).nonzero()
    smooth = (normals[own // 3] * normals[other // 3]).sum(axis=1) > _SHARP
    weights = sp.csr_matrix((angles[other[smooth]], (own[smooth], other[smooth] // 3)))
    return unit_rows(weights @ normals).reshape(-1, 3, 3)
