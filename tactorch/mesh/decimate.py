"""Coarser surfaces, for meshes whose elements are far larger than the triangles. Lengths in mm."""

import logging

import numpy as np
from jaxtyping import Float, Int

from tactorch.errors import MeshError
from tactorch.mesh.checks import closed_surface
from tactorch.mesh.geometry import surface_area
from tactorch.mesh.intersections import require_no_crossing
from tactorch.mesh.values import Points, Triangles

_log = logging.getLogger(__name__)
_PER_EDGE = (2.0, 4.0)  # edges of triangles along one of an element, of which the first are tried
_MANY = 2.0  # times as many triangles as these take, above which it is worth the time
#: Largest distance of a vertex from the coarser surface, over the edge length.
MAX_DISTANCE = 0.05


def decimated(
    points: Points, faces: Triangles, edge_mm: float
) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "t 3"]]:
    """Return a closed surface with edges of half or a quarter of those of elements.

    Vertices are within `MAX_DISTANCE` edge lengths of it. The surface itself is returned where its
    triangles are about as large already, or no coarser surface is sound and as close.
    """
    for parts in _PER_EDGE:
        wanted = surface_area(points, faces) / (np.sqrt(0.1875) * (edge_mm / parts) ** 2)
        if len(faces) < _MANY * wanted:
            break
        try:
            nodes, triangles, distance = _coarser(points, faces, 1.0 - wanted / len(faces))
        except MeshError:  # open, folded or crossing itself
            continue
        if distance <= MAX_DISTANCE * edge_mm:
            _log.warning(
                "The surface has %d triangles, far finer than edges of %.3g mm; it is meshed with "
                "%d, within %.2g mm.", len(faces), edge_mm, len(triangles), distance,
            )  # fmt: skip
            return nodes, triangles
    return points, faces


def _coarser(
    points: Points, faces: Triangles, reduction: float
) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "t 3"], float]:
    """Return a surface without a share of the triangles, and the distance of the vertices, mm.

    (M. Garland and P. Heckbert, SIGGRAPH 1997, p. 209, with the volume kept.)
    """
    import pyvista

    surface = pyvista.PolyData(points, np.insert(faces, 0, 3, axis=1).ravel())
    coarse = surface.decimate(reduction, volume_preservation=True)
    found = closed_surface(np.asarray(coarse.points), coarse.faces.reshape(-1, 4)[:, 1:])
    require_no_crossing(*found)
    _, nearest = coarse.find_closest_cell(points, return_closest_point=True)
    return *found, float(np.linalg.norm(nearest - points, axis=1).max())
