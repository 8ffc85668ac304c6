"""Pressure of a round tool, such as a sensor, on a surface of any shape.

The pressure is uniform over the cross-section of the tool, and acts along its axis: the total force
is pressure times cross-section on every mesh.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from tactorch.errors import ConfigError
from tactorch.fem import Discretisation
from tactorch.mesh import TetMesh
from tactorch.mesh.quadrature import lattice
from tactorch.simulation.plan import SurfaceSite

# Centroids of 64 equal parts of a triangle: each is counted in or out of the cross-section.
_PARTS = np.concatenate([lattice(8, 1 / 3, corners=3), lattice(7, 2 / 3, corners=3)])
_DEPTH = 1.5  # of the surface under the tool from the point, over the radius


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
        """
        surface = mesh.surface
        shares = (self._inside(mesh) @ _PARTS) * (surface.areas * self._cosines(mesh))[:, None]
        nodal = np.bincount(surface.triangles.ravel(), shares.ravel(), minlength=mesh.n_points)
        if not nodal.sum() > 0:
            raise ConfigError(
                f"The mesh has no surface within {self.radius_mm:g} mm of the patch at "
                f"{np.round(self.center, 4).tolist()} mm; enlarge the radius, or move the patch."
            )
        return np.pi * self.radius_mm**2 / nodal.sum() * nodal[:, None] * self.inward

    def facing(self, mesh: TetMesh) -> float:
        """Return the area-weighted mean cosine between the pressed surface and the sensor."""
        inside = self._inside(mesh).sum(axis=1) * mesh.surface.areas
        return float(inside @ self._cosines(mesh) / max(inside.sum(), 1e-300))

    def covered(self, mesh: TetMesh, margin_mm: float = 0.0) -> float:
        """Return the share of the sensor's area, wider by a margin, that the surface covers."""
        wide = replace(self, radius_mm=self.radius_mm + margin_mm)
        areas = wide._inside(mesh).mean(axis=1) * mesh.surface.areas
        return float(areas @ wide._cosines(mesh) / (np.pi * wide.radius_mm**2))

    def coordinates(
        self, points: Float[np.ndarray, "*k 3"]
    ) -> tuple[Float[np.ndarray, "*k"], Float[np.ndarray, "*k"]]:
        """Return the distances of points from the axis along `inward`, and those along it, mm."""
        offsets = points - self.center
        along = offsets @ self.inward
        across = np.linalg.norm(offsets - along[..., None] * self.inward, axis=-1)
        return np.asarray(across), along

    def _covers(self, points: Float[np.ndarray, "*k 3"]) -> Bool[np.ndarray, "*k"]:
        """Return which points are within the radius of the axis, and near the centre along it."""
        across, along = self.coordinates(points)
        return (across <= self.radius_mm) & (np.abs(along) <= _DEPTH * self.radius_mm)

    def _cosines(self, mesh: TetMesh) -> Float[np.ndarray, " k"]:
        """Cosine between each triangle's normal and the direction to the sensor."""
        return -(mesh.surface.normals @ self.inward)

    def _inside(self, mesh: TetMesh) -> Bool[np.ndarray, "k q"]:
        """Which inner points of each triangle are pressed."""
        near, pressed = self._pressed(mesh)
        inside = np.zeros((len(mesh.surface.triangles), len(_PARTS)), dtype=bool)
        inside[near] = pressed
        return inside

    def _pressed(self, mesh: TetMesh) -> tuple[Int[np.ndarray, " t"], Bool[np.ndarray, "t q"]]:
        """Triangles near the patch, as most are too far away, and which inner points it presses."""
        corners = mesh.points[mesh.surface.triangles]
        centroids = corners.mean(axis=1)
        sizes = np.linalg.norm(corners - centroids[:, None], axis=2).max(axis=1)
        reach = np.hypot(1.0, _DEPTH) * self.radius_mm + sizes
        close = np.linalg.norm(centroids - self.center, axis=1) <= reach
        near = np.flatnonzero(close & (self._cosines(mesh) > 0.0))
        return near, self._covers(np.einsum("qc,kcd->kqd", _PARTS, corners[near]))


def curved_forces(
    discretisation: Discretisation, site: SurfaceSite, radius_mm: float
) -> Float[np.ndarray, "nodes 3"]:
    """Return the nodal forces of a pressure of 1 MPa, N.

    Raises:
        ConfigError: The mesh has no surface under the tool.
    """
    mesh, surface = discretisation.mesh, discretisation.mesh.surface
    patch = Patch(site.point_mm, site.direction, radius_mm)
    near, inside = patch._pressed(mesh)
    weights = (surface.areas * patch._cosines(mesh))[near] / len(_PARTS)
    shares = (inside * weights[:, None]) @ discretisation.surface_values(_PARTS)
    nodes = discretisation.surface_nodes(surface.triangles[near])
    along = np.bincount(nodes.ravel(), shares.ravel(), minlength=discretisation.n_nodes)
    if not along.sum() > 0.0:
        raise ConfigError(
            f"The mesh has no surface within {radius_mm:.4g} mm of the press at {site.name}; "
            "enlarge press.patch_radius_mm, or refine the mesh."
        )
    scale = np.pi * radius_mm**2 / along.sum()
    forces: np.ndarray = scale * along[:, None] * site.direction
    return forces


def nodes_under(mesh: TetMesh, site: SurfaceSite, radius_mm: float) -> Int[np.ndarray, " k"]:
    """Return the nodes of the surface under the tool; at least one.

    Raises:
        ConfigError: There is none.
    """
    patch = Patch(site.point_mm, site.direction, radius_mm)
    nodes = np.unique(mesh.surface.triangles[patch._cosines(mesh) > 0.0])
    pressed = nodes[patch._covers(mesh.points[nodes])]
    if not len(pressed):
        raise ConfigError(
            f"No node of the mesh is within {radius_mm:.4g} mm of the press at {site.name}, so that"
            " nothing would be observed; enlarge press.patch_radius_mm, or refine the mesh."
        )
    return pressed
