"""Surfaces of inclusions, and of what belongs to them with a given probability."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from skimage.measure import marching_cubes

from tactorch.inverse import ShapeReconstruction
from tactorch.inverse.fields import InclusionShape

_POINTS = 40  # of the grid along its longest side
_DRAWS = 100  # of the posterior
_MARGIN = 0.1  # of the grid beyond the inclusion, over the inclusion's size
_TAIL = 0.05  # probability outside a 90 % interval, on either side


class Surface(NamedTuple):
    """Corners of a closed surface, mm, and those of each of its triangles."""

    points: Float[np.ndarray, "n 3"]
    triangles: Int[np.ndarray, "t 3"]


class LumpSurfaces(NamedTuple):
    """The most probable inclusion, and where its boundary is.

    `inner` and `outer` are around the points that belong to it with probabilities above 95 % and
    5 %; None without any.
    """

    best: Surface
    inner: Surface | None
    outer: Surface | None
    youngs_mpa: float


def lump_surfaces(shapes: ShapeReconstruction) -> list[LumpSurfaces]:
    """Return the surfaces of each of the `inclusions` of a result."""
    field = shapes.posterior.field
    draws = [list(field.shapes(z)) for z in shapes.samples[:_DRAWS]]
    return [
        _surfaces(inclusion.shape, [draw[k] for draw in draws], inclusion.youngs_mpa)
        for inclusion, k in zip(shapes.inclusions, shapes.order, strict=True)
    ]


def _surfaces(
    best: InclusionShape, draws: Sequence[InclusionShape], youngs_mpa: float
) -> LumpSurfaces:
    spans = np.array([_bounds(shape) for shape in (best, *draws)])
    # Few draws may be far larger than the others, and would make the grid coarse.
    low, high = np.quantile(spans[:, 0], 0.02, axis=0), np.quantile(spans[:, 1], 0.98, axis=0)
    low, high = np.minimum(low, spans[0, 0]), np.maximum(high, spans[0, 1])
    margin = _MARGIN * (high - low).max()
    low, high = low - margin, high + margin
    step = float((high - low).max()) / (_POINTS - 1)
    counts = np.ceil((high - low) / step).astype(int) + 1
    points = low + step * np.indices(counts).reshape(3, -1).T
    inside = np.mean([shape.contains(points) for shape in draws], axis=0).reshape(counts)
    surface = Surface(*best.surface())
    inner, outer = (_level(inside, level, low, step) for level in (1.0 - _TAIL, _TAIL))
    return LumpSurfaces(surface, inner, outer, youngs_mpa)


def _level(
    values: Float[np.ndarray, "x y z"], level: float, low: Float[np.ndarray, "3"], step: float
) -> Surface | None:
    """Return the surface around the points of a grid whose values are above a level."""
    closed = np.pad(values, 1, constant_values=min(float(values.min()), level - 1e-9))
    if not closed.max() > level:
        return None
    points, triangles, _, _ = marching_cubes(closed, level)
    return Surface(low + step * (points.astype(float) - 1.0), triangles.astype(int))


def _bounds(shape: InclusionShape) -> Float[np.ndarray, "2 3"]:
    center = np.array(shape.center_mm)
    return np.array([center - shape.half_size_mm, center + shape.half_size_mm])
