"""Contacts of a round sensor: loads, meshes that are fine at the rim, and measured points."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import Delaunay, QhullError

from tactorch.mesh import TetMesh
from tactorch.mesh.closest import closest_points
from tactorch.mesh.refine import Refinement, refine
from tactorch.sampling import Patch

_RIM, _GROWTH = 0.2, 0.6  # longest edge at the rim, over the radius, and its growth with distance
_NEAR, _POINTS = 0.5, 12  # distance of points of a fit, over the radius, and least number of them


def loads(patch: Patch, mesh: TetMesh, force_n: Float[np.ndarray, "3"]) -> Float[np.ndarray, "n 3"]:
    """Return nodal forces of a uniform traction on the patch with this resultant, N."""
    shares = patch.forces(mesh) @ patch.inward
    return (shares / shares.sum())[:, None] * force_n


def refined_at_rim(mesh: TetMesh, patch: Patch) -> Refinement:
    """Return the mesh refined at the rim of a patch, where its traction ends."""
    radius = patch.radius_mm

    def longest_mm(points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        distances, along = patch.coordinates(points)
        return np.asarray(radius * _RIM + _GROWTH * np.hypot(distances - radius, along))

    return refine(mesh, longest_mm)


@dataclass(frozen=True, eq=False)
class Seen:
    """Where a press was, as the robot reported it, and the nodes within its measured points.

    A quadratic polynomial is fitted to the points around each node, by weights that fall to zero at
    a distance of half the radius (moving least squares). It averages the noise of many points.

    Attributes:
        patch: Reported pose.
        points_mm: Measured points of the undeformed surface, (points, 3).
        nodes: Loaded nodes within them, (k,).
        rows: Weights of the points in the value at each of these nodes, (k, points).
    """

    patch: Patch
    points_mm: Float[np.ndarray, "points 3"]
    nodes: Int[np.ndarray, " k"]
    rows: Float[np.ndarray, "k points"]

    @classmethod
    def of(cls, patch: Patch, points_mm: Float[np.ndarray, "points 3"], mesh: TetMesh) -> "Seen":
        """Prepare the nodes of a mesh that a patch loads."""
        loaded = np.flatnonzero(patch.forces(mesh).any(axis=1))
        axes = across(patch.inward)
        points, nodes = ((p - patch.center) @ axes.T for p in (points_mm, mesh.points[loaded]))
        try:
            inside = Delaunay(points).find_simplex(nodes) >= 0
        except (QhullError, ValueError):  # fewer than three points, or all on a line
            inside = np.zeros(len(nodes), dtype=bool)
        rows = [_weights(points, node, _NEAR * patch.radius_mm) for node in nodes[inside]]
        return cls(patch, points_mm, loaded[inside], np.array(rows).reshape(-1, len(points)))

    @property
    def noise(self) -> Float[np.ndarray, " k"]:
        """Standard deviation at each node over that at a point; largest at the edge of them."""
        return np.asarray(np.linalg.norm(self.rows, axis=1))

    def smoothed(
        self, values: Float[np.ndarray, "points 3"], mesh: TetMesh
    ) -> Float[np.ndarray, "n 3"]:
        """Return the displacements of all nodes by those of the points, zero where not known."""
        result = np.zeros((mesh.n_points, 3))
        result[self.nodes] = self.rows @ values
        return result

    def moved(self, step_mm: Float[np.ndarray, "3"], mesh: TetMesh) -> "Seen":
        """Return the press and its points at another place of the surface; nodes move with it."""
        there = np.vstack([self.patch.center, self.points_mm]) + step_mm
        there = closest_points(mesh.points, mesh.surface.triangles, there).points
        return replace(self, patch=replace(self.patch, center=there[0]), points_mm=there[1:])

    def plain(self) -> list[Any]:
        """Return plain values, from which `restored` makes it."""
        patch = self.patch
        pose = [patch.center.tolist(), patch.inward.tolist(), patch.radius_mm]
        return [*pose, self.points_mm.tolist()]

    @classmethod
    def restored(cls, plain: Sequence[Any], mesh: TetMesh) -> "Seen":
        """Return what `plain` returned the values of."""
        center, inward, radius, points = plain
        return cls.of(
            Patch(np.array(center), np.array(inward), float(radius)), np.array(points), mesh
        )


def across(inward: Float[np.ndarray, "3"]) -> Float[np.ndarray, "2 3"]:
    """Return two unit vectors across a direction."""
    return np.asarray(np.linalg.svd(inward[None])[2][1:])


def _weights(
    points: Float[np.ndarray, "k 2"], node: Float[np.ndarray, "2"], reach_mm: float
) -> Float[np.ndarray, " k"]:
    """Return the weights of measured points in the value at a node."""
    offsets = points - node
    distances = np.linalg.norm(offsets, axis=1)
    reach = max(reach_mm, 1.01 * float(np.sort(distances)[min(_POINTS, len(points)) - 1]))
    weights = np.maximum(1.0 - (distances / reach) ** 2, 0.0)
    x, y = (offsets / reach).T
    terms = np.column_stack([np.ones(len(x)), x, y, x * x, x * y, y * y])
    # The value of the polynomial at the node is its first coefficient.
    root = np.sqrt(weights)
    return np.linalg.pinv(terms * root[:, None], rcond=1e-6)[0] * root
