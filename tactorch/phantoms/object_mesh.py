"""Meshes to solve presses of the object itself on: faces follow the surfaces of inclusions.

A mesh of the body is refined where an inclusion is small, and its nodes near the surfaces of
inclusions are moved onto them (`tactorch.mesh.conform`). That takes less than a second, and keeps
the even elements of the body. Elements that a surface still crosses, at edges of inclusions and
where these touch each other or the body's surface, need moduli at their quadrature points, see
`Phantom.at_quadrature`.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from tactorch.mesh import Ellipsoid, Rotated, Shape, Sphere, TetMesh, Torus
from tactorch.mesh.conform import ClosedSurface, conform
from tactorch.mesh.refine import Sizing, refine

# Longest edge at the surface of an inclusion, over its inner radius. With 1.2 an L of bars of 2 mm
# takes three times as long in `benchmarks/simulate_object.py`, for an error less by a quarter.
_PER_RADIUS = 1.4
_GROWTH = 0.5  # of the longest edge with the distance from the surface
_POINTS = 16  # along each axis of a grid in the bounding box, which finds the inner radius


def follow_inclusions(mesh: TetMesh, inclusions: Sequence[Shape]) -> TetMesh:
    """Return a mesh of the same body, refined at small inclusions, whose faces follow inclusions.

    Args:
        mesh: Mesh of the body.
        inclusions: Shapes. Those without sharp edges keep their volume.
    """
    if not inclusions:
        return mesh
    surfaces = [ClosedSurface(shape.signed_distance, _volume(shape)) for shape in inclusions]
    return conform(refine(mesh, _sizing(inclusions)), surfaces).mesh


def _sizing(inclusions: Sequence[Shape]) -> Sizing:
    """Return the longest edges (mm) at points (mm): short near surfaces of small inclusions."""
    shortest = [_PER_RADIUS * _inner_radius(shape) for shape in inclusions]

    def sizing(points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        distances = [np.abs(shape.signed_distance(points)) for shape in inclusions]
        return np.min(np.array(shortest)[:, None] + _GROWTH * np.array(distances), axis=0)

    return sizing


def _volume(shape: Shape) -> float | None:
    """Return the volume inside a smooth surface, mm3; None for shapes with sharp edges.

    Chords leave out volume everywhere on a smooth surface, which is moved to make up for it, but at
    sharp edges only on others, whose faces would be wrong thereafter.
    """
    if isinstance(shape, Rotated):
        return _volume(shape.of)
    if isinstance(shape, Torus):
        return float(2.0 * np.pi**2 * shape.radius_mm * shape.tube_mm**2)
    if isinstance(shape, Sphere):
        return float(4.0 / 3.0 * np.pi * shape.radius_mm**3)
    return (
        float(4.0 / 3.0 * np.pi * np.prod(shape.radii_mm)) if isinstance(shape, Ellipsoid) else None
    )


def _inner_radius(shape: Shape) -> float:
    """Return about the largest distance from the surface inside, mm."""
    low, high = shape.bounds()
    grid = (np.indices((_POINTS,) * 3).reshape(3, -1).T + 0.5) / _POINTS
    return float(-shape.signed_distance(low + grid * (high - low)).min())
