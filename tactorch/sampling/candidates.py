"""Patches of a curved surface that a round sensor can press, and their nodal forces."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from tactorch.errors import ConfigError
from tactorch.mesh import TetMesh
from tactorch.mesh.geometry import farthest_point_order
from tactorch.mesh.values import Real, positive

_CUTS = 8  # parts along a triangle's edge, each counted in or out of the patch


@dataclass(frozen=True, eq=False)
class Patch:
    """Position of a press, independent of the mesh.

    Attributes:
        center: Point on the surface, mm.
        inward: Unit vector of the push.
        radius_mm: Radius of the sensor, mm.
    """

    center: Float[np.ndarray, "3"]
    inward: Float[np.ndarray, "3"]
    radius_mm: float

    def forces(self, mesh: TetMesh) -> Float[np.ndarray, "n 3"]:
        """Return the nodal forces of a dead pressure of 1 MPa along `inward`, N.

        It acts on the surface that faces the sensor, within the cylinder along `inward` and within
        one and a half radii of the centre. The total is 1 MPa times the sensor's area on every
        mesh, distributed evenly over the sensor's face.

        Raises:
            ConfigError: the mesh has no such surface there.
        """
        surface, facing = mesh.surface, self._facing(mesh)
        weights = _inner_points(_CUTS)
        shares = (self._inside(mesh, weights) @ weights) * (surface.areas * facing)[:, None]
        nodal = np.bincount(surface.triangles.ravel(), shares.ravel(), minlength=mesh.n_points)
        if not nodal.sum() > 0:
            raise ConfigError(
                f"The mesh has no surface within {self.radius_mm:g} mm of the patch at "
                f"{np.round(self.center, 4).tolist()} mm; enlarge the radius, or move the patch."
            )
        scale = np.pi * self.radius_mm**2 / nodal.sum()
        return scale * nodal[:, None] * self.inward

    def facing(self, mesh: TetMesh) -> float:
        """Return the area-weighted mean cosine between the pressed surface and the sensor."""
        inside = self._inside(mesh, _inner_points(_CUTS)).sum(axis=1) * mesh.surface.areas
        return float(inside @ self._facing(mesh) / max(inside.sum(), 1e-300))

    def _facing(self, mesh: TetMesh) -> Float[np.ndarray, " k"]:
        """Cosine between each triangle's normal and the way to the sensor."""
        return -(mesh.surface.normals @ self.inward)

    def _inside(self, mesh: TetMesh, weights: Float[np.ndarray, "q 3"]) -> Bool[np.ndarray, "k q"]:
        """Which inner points of each triangle are pressed."""
        reach = 1.5 * self.radius_mm
        corners = mesh.points[mesh.surface.triangles]
        middles = corners.mean(axis=1)
        sizes = np.linalg.norm(corners - middles[:, None], axis=2).max(axis=1)
        # Most triangles are too far from the centre.
        gaps = np.linalg.norm(middles - self.center, axis=1)
        near = gaps <= np.hypot(self.radius_mm, reach) + sizes
        near &= self._facing(mesh) > 0
        offsets = np.einsum("qc,kcd->kqd", weights, corners[near]) - self.center
        along = offsets @ self.inward
        across = np.linalg.norm(offsets - along[..., None] * self.inward, axis=2)
        inside = np.zeros((len(corners), len(weights)), dtype=bool)
        inside[near] = (across <= self.radius_mm) & (np.abs(along) <= reach)
        return inside


def candidate_patches(
    mesh: TetMesh,
    held: Bool[np.ndarray, " n"],
    radius_mm: Real,
    count: int,
    *,
    min_facing: float = 0.0,
) -> list[Patch]:
    """Return patches that the sensor can press, in farthest-point order from the first.

    Centres are surface vertices, pushed along their mean normal. Patches that load a fixed node
    are excluded. The first is the one farthest from the fixed nodes.

    Args:
        mesh: The body, mm.
        held: Mask of the fixed nodes.
        radius_mm: Radius of the sensor, mm.
        count: Largest number of patches.
        min_facing: Smallest `Patch.facing`; 0.85 excludes edges and corners of a cube.

    Returns:
        The patches, fewer than `count` if the surface has no more.

    Raises:
        ConfigError: radius or count is out of range, no node is fixed, or no patch fits.
    """
    radius = positive("radius_mm", radius_mm)
    if count < 1:
        raise ConfigError(f"count is {count}; ask for at least 1 candidate.")
    if not held.any():
        raise ConfigError("held marks no node, so that the body would fly off; hold some.")
    normals = _vertex_normals(mesh)
    free = [int(i) for i in mesh.surface.nodes() if not held[i]]
    all_patches = (Patch(mesh.points[i], -normals[i], float(radius)) for i in free)
    fitting = [
        patch
        for patch in all_patches
        if not patch.forces(mesh)[held].any()
        and (min_facing <= 0 or patch.facing(mesh) >= min_facing)
    ]
    if not fitting:
        raise ConfigError(
            f"radius_mm={radius:g}: no patch fits without touching what is held; use a smaller one."
        )
    centers = np.array([patch.center for patch in fitting])
    gaps = np.linalg.norm(centers[:, None] - mesh.points[held], axis=2).min(axis=1)
    return [fitting[i] for i in farthest_point_order(centers, count, int(gaps.argmax()))]


def _vertex_normals(mesh: TetMesh) -> Float[np.ndarray, "n 3"]:
    """Outward normals of the surface's vertices, the mean of its triangles' by area."""
    surface = mesh.surface
    total = np.zeros((mesh.n_points, 3))
    weighted = surface.normals * surface.areas[:, None]
    np.add.at(total, surface.triangles.ravel(), np.repeat(weighted, 3, axis=0))
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-300)


def _inner_points(cuts: int) -> Float[np.ndarray, "q 3"]:
    """Evenly spread inner points of a triangle as barycentric weights, with the mean at 1/3."""
    i, j = np.meshgrid(np.arange(cuts), np.arange(cuts), indexing="ij")
    up = np.stack((i, j), axis=-1)[i + j < cuts] + 1 / 3
    down = np.stack((i, j), axis=-1)[i + j < cuts - 1] + 2 / 3
    two = np.concatenate((up, down)) / cuts
    return np.column_stack((two, 1.0 - two.sum(axis=1)))
