"""A body whose surface is read from a file. Lengths in mm."""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError
from tactorch.mesh.closest import closest_points
from tactorch.mesh.geometry import area_vectors, bounding_box, unit_rows
from tactorch.mesh.io import MESH_SUFFIXES, naming, read_mesh, read_surface
from tactorch.mesh.shapes import Distances, Shape
from tactorch.mesh.solids import solid_surface
from tactorch.mesh.surfaces import TriangleSurface
from tactorch.mesh.tetmesh import compact
from tactorch.mesh.topology import matched_edges, triangle_edges
from tactorch.mesh.values import Corners, Points, Triangles, checked

_ON_EDGE = 1e-9  # barycentric coordinate below which a point is on an edge or a vertex


def _text(name: str, value: Any) -> str:
    if not isinstance(value, str | Path) or not str(value):
        raise ConfigError(f"{name}={value!r} is not the path of a file.")
    return str(value)


def _unit(name: str, value: Any) -> str:
    if value not in ("mm", "cm", "m"):
        raise ConfigError(f"{name}={value!r} is no unit; choose mm, cm or m.")
    return str(value)


@dataclass(frozen=True)
class BodyFile(Shape):
    """Body bounded by the surface of a .stl, .obj or .ply file, or of a mesh of tetrahedra.

    The surface is closed and of one body, see `solid_surface`.

    Attributes:
        path: Path of the file.
        unit: Length unit of the file: "mm", "cm" or "m".
    """

    path: Any = checked(_text)
    unit: str = checked(_unit, "mm")

    def signed_distance(self, points: Points) -> Distances:
        """Return the distance of each point (n, 3) to the surface, mm, negative inside."""
        vertices, triangles = self.surface()
        closest = closest_points(vertices, triangles, points)
        normals = _normals_at(vertices, triangles, closest.triangles, closest.barycentric)
        outside = ((points - closest.points) * normals).sum(axis=1) > 0.0
        return np.where(outside, closest.distances, -closest.distances)

    def bounds(self) -> Corners:
        """Return the lowest and the highest corner of the bounding box, mm."""
        return bounding_box(self.surface()[0])

    def surface(self, segments: int = 48) -> TriangleSurface:
        """Return vertices (mm) and outward triangles of the file; `segments` has no effect."""
        path = Path(self.path)
        stamp = path.stat().st_mtime_ns if path.is_file() else 0
        return _read(str(path), self.unit, stamp)


@lru_cache(maxsize=8)
def _read(path: str, unit: str, stamp: int) -> TriangleSurface:
    if Path(path).suffix.lower() in MESH_SUFFIXES:
        mesh = read_mesh(path, unit)
        points, triangles, _ = compact(mesh.points, mesh.surface.triangles)
    else:
        points, triangles = read_surface(path, unit)
    with naming(path):
        return solid_surface(points, triangles)


def _normals_at(
    vertices: Points,
    triangles: Triangles,
    nearest: np.ndarray,
    barycentric: Float[np.ndarray, "q 3"],
) -> Float[np.ndarray, "q 3"]:
    """Return normals at points of triangles that tell inside from outside.

    At edges they are the sum of those of both triangles, at vertices weighted by angles
    (J. A. Baerentzen and H. Aanaes, IEEE Trans. Vis. Comput. Graph. 11, 2005, p. 243).
    """
    faces = unit_rows(area_vectors(vertices, triangles))
    at_vertices = np.zeros_like(vertices)
    for k in range(3):
        a, b, c = (vertices[triangles[:, (k + i) % 3]] for i in range(3))
        u, v = b - a, c - a
        lengths = np.linalg.norm(u, axis=1) * np.linalg.norm(v, axis=1)
        angles = np.arccos(np.clip((u * v).sum(axis=1) / np.maximum(lengths, 1e-300), -1.0, 1.0))
        np.add.at(at_vertices, triangles[:, k], angles[:, None] * faces)
    normals = faces[nearest]
    zero = barycentric < _ON_EDGE
    on_edge = zero.sum(axis=1) == 1
    opposite = zero[on_edge].argmax(axis=1)
    pairs = matched_edges(triangle_edges(triangles))
    at_edges = np.empty((3 * len(triangles), 3))
    at_edges[pairs] = faces[pairs // 3].sum(axis=1, keepdims=True)
    normals[on_edge] = at_edges[3 * nearest[on_edge] + (opposite + 1) % 3]
    at_corner = zero.sum(axis=1) >= 2
    corner = barycentric[at_corner].argmax(axis=1)
    normals[at_corner] = at_vertices[triangles[nearest[at_corner], corner]]
    return normals
