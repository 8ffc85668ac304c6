"""Uniform pressure on a circular patch of a flat face, integrated exactly on any mesh.

The circle (a polygon of equal area) is intersected with each triangle of the face, and the shape
functions are integrated over the intersection. The total force is pressure times area and the
moment is exact on every mesh, so the same press can be applied to a fine and to a coarse mesh.
"""

import numpy as np
from jaxtyping import Float, Int

from tactorch.errors import ConfigError
from tactorch.fem import Discretisation
from tactorch.mesh import TetMesh, select_face
from tactorch.mesh.values import Real
from tactorch.simulation.plan import PressSite

_N_SIDES = 96
Polygon = Float[np.ndarray, "k 2"]


def patch_center(mesh: TetMesh, site: PressSite) -> Float[np.ndarray, "3"]:
    """Return the centre of the patch on the face, mm; by default the middle of the face."""
    low, high = mesh.bounds
    center = (low + high) / 2 if site.center_mm is None else np.array(site.center_mm)
    if ((center < low) | (center > high))[site.tangential].any():
        raise ConfigError(
            f"The patch {site.name} is outside the object, which spans"
            f" {np.round(low, 4).tolist()} to {np.round(high, 4).tolist()} mm; move its centre."
        )
    plane = (high if site.face[1] == "+" else low)[site.axis]
    return np.where(np.arange(3) == site.axis, plane, center)


def nodes_within(
    mesh: TetMesh, nodes: Int[np.ndarray, " k"], site: PressSite, radius_mm: Real
) -> Int[np.ndarray, " q"]:
    """Return the `nodes` within the patch; at least one."""
    offsets = (mesh.points[nodes] - patch_center(mesh, site))[:, site.tangential]
    inside = nodes[np.linalg.norm(offsets, axis=1) <= radius_mm]
    if not len(inside):
        raise ConfigError(
            f"No node of the mesh is within {radius_mm:.4g} mm of the patch {site.name}, so"
            " nothing would be observed; enlarge press.patch_radius_mm, or refine the mesh."
        )
    return inside


def patch_forces(
    discretisation: Discretisation, site: PressSite, radius_mm: Real
) -> Float[np.ndarray, "nodes 3"]:
    """Return the nodal forces of a pressure of 1 MPa on the patch, N."""
    mesh = discretisation.mesh
    # A regular polygon of the circle's area, counter-clockwise.
    angles = 2.0 * np.pi * np.arange(_N_SIDES) / _N_SIDES
    area = _N_SIDES * np.sin(2.0 * np.pi / _N_SIDES)  # twice that of the unit polygon
    outer = float(radius_mm) * np.sqrt(2.0 * np.pi / area)
    center = patch_center(mesh, site)[site.tangential]
    circle = center + outer * np.column_stack((np.cos(angles), np.sin(angles)))
    forces = np.zeros((discretisation.n_nodes, 3))
    for index in select_face(mesh, site.face):
        triangle = mesh.surface.triangles[index]
        corners = mesh.points[triangle][:, site.tangential]
        polygon = _clip(corners, circle)
        if len(polygon) >= 3:
            weights, barycentric = _quadrature(corners, polygon)
            integrals = weights @ discretisation.surface_values(barycentric)
            inward = -mesh.surface.normals[index] * mesh.surface.areas[index]
            forces[discretisation.surface_nodes(triangle[None])[0]] += integrals[:, None] * inward
    return forces


def _clip(polygon: Polygon, convex: Float[np.ndarray, "s 2"]) -> Float[np.ndarray, "q 2"]:
    """Return the intersection of a polygon with a convex, counter-clockwise one.

    Each edge of `convex` cuts off the part to its right (Sutherland and Hodgman, 1974).
    """
    edges = np.roll(convex, -1, axis=0) - convex
    sides = _left_of(convex[:, None], edges[:, None], polygon)
    if (sides <= 0).all(axis=1).any():
        return polygon[:0]
    # Edges with the whole polygon on their left do not change it.
    for i in np.flatnonzero((sides < 0).any(axis=1)):
        left = _left_of(convex[i], edges[i], polygon)
        if (left <= 0).all():
            return polygon[:0]
        corners = []
        for k, (b, at_b) in enumerate(zip(polygon, left, strict=True)):
            a, at_a = polygon[k - 1], left[k - 1]
            if (at_a < 0) != (at_b < 0):
                corners.append(a + at_a / (at_a - at_b) * (b - a))
            if at_b >= 0:
                corners.append(b)
        polygon = np.array(corners)
    return polygon


def _left_of(starts: np.ndarray, edges: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Twice the area between edges and points, positive where a point is to the left."""
    offsets = points - starts
    return edges[..., 0] * offsets[..., 1] - edges[..., 1] * offsets[..., 0]


def _quadrature(
    corners: Float[np.ndarray, "3 2"], polygon: Polygon
) -> tuple[Float[np.ndarray, " q"], Float[np.ndarray, "q 3"]]:
    """Weights, by the triangle's area, and barycentric coordinates of points of a polygon."""
    # A fan of triangles with the midpoint rule on their edges is exact for quadratics.
    a, b, c = polygon[0], polygon[1:-1], polygon[2:]
    ab, ac = b - a, c - a
    areas = 0.5 * np.abs(ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0])
    points = np.concatenate(((a + b) / 2, (b + c) / 2, (c + a) / 2))
    edges = (corners[1:] - corners[0]).T
    weights = np.tile(areas / 3.0, 3) / (0.5 * abs(np.linalg.det(edges)))
    second_third = np.linalg.solve(edges, (points - corners[0]).T).T
    return weights, np.column_stack((1.0 - second_third.sum(axis=1), second_third))
