"""Carrying forces and displacements from the gel's nodes to the object's.

Forces keep their sum and their moment, whatever the two meshes: what presses, presses as a whole.
"""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.interpolate import RBFInterpolator
from scipy.spatial import Delaunay

from tactorch.errors import ConfigError

_TURNS = 1e-9  # least share of the largest moment of inertia about an axis that can bear a couple


def carry_forces(
    points: Float[np.ndarray, "k 3"],
    forces: Float[np.ndarray, "k 3"],
    nodes: Float[np.ndarray, "n 3"],
    triangles: Int[np.ndarray, "t 3"],
) -> Float[np.ndarray, "n 3"]:
    """Return forces on the nodes of a surface, with the same sum and moment.

    Each force goes to the corners of the triangle nearest to it, in shares of its place there; the
    moment that is lost where it lay off the surface comes back as a couple over the loaded nodes.

    Args:
        points: Where the forces act, mm.
        forces: N.
        nodes: Positions of the mesh's nodes, mm.
        triangles: Of its surface, as indices of nodes.

    Raises:
        ConfigError: There is no triangle.
    """
    if not len(triangles):
        raise ConfigError("the object has no surface where it is touched.")
    corners, shares = _nearest(points, nodes, triangles)
    found = np.zeros(nodes.shape)
    np.add.at(found, corners, shares[..., None] * forces[:, None])
    lost = np.cross(points, forces).sum(axis=0) - np.cross(nodes, found).sum(axis=0)
    loaded = np.unique(corners[np.linalg.norm(forces, axis=1) > 0])
    if len(loaded):
        found[loaded] += _couple(nodes[loaded], lost)
    return found


def _nearest(
    points: np.ndarray, nodes: np.ndarray, triangles: np.ndarray
) -> tuple[Int[np.ndarray, "k 3"], Float[np.ndarray, "k 3"]]:
    """The triangle nearest to each point, and the shares of its corners."""
    chosen = np.zeros((len(points), 3), dtype=np.int64)
    shares = np.zeros((len(points), 3))
    corners = nodes[triangles]
    for i, point in enumerate(points):
        own = _closest_shares(corners, point)
        near = np.einsum("tc,tcd->td", own, corners)
        best = int(np.argmin(((near - point) ** 2).sum(axis=1)))
        chosen[i], shares[i] = triangles[best], own[best]
    return chosen, shares


def _closest_shares(
    corners: Float[np.ndarray, "t 3 3"], point: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "t 3"]:
    """Shares of the corners at each triangle's point nearest to a point."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, ac, ap = b - a, c - a, point - a
    d11, d12, d22 = ((u * v).sum(axis=1) for u, v in ((ab, ab), (ab, ac), (ac, ac)))
    p1, p2 = (ab * ap).sum(axis=1), (ac * ap).sum(axis=1)
    below = np.maximum(d11 * d22 - d12**2, 1e-300)
    v, w = (d22 * p1 - d12 * p2) / below, (d11 * p2 - d12 * p1) / below
    shares = np.stack([1 - v - w, v, w], axis=1)
    outside = (shares < 0).any(axis=1)
    if outside.any():
        shares[outside] = _on_edges(corners[outside], point)
    return shares


def _on_edges(corners: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Shares at the nearest point of the triangles' edges."""
    best, nearest = np.zeros((len(corners), 3)), np.full(len(corners), np.inf)
    for one, other in ((0, 1), (1, 2), (2, 0)):
        begin, along = corners[:, one], corners[:, other] - corners[:, one]
        t = ((point - begin) * along).sum(axis=1) / np.maximum((along**2).sum(axis=1), 1e-300)
        t = np.clip(t, 0.0, 1.0)
        distance = ((begin + t[:, None] * along - point) ** 2).sum(axis=1)
        closer = distance < nearest
        shares = np.zeros((len(corners), 3))
        shares[:, one], shares[:, other] = 1 - t, t
        best[closer], nearest[closer] = shares[closer], distance[closer]
    return best


def _couple(nodes: Float[np.ndarray, "n 3"], moment: Float[np.ndarray, "3"]) -> np.ndarray:
    """Smallest forces without a sum that have a moment, as far as the nodes can bear it."""
    arms = nodes - nodes.mean(axis=0)
    inertia = (arms**2).sum() * np.eye(3) - arms.T @ arms
    values, axes = np.linalg.eigh(inertia)
    bearing = values > _TURNS * max(values[-1], 1e-300)
    turn = axes[:, bearing] @ ((axes[:, bearing].T @ moment) / values[bearing])
    return np.cross(turn, arms)


def carry_displacements(
    points: Float[np.ndarray, "k 3"],
    moved: Float[np.ndarray, "k 3"],
    nodes: Float[np.ndarray, "n 3"],
    normal: Float[np.ndarray, "3"],
    smoothing: float = 0.0,
) -> tuple[Float[np.ndarray, "n 3"], Bool[np.ndarray, " n"]]:
    """Return displacements at nodes, and which of them lie among the points.

    A thin plate over the plane across the normal is laid through the displacements. Nodes outside
    the points' hull in that plane get NaN: nothing was seen there.

    Args:
        points: Where displacements are known, mm.
        moved: Displacements there, mm; rows with NaN do not count.
        nodes: Where they are asked for, mm.
        normal: Of the face that is touched.
        smoothing: Of the plate; 0 goes through every displacement.

    Raises:
        ConfigError: Fewer than four displacements are known, or they lie on a line.
    """
    known = np.isfinite(moved).all(axis=1)
    if known.sum() < 4:
        raise ConfigError(f"{int(known.sum())} displacements are known; at least four are needed.")
    across = np.linalg.svd(normal[None])[2][1:].T
    flat, asked = points[known] @ across, nodes @ across
    if np.linalg.matrix_rank(flat - flat.mean(axis=0), tol=1e-9) < 2:
        raise ConfigError("the displacements that are known lie on a line.")
    inside = np.asarray(Delaunay(flat).find_simplex(asked) >= 0)
    found = np.full(nodes.shape, np.nan)
    if inside.any():
        plate = RBFInterpolator(flat, moved[known], neighbors=min(40, int(known.sum())),
                                smoothing=smoothing, kernel="thin_plate_spline")  # fmt: skip
        found[inside] = plate(asked[inside])
    return found, inside
