"""Meshes of blocks below a surface that is known at scattered points."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.interpolate import RBFInterpolator
from scipy.spatial import cKDTree

from tactorch.errors import MeshError
from tactorch.mesh.meshing import MAX_CELLS, box_mesh
from tactorch.mesh.tetmesh import TetMesh
from tactorch.mesh.values import Points

_SMOOTHINGS = (0.0, 0.1, 1.0, 10.0, 100.0)  # of thin plates, in squared units of the spacing
_FOLDS, _NEIGHBOURS = 5, 40
_GROWTH = 1.3  # thickness of a layer over that of the one above
_MIN_POINTS, _MIN_PLANE = 10, 3
_PLANE = 1e9  # smoothing that leaves a plane


class HeightField:
    """A smooth height z(x, y) through scattered points: a thin plate, a plane if few.

    The smoothing of a plate is the one that predicts points best that are left out. Beyond the
    points its height is that of the nearest.

    Raises:
        MeshError: there are fewer than three points, or they are in line.
    """

    def __init__(self, points_mm: Points) -> None:
        if len(points_mm) < _MIN_PLANE:
            raise MeshError(
                f"A surface by {len(points_mm)} points is not known; give at least {_MIN_PLANE} for"
                f" a plane, {_MIN_POINTS} for another surface."
            )
        low, high = points_mm[:, :2].min(axis=0), points_mm[:, :2].max(axis=0)
        #: Lowest and highest x and y of the points, mm.
        self.bounds_mm = low, high
        area = float(np.prod(high - low))
        spread = np.linalg.svd(points_mm[:, :2] - points_mm[:, :2].mean(axis=0), compute_uv=False)
        if spread[1] < 1e-3 * spread[0]:
            raise MeshError("The points of the surface are in line; give some that span an area.")
        self._unit = np.sqrt(area / len(points_mm))
        #: Whether it is a plane.
        self.is_plane = len(points_mm) < _MIN_POINTS
        self._points, self._tree = points_mm, cKDTree(points_mm[:, :2])
        if self.is_plane:
            self._plate = self._fit(points_mm, _PLANE)
            squares = (self._plate(points_mm[:, :2] / self._unit) - points_mm[:, 2]) ** 2
            errors, best = [np.sqrt(squares.mean())], 0
        else:
            errors = [self._error(points_mm, smoothing) for smoothing in _SMOOTHINGS]
            best = int(np.argmin(errors))
            self._plate = self._fit(points_mm, _SMOOTHINGS[best])
        #: Root mean square error, mm: of a plate at points that are left out.
        self.error_mm = float(errors[best])

    def _fit(self, points: Points, smoothing: float) -> RBFInterpolator:
        count = min(_NEIGHBOURS, len(points))
        return RBFInterpolator(
            points[:, :2] / self._unit, points[:, 2], neighbors=count, smoothing=smoothing
        )

    def _error(self, points: Points, smoothing: float) -> float:
        fold = np.arange(len(points)) % _FOLDS
        squares = 0.0
        for k in range(_FOLDS):
            out = fold == k
            predicted = self._fit(points[~out], smoothing)(points[out][:, :2] / self._unit)
            squares += float(((predicted - points[out][:, 2]) ** 2).sum())
        return float(np.sqrt(squares / len(points)))

    def __call__(self, xy_mm: Float[np.ndarray, "k 2"]) -> Float[np.ndarray, " k"]:
        """Return the height, mm."""
        _, nearest = self._tree.query(xy_mm)
        # Extrapolation is as far as the points are apart.
        apart = xy_mm - self._points[nearest, :2]
        distance = np.linalg.norm(apart, axis=1, keepdims=True)
        share = np.minimum(1.0, self._unit / np.maximum(distance, 1e-300))
        at = self._points[nearest, :2] + share * apart
        return np.asarray(self._plate(at / self._unit))


class Block(NamedTuple):
    """A block below a surface, and the nodes of its bottom and of its sides."""

    mesh: TetMesh
    bottom: np.ndarray
    sides: np.ndarray


def block_below(height: HeightField, *, depth_mm: float, margin_mm: float, edge_mm: float) -> Block:
    """Mesh the block below a surface, with a flat bottom.

    Cells have about the edge length below the surface, and become higher with the depth.

    Args:
        height: The surface.
        depth_mm: Depth of the bottom below the lowest point of the surface.
        margin_mm: Distance of the sides from the points of the surface.
        edge_mm: Edge length of the cells.

    Raises:
        MeshError: the edge length gives too many cells.
    """
    low, high = height.bounds_mm
    low, high = low - margin_mm, high + margin_mm
    counts = np.maximum(np.ceil((high - low) / edge_mm).astype(int), 1)
    if (cells := int(np.prod(counts))) > MAX_CELLS:
        raise MeshError(
            f"edge_mm={edge_mm:g} gives {cells} cells in a layer; choose a larger one, and check "
            "the units."
        )
    axes = [np.linspace(a, b, n + 1) for a, b, n in zip(low, high, counts, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    top = height(grid)
    bottom = float(top.min()) - depth_mm
    layers = _layers(float(top.mean()) - bottom, edge_mm)
    mesh = box_mesh(1.0, [*counts.tolist(), len(layers) - 1], tets_per_cell=5)
    # Nodes are ordered by x, y and z, from the bottom.
    z = top[:, None] - layers[::-1] * (top - bottom)[:, None]
    points = np.column_stack([np.repeat(grid, len(layers), axis=0), z.ravel()])
    level = np.tile(np.arange(len(layers)), len(grid))
    outer = np.isin(grid[:, 0], axes[0][[0, -1]]) | np.isin(grid[:, 1], axes[1][[0, -1]])
    sides = np.flatnonzero(np.repeat(outer, len(layers)))
    return Block(TetMesh.create(points, mesh.tets), np.flatnonzero(level == 0), sides)


def _layers(height: float, edge: float) -> Float[np.ndarray, " k"]:
    """Depths of the layers of cells, over the height: from 0 to 1."""
    thickness = [edge]
    while sum(thickness) < height:
        thickness.append(_GROWTH * thickness[-1])
    depths = np.concatenate([[0.0], np.cumsum(thickness)])
    return np.asarray(depths / depths[-1])
