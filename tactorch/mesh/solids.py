"""Surfaces of one solid body, as files of scans and of CAD should hold them. Lengths in mm."""

import logging

import numpy as np
from jaxtyping import Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from tactorch.errors import MeshError
from tactorch.mesh.checks import as_cells, as_points, closed_surface
from tactorch.mesh.geometry import bounding_box, enclosed_volume
from tactorch.mesh.intersections import require_no_crossing
from tactorch.mesh.tetmesh import compact
from tactorch.mesh.values import Points, Rows, Triangles

_log = logging.getLogger(__name__)


def solid_surface(
    vertices: Rows, triangles: Rows, *, largest: bool = False
) -> tuple[Points, Triangles]:
    """Return the outward surface of one body; its cavities are bounded by further parts.

    A surface whose normals point inward is turned.

    Args:
        vertices: (n, 3) positions, mm.
        triangles: (k, 3) vertex indices.
        largest: Whether all parts but the one of the largest volume are left out.

    Raises:
        MeshError: The surface is open, not manifold, not consistently oriented or flat, has
            several bodies, or intersects itself; names how many edges or triangles.
    """
    points = as_points(vertices, "vertices")
    faces = as_cells(triangles, 3, len(points), "triangles")
    labels = _parts(faces, len(points))
    count = int(labels.max()) + 1
    volumes = np.array([enclosed_volume(points, faces[labels == k]) for k in range(count)])
    outer = int(np.abs(volumes).argmax())
    if largest and count > 1:
        faces, labels, count = faces[labels == outer], labels[labels == outer], 1
        _log.info("The part of the largest volume is kept of %d.", len(volumes))
    points, faces, _ = compact(points, faces)
    points, turned = closed_surface(points, faces)
    if volumes[outer] < 0.0:
        _log.warning("The normals of the surface point inward; its triangles are turned.")
    if count > 1:
        _check_parts(points, turned, labels, volumes * np.sign(volumes[outer]), outer)
    require_no_crossing(points, turned)
    return points, turned


def _parts(faces: Triangles, n_points: int) -> Int[np.ndarray, " k"]:
    """Return the part of each triangle; parts share no vertex."""
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]]]).T
    links = coo_array((np.ones(ends.shape[1], bool), ends), (n_points, n_points))
    _, labels = connected_components(links, directed=False)
    _, parts = np.unique(labels[faces[:, 0]], return_inverse=True)
    return parts


def _check_parts(
    points: Points,
    faces: Triangles,
    labels: Int[np.ndarray, " k"],
    volumes: np.ndarray,
    outer: int,
) -> None:
    """Refuse parts that are not cavities: inward surfaces within the outer one."""
    low, high = bounding_box(points[faces[labels == outer].ravel()])
    bodies = [
        k for k in range(len(volumes))
        if k != outer and (
            volumes[k] > 0.0
            or (points[faces[labels == k]].min(axis=(0, 1)) < low).any()
            or (points[faces[labels == k]].max(axis=(0, 1)) > high).any()
        )
    ]  # fmt: skip
    if bodies:
        sizes = np.bincount(labels)
        shown = ", ".join(f"{sizes[k]} triangles, {volumes[k]:.3g} mm^3" for k in bodies[:3])
        more = ", ..." if len(bodies) > 3 else ""
        raise MeshError(
            f"The surface has {len(bodies)} parts beside the largest, of {sizes[outer]} triangles:"
            f" {shown}{more}. Remove or join them, or keep the largest only (largest=true). A"
            " part within it is a cavity where its normals point into the cavity."
        )
