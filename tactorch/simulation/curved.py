"""Pressure of a round tool on a surface of any shape.

The pressure is uniform over the cross-section of the tool, and acts along its axis: the total force
is pressure times cross-section on every mesh.
"""

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


def curved_forces(
    discretisation: Discretisation, site: SurfaceSite, radius_mm: float
) -> Float[np.ndarray, "nodes 3"]:
    """Return the nodal forces of a pressure of 1 MPa, N.

    Raises:
        ConfigError: The mesh has no surface under the tool.
    """
    mesh, surface = discretisation.mesh, discretisation.mesh.surface
    corners = mesh.points[surface.triangles]
    facing = -(surface.normals @ site.direction)
    near = np.flatnonzero((facing > 0.0) & _near(corners, site, radius_mm))
    inside = _under(np.einsum("qc,kcd->kqd", _PARTS, corners[near]), site, radius_mm)
    values = discretisation.surface_values(_PARTS)
    weights = (surface.areas * facing)[near] / len(_PARTS)
    shares = (inside * weights[:, None]) @ values
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
    surface = mesh.surface
    facing = surface.normals @ site.direction < 0.0
    nodes = np.unique(surface.triangles[facing])
    pressed = nodes[_under(mesh.points[nodes][None], site, radius_mm)[0]]
    if not len(pressed):
        raise ConfigError(
            f"No node of the mesh is within {radius_mm:.4g} mm of the press at {site.name}, so that"
            " nothing would be observed; enlarge press.patch_radius_mm, or refine the mesh."
        )
    return pressed


def _under(
    points: Float[np.ndarray, "k q 3"], site: SurfaceSite, radius_mm: float
) -> Bool[np.ndarray, "k q"]:
    """Return which points are within the radius of the axis, and near the point along it."""
    offsets = points - site.point_mm
    along = offsets @ site.direction
    across = np.linalg.norm(offsets - along[..., None] * site.direction, axis=2)
    return (across <= radius_mm) & (np.abs(along) <= _DEPTH * radius_mm)


def _near(
    corners: Float[np.ndarray, "t 3 3"], site: SurfaceSite, radius_mm: float
) -> Bool[np.ndarray, " t"]:
    """Return which triangles may be under the tool."""
    centroids = corners.mean(axis=1)
    sizes = np.linalg.norm(corners - centroids[:, None], axis=2).max(axis=1)
    reach = np.hypot(1.0, _DEPTH) * radius_mm + sizes
    return np.linalg.norm(centroids - site.point_mm, axis=1) <= reach
