"""Coarser surfaces, for meshes whose elements are far larger than the triangles. Lengths in mm."""

import logging

import numpy as np

from tactorch.errors import MeshError
from tactorch.mesh.checks import closed_surface
from tactorch.mesh.geometry import surface_area
from tactorch.mesh.intersections import require_no_crossing
from tactorch.mesh.values import Points, Triangles

_log = logging.getLogger(__name__)
_PER_EDGE = 2.5  # edges of triangles along one of an element
_MANY = 2.0  # times as many triangles as these take, above which it is worth the time
#: Largest distance of a vertex from the coarser surface, over the edge length.
MAX_DISTANCE = 0.05


def decimated(points: Points, faces: Triangles, edge_mm: float) -> tuple[Points, Triangles]:
    """Return a closed surface with edges of about 0.4 times those of an element's.

    Vertices are within `MAX_DISTANCE` edge lengths of it. The surface itself is returned where its
    triangles are about as large already, or no coarser surface is sound and as close
    (M. Garland and P. Heckbert, SIGGRAPH 1997, p. 209, with the volume kept).
    """
    wanted = surface_area(points, faces) / (np.sqrt(0.1875) * (edge_mm / _PER_EDGE) ** 2)
    if len(faces) < _MANY * wanted:
        return points, faces
    import pyvista

    surface = pyvista.PolyData(points, np.column_stack((np.full(len(faces), 3), faces)).ravel())
    coarse = surface.decimate(1.0 - wanted / len(faces), volume_preservation=True)
    nodes = np.asarray(coarse.points, dtype=np.float64)
    _, nearest = coarse.find_closest_cell(points, return_closest_point=True)
    distance = float(np.linalg.norm(nearest - points, axis=1).max())
    try:
        found = closed_surface(nodes, coarse.faces.reshape(-1, 4)[:, 1:])
        require_no_crossing(*found)
    except MeshError as error:
        _log.info("The surface is meshed with all its triangles: coarser, %s", error)
        return points, faces
    if distance > MAX_DISTANCE * edge_mm:
        return points, faces
    _log.warning(
        "The surface has %d triangles, far finer than edges of %.3g mm; it is meshed with %d, "
        "within %.2g mm.", len(faces), edge_mm, len(found[1]), distance,
    )  # fmt: skip
    return found
