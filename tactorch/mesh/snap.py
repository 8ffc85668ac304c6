"""Nodes of a mesh moved onto the surface that it was made from. Lengths in mm."""

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from tactorch.mesh.closest import closest_points
from tactorch.mesh.geometry import area_vectors, signed_volumes, unit_rows
from tactorch.mesh.sharp_edges import sharp_edges
from tactorch.mesh.tetmesh import TetMesh
from tactorch.mesh.values import Points, Triangles

_SHARP = np.cos(np.deg2rad(40.0))  # cosine of the angle between normals at a sharp edge
_ROUNDS = 10  # in which nodes of faulty elements are moved back
_MIN_VOLUME = 0.25  # of an element, over that before
_MAX_SAMPLES = 1_000_000  # on sharp edges


def onto_surface(mesh: TetMesh, vertices: Points, triangles: Triangles, reach_mm: float) -> TetMesh:
    """Move the boundary nodes of a mesh onto the closed surface that it fills.

    Those near its sharp edges are moved onto these, and flat sides become flat. No node moves by
    more than `reach_mm`, and those of elements that would lose more than three quarters of their
    volume remain where they are.
    """
    nodes = mesh.surface.nodes()
    start = mesh.points[nodes]
    target = closest_points(vertices, triangles, start).points
    edges, corners = _sharp(vertices, triangles)
    if len(edges):
        on_edge = _on_segments(vertices[edges], start, reach_mm)
        near = np.linalg.norm(on_edge - start, axis=1) < 0.5 * reach_mm
        target[near] = on_edge[near]
    if len(corners):
        distances, nearest = cKDTree(start).query(vertices[corners])
        close = distances < reach_mm
        target[nearest[close]] = vertices[corners[close]]
    far = np.linalg.norm(target - start, axis=1) > reach_mm
    target[far] = start[far]
    points, smallest = mesh.points.copy(), _MIN_VOLUME * mesh.volumes
    points[nodes] = target
    for _ in range(_ROUNDS):
        faulty = signed_volumes(points, mesh.tets) < smallest
        if not faulty.any():
            return TetMesh.create(points, mesh.tets)
        back = np.unique(mesh.tets[faulty])
        points[back] = mesh.points[back]
    return mesh


def _sharp(
    vertices: Points, triangles: Triangles
) -> tuple[Int[np.ndarray, "e 2"], Int[np.ndarray, " c"]]:
    """Return the sharp edges of a closed surface, and the vertices at which they meet or end."""
    sharp = sharp_edges(triangles, unit_rows(area_vectors(vertices, triangles)), _SHARP)
    number = np.bincount(sharp.ravel(), minlength=len(vertices))
    sides = unit_rows(vertices[sharp[:, 1]] - vertices[sharp[:, 0]])
    total = np.zeros_like(vertices)  # of the unit vectors from each vertex along its sharp edges
    np.add.at(total, sharp[:, 0], sides)
    np.add.at(total, sharp[:, 1], -sides)
    bent = np.linalg.norm(total, axis=1) > 2.0 * np.sin(np.deg2rad(20.0))
    return sharp, np.flatnonzero((number > 0) & ((number != 2) | bent))


def _on_segments(
    ends: Float[np.ndarray, "e 2 3"], queries: Float[np.ndarray, "q 3"], spacing_mm: float
) -> Float[np.ndarray, "q 3"]:
    """Return the closest points of the segments whose samples are closest."""
    sides = ends[:, 1] - ends[:, 0]
    lengths = np.linalg.norm(sides, axis=1)
    spacing = max(spacing_mm, lengths.sum() / _MAX_SAMPLES)
    counts = np.ceil(lengths / spacing).astype(int) + 1
    owner = np.repeat(np.arange(len(ends)), counts)
    rank = np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts)
    fractions = rank / np.maximum(counts[owner] - 1, 1)
    _, nearest = cKDTree(ends[owner, 0] + fractions[:, None] * sides[owner]).query(queries)
    segment = owner[nearest]
    start, side = ends[segment, 0], sides[segment]
    along = ((queries - start) * side).sum(axis=1) / np.maximum((side * side).sum(axis=1), 1e-300)
    return np.asarray(start + np.clip(along, 0.0, 1.0)[:, None] * side)
