"""A uniform pressure on a circular patch of a flat side, exact whatever the mesh.

The circle (a polygon of equal area) is intersected with each triangle of the side, and the shape
functions are integrated over what is common. So the total force is pressure times area on every
mesh, and its moment is right too: the same press may be put on a fine and on a coarse mesh.
"""

import numpy as np
from jaxtyping import Float, Int

from tactorch.errors import ConfigError
from tactorch.fem import Discretisation
from tactorch.mesh import TetMesh, select_face
from tactorch.mesh.values import Real
from tactorch.simulation.plan import Series

_SIDES = 96


def patch_center(mesh: TetMesh, series: Series) -> Float[np.ndarray, "3"]:
    """Return the centre of the patch on the side, mm; the side's middle where none is given.

    Raises:
        ConfigError: It lies outside the side's rectangle.
    """
    low, high = mesh.bounds
    middle = (low + high) / 2
    center = middle if series.center_mm is None else np.array(series.center_mm)
    across = [i for i in range(3) if i != series.axis]
    if ((center < low) | (center > high))[across].any():
        raise ConfigError(
            f"The patch {series.name} lies beside the object, which spans"
            f" {np.round(low, 4).tolist()} to {np.round(high, 4).tolist()} mm; move its centre."
        )
    plane = (high if series.face[1] == "+" else low)[series.axis]
    return np.where(np.arange(3) == series.axis, plane, center)


def nodes_within(
    mesh: TetMesh, nodes: Int[np.ndarray, " k"], series: Series, radius_mm: Real
) -> Int[np.ndarray, " q"]:
    """Return those of the `nodes` that lie within the patch.

    Raises:
        ConfigError: There are none.
    """
    across = [i for i in range(3) if i != series.axis]
    offsets = (mesh.points[nodes] - patch_center(mesh, series))[:, across]
    inside = nodes[np.linalg.norm(offsets, axis=1) <= radius_mm]
    if not len(inside):
        raise ConfigError(
            f"No node of the mesh lies within {radius_mm:.4g} mm of the patch {series.name}, so"
            " nothing would be observed; enlarge patch_radius_mm, or refine the mesh."
        )
    return inside


def patch_forces(
    discretisation: Discretisation, series: Series, radius_mm: Real
) -> Float[np.ndarray, "nodes 3"]:
    """Return the nodal forces of a pressure of 1 MPa on the patch, N.

    Raises:
        ConfigError: The patch's centre lies beside the side.
        MeshError: The object has no flat side there.
    """
    mesh = discretisation.mesh
    across = [i for i in range(3) if i != series.axis]
    circle = _circle(patch_center(mesh, series)[across], float(radius_mm))
    forces = np.zeros((discretisation.n_nodes, 3))
    for index in select_face(mesh, series.face):
        triangle = mesh.surface.triangles[index]
        corners = mesh.points[triangle][:, across]
        common = _clip(corners, circle)
        if len(common) < 3:
            continue
        shares = _shares(discretisation, triangle, corners, common)
        inward = -mesh.surface.normals[index] * mesh.surface.areas[index]
        for node, share in shares:
            forces[node] += share * inward
    return forces


def _circle(center: Float[np.ndarray, "2"], radius: float) -> Float[np.ndarray, "k 2"]:
    """A regular polygon of the circle's area, counter-clockwise."""
    angles = 2.0 * np.pi * np.arange(_SIDES) / _SIDES
    outer = radius * np.sqrt(2.0 * np.pi / (_SIDES * np.sin(2.0 * np.pi / _SIDES)))
    return center + outer * np.column_stack((np.cos(angles), np.sin(angles)))


def _clip(
    polygon: Float[np.ndarray, "k 2"], convex: Float[np.ndarray, "s 2"]
) -> Float[np.ndarray, "q 2"]:
    """Return what a polygon has in common with a convex, counter-clockwise one.

    One edge of `convex` at a time cuts off what is to its right (Sutherland and Hodgman, 1974).
    """
    edges = np.roll(convex, -1, axis=0) - convex
    sides = _left_of(convex[:, None], edges[:, None], polygon)
    if (sides <= 0).all(axis=1).any():
        return polygon[:0]
    # An edge that has the whole polygon on its left leaves it as it is, now and later.
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
    kept = []
    for i in range(len(polygon)):
        a, b, at_a, at_b = polygon[i - 1], polygon[i], left[i - 1], left[i]
        if (at_a < 0) != (at_b < 0):
            kept.append(a + at_a / (at_a - at_b) * (b - a))
        if at_b >= 0:
            kept.append(b)
    return np.array(kept)


def _shares(
    discretisation: Discretisation,
    triangle: Int[np.ndarray, "3"],
    corners: Float[np.ndarray, "3 2"],
    common: Float[np.ndarray, "q 2"],
) -> list[tuple[int, float]]:
    """Integrals of the shape functions over `common`, as shares of the triangle's area."""
    points, weights = _rule(common)
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


def _rule(polygon: Float[np.ndarray, "q 2"]) -> tuple[np.ndarray, np.ndarray]:
    """Points and weights that integrate quadratics over a convex polygon exactly.

    It is cut into a fan of triangles; each takes the middles of its edges.
    """
    a, b, c = polygon[0], polygon[1:-1], polygon[2:]
    ab, ac = b - a, c - a
    areas = 0.5 * np.abs(ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0])
    return np.concatenate(((a + b) / 2, (b + c) / 2, (c + a) / 2)), np.tile(areas / 3.0, 3)


def _midside(discretisation: Discretisation, ends: Int[np.ndarray, "2"]) -> int:
    """The midside node between two vertices; edges are sorted by their end points."""
    n = discretisation.mesh.n_points
    edges = discretisation.edges
    low, high = sorted(ends.tolist())
    return n + int(np.searchsorted(edges[:, 0] * n + edges[:, 1], low * n + high))
