"""Structured, reproducible meshes for tests, convergence studies and benchmarks."""

from collections.abc import Sequence

import numpy as np

from tactorch.errors import ConfigError
from tactorch.mesh.tetmesh import TetMesh
from tactorch.mesh.values import Real, Vector, sizes, vector

# Corners of a cell are numbered 4 ix + 2 iy + iz.
_FIVE = np.array([(0, 4, 2, 1), (6, 2, 4, 7), (5, 4, 1, 7), (3, 1, 2, 7), (1, 2, 7, 4)])
# Kuhn's subdivision: the paths along the axes from corner 0 to corner 7.
_SIX = [(0, 4, 6, 7), (0, 4, 7, 5), (0, 2, 7, 6), (0, 2, 3, 7), (0, 1, 5, 7), (0, 1, 7, 3)]


def box_mesh(
    size_mm: Vector | Real = 10.0,
    divisions: int | Sequence[int] | np.ndarray = 4,
    *,
    origin_mm: Vector | None = None,
    center_mm: Vector | None = None,
    tets_per_cell: int = 6,
) -> TetMesh:
    """Mesh a cuboid with a regular grid of cells, each cut into tetrahedra.

    Args:
        size_mm: Edge lengths, three or one for a cube.
        divisions: Cells along each edge, three or one for all.
        origin_mm: Lowest corner; the default is (0, 0, 0).
        center_mm: Centre, instead of `origin_mm`.
        tets_per_cell: 6 (around the cell's space diagonal) or 5 (mirrored from cell to cell,
            without a preferred direction).

    Returns:
        The mesh; node (ix, iy, iz) has index (ix (ny + 1) + iy) (nz + 1) + iz.
    """
    size, origin = np.array(sizes("size_mm", size_mm)), np.zeros(3)
    if origin_mm is not None and center_mm is not None:
        raise ConfigError("Give origin_mm or center_mm, not both.")
    if origin_mm is not None:
        origin = np.array(vector("origin_mm", origin_mm))
    if center_mm is not None:
        origin = np.array(vector("center_mm", center_mm)) - size / 2
    three = np.asarray(divisions)
    three = np.broadcast_to(three, 3) if three.ndim == 0 else three
    if three.shape != (3,) or three.dtype.kind not in "iu" or three.min() < 1:
        raise ConfigError(f"divisions={divisions!r} must be one or three positive integers.")
    counts = three.tolist()
    axes = [o + s * np.arange(n + 1) / n for o, s, n in zip(origin, size, counts, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    # The eight nodes of each cell, from its index (ix, iy, iz).
    cells = np.indices(counts).reshape(3, -1).T
    strides = np.array([(counts[1] + 1) * (counts[2] + 1), counts[2] + 1, 1])
    nodes = (cells @ strides)[:, None] + np.indices((2, 2, 2)).reshape(3, -1).T @ strides
    if tets_per_cell == 6:
        tets = nodes[:, _SIX]
    elif tets_per_cell == 5:
        # 7 - corner mirrors a cell through its centre: diagonals of neighbours then agree.
        mirrored = 7 - _FIVE[:, [0, 1, 3, 2]]
        odd = cells.sum(axis=1) % 2 == 1
        tets = np.where(odd[:, None, None], nodes[:, mirrored], nodes[:, _FIVE])
    else:
        raise ConfigError(f"tets_per_cell={tets_per_cell} must be 5 or 6.")
    return TetMesh.create(points, tets.reshape(-1, 4))
