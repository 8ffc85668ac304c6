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


def patch_center(mesh: TetMesh, site: PressSite) -> Float[np.ndarray, "3"]:
    """Return the centre of the patch on the face, mm; by default the middle of the face.

    Raises:
        ConfigError: The centre is outside the face's rectangle.
    """
    low, high = mesh.bounds
    middle = (low + high) / 2
    center = middle if site.center_mm is None else np.array(site.center_mm)
    tangential = [i for i in range(3) if i != site.axis]
    if ((center < low) | (center > high))[tangential].any():
        raise ConfigError(
            f"The patch {site.name} is outside the object, which spans"
            f" {np.round(low, 4).tolist()} to {np.round(high, 4).tolist()} mm; move its centre."
        )
    plane = (high if site.face[1] == "+" else low)[site.axis]
    return np.where(np.arange(3) == site.axis, plane, center)


def nodes_within(
    mesh: TetMesh, nodes: Int[np.ndarray, " k"], site: PressSite, radius_mm: Real
) -> Int[np.ndarray, " q"]:
    """Return the `nodes` within the patch.

    Raises:
        ConfigError: The patch contains no node.
    """
    tangential = [i for i in range(3) if i != site.axis]
    offsets = (mesh.points[nodes] - patch_center(mesh, site))[:, tangential]
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
    """Return the nodal forces of a pressure of 1 MPa on the patch, N.

    Raises:
        ConfigError: The patch's centre is outside the face.
        MeshError: The object has no flat face there.
    """
    mesh = discretisation.mesh
    tangential = [i for i in range(3) if i != site.axis]
    circle = _circle(patch_center(mesh, site)[tangential], float(radius_mm))
    forces = np.zeros((discretisation.n_nodes, 3))
    for index in select_face(mesh, site.face):
        triangle = mesh.surface.triangles[index]
        corners = mesh.points[triangle][:, tangential]
        polygon = _clip(corners, circle)
        if len(polygon) < 3:
            continue
        integrals = _shape_integrals(discretisation, triangle, corners, polygon)
        inward = -mesh.surface.normals[index] * mesh.surface.areas[index]
        for node, integral in integrals:
            forces[node] += integral * inward
    return forces


def _circle(center: Float[np.ndarray, "2"], radius: float) -> Float[np.ndarray, "k 2"]:
    """Regular polygon of the circle's area, counter-clockwise."""
    angles = 2.0 * np.pi * np.arange(_N_SIDES) / _N_SIDES
    outer = radius * np.sqrt(2.0 * np.pi / (_N_SIDES * np.sin(2.0 * np.pi / _N_SIDES)))
    return center + outer * np.column_stack((np.cos(angles), np.sin(angles)))


def _clip(
    polygon: Float[np.ndarray, "k 2"], convex: Float[np.ndarray, "s 2"]
) -> Float[np.ndarray, "q 2"]:
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
        if (left < 0).any():
            polygon = _cut(polygon, left)
    return polygon


def _left_of(starts: np.ndarray, edges: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Twice the area between edges and points, positive where a point is to the left."""
    offsets = points - starts
    return edges[..., 0] * offsets[..., 1] - edges[..., 1] * offsets[..., 0]


def _cut(
    polygon: Float[np.ndarray, "k 2"], left: Float[np.ndarray, " k"]
) -> Float[np.ndarray, "q 2"]:
    """Keep the part of a polygon where `left`, linear between its corners, is not negative."""
    corners = []
    for i in range(len(polygon)):
        a, b, at_a, at_b = polygon[i - 1], polygon[i], left[i - 1], left[i]
        if (at_a < 0) != (at_b < 0):
            corners.append(a + at_a / (at_a - at_b) * (b - a))
        if at_b >= 0:
            corners.append(b)
    return np.array(corners)


def _shape_integrals(
    discretisation: Discretisation,
    triangle: Int[np.ndarray, "3"],
    corners: Float[np.ndarray, "3 2"],
    polygon: Float[np.ndarray, "q 2"],
) -> list[tuple[int, float]]:
    """Integrals of the shape functions over a polygon, divided by the triangle's area."""
    points, weights = _quadrature(polygon)
    edges = (corners[1:] - corners[0]).T
    second_third = np.linalg.solve(edges, (points - corners[0]).T).T
    L = np.column_stack((1.0 - second_third.sum(axis=1), second_third))
    weights = weights / (0.5 * abs(np.linalg.det(edges)))
    if not discretisation.element.quadratic:
        return list(zip(triangle.tolist(), (weights @ L).tolist(), strict=True))
    ends = [(0, 1), (1, 2), (2, 0)]
    nodes = [*triangle.tolist(), *(_midside(discretisation, triangle[list(e)]) for e in ends)]
    at_corners = weights @ (L * (2.0 * L - 1.0))
    at_midsides = [float(weights @ (4.0 * L[:, a] * L[:, b])) for a, b in ends]
    return list(zip(nodes, [*at_corners.tolist(), *at_midsides], strict=True))


def _quadrature(polygon: Float[np.ndarray, "q 2"]) -> tuple[np.ndarray, np.ndarray]:
    """Points and weights that integrate quadratics over a convex polygon exactly.

    The polygon is divided into a fan of triangles with the midpoint rule on their edges.
    """
    a, b, c = polygon[0], polygon[1:-1], polygon[2:]
    ab, ac = b - a, c - a
    areas = 0.5 * np.abs(ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0])
    return np.concatenate(((a + b) / 2, (b + c) / 2, (c + a) / 2)), np.tile(areas / 3.0, 3)


def _midside(discretisation: Discretisation, ends: Int[np.ndarray, "2"]) -> int:
    """Midside node between two vertices; edges are sorted by their end points."""
    n = discretisation.mesh.n_points
    edges = discretisation.edges
    low, high = sorted(ends.tolist())
    return n + int(np.searchsorted(edges[:, 0] * n + edges[:, 1], low * n + high))
