"""Meshes of any shape from a regular lattice: in a fraction of a second, the same every time.

The lattice is cut at the surface of the shape (see `tactorch.mesh.conform`). Boundary nodes are on
the surface, those close to a side of the bounding box on this side, so that flat sides are flat and
the mesh has the bounding box of the shape. Other sharp edges are cut off within an element.
"""

import numpy as np

from tactorch.errors import MeshError
from tactorch.mesh.conform import ClosedSurface, conform
from tactorch.mesh.geometry import without_flat_elements
from tactorch.mesh.meshing import MAX_CELLS, box_mesh, require_few
from tactorch.mesh.refine import Refinement
from tactorch.mesh.shapes import Distances, Shape
from tactorch.mesh.tetmesh import TetMesh, compact
from tactorch.mesh.values import Points, Real, Tets, positive

# Mean edge of a cube divided into six tetrahedra, per side.
_MEAN_EDGE = 1.28
_MIN_CELLS = 3  # along each side
_ON_SURFACE = 1e-6  # distance of nodes that are on the surface, cells
_ON_SIDE = 0.2  # distance of nodes that are moved onto a side of the bounding box, cells


def lattice_mesh(shape: Shape, edge_length_mm: Real) -> TetMesh:
    """Mesh a shape with a mean edge length; the result depends on the arguments alone.

    Parts thinner than an element are lost.

    Raises:
        ConfigError: The edge length would take too many elements.
        MeshError: Parts of the shape are thinner than an element, so that the mesh falls apart.
    """
    mesh, inside, low, cell = _cut(shape, positive("edge_length_mm", edge_length_mm))
    if not inside.any():
        raise MeshError(
            f"No element of {edge_length_mm:.4g} mm is inside the body; choose a smaller edge"
            " length."
        )
    points, tets, _ = compact(mesh.points, mesh.tets[inside])
    try:
        return TetMesh.create(_with_flat_sides(points, tets, low, cell), tets)
    except MeshError as error:
        raise MeshError(
            f"The body cannot be meshed with edges of {edge_length_mm:.4g} mm: {error} Parts that"
            " are thinner than an element are lost; choose a smaller edge length."
        ) from error


def _cut(shape: Shape, edge: float) -> tuple[TetMesh, np.ndarray, np.ndarray, np.ndarray]:
    """Return a lattice, its elements inside a shape, the low corner of this, and the cell.

    Planes of the lattice are sides of the shape's box.
    """
    low, high = shape.bounds()
    counts = np.maximum(np.round((high - low) * _MEAN_EDGE / edge).astype(int), _MIN_CELLS)
    require_few(edge, float(np.prod(counts + 2)), MAX_CELLS, "cells")
    cell = (high - low) / counts
    lattice = box_mesh((cell * (counts + 2)).tolist(), counts + 2, origin_mm=(low - cell).tolist())
    whole = Refinement(lattice, lattice, np.arange(lattice.n_tets), np.empty((0, 2), dtype=int))
    tolerance = _ON_SURFACE * float(cell.min())

    def level(at: Points) -> Distances:
        distances = shape.signed_distance(at)
        return np.where(np.abs(distances) < tolerance, 0.0, distances)

    found = conform(whole, [ClosedSurface(level, None)])
    return found.mesh, found.sides[0] < 0, low, cell


def _with_flat_sides(points: Points, tets: Tets, low: np.ndarray, cell: np.ndarray) -> Points:
    """Move nodes near the sides of the bounding box onto them, where elements stay valid."""
    sizes = np.array(np.ptp(points, axis=0))
    sides = low, low + np.round(sizes / cell) * cell
    moved = points
    for side in sides:
        moved = np.where(np.abs(moved - side) < _ON_SIDE * cell, side, moved)
    return without_flat_elements(points, moved, tets)
