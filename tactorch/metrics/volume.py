"""Structural similarity in space, on a voxel grid."""

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError
from tactorch.mesh import TetMesh, VoxelGrid
from tactorch.metrics.checks import check_on_mesh


def ssim(
    mesh: TetMesh,
    youngs: Float[np.ndarray, " m"],
    truth: Float[np.ndarray, " m"],
    *,
    voxels: int = 24,
    window: int = 7,
    range_mpa: float = 1.0,
) -> float:
    """Return the mean structural similarity over the body, on the scale of the paper's tables.

    The bounding box is divided into `voxels` in each direction; each voxel takes the modulus of the
    element with the nearest centroid. Voxels outside the body extend its modulus outward, so that
    windows across the surface contain no artificial step; they are excluded from the mean. So are
    voxels whose window exceeds the grid, unless no voxel of the body would be left. For a box this
    equals `skimage.metrics.structural_similarity` of the two grids.

    Args:
        mesh: The body, m elements.
        youngs: Moduli, (m,), MPa.
        truth: True moduli, (m,), MPa.
        voxels: Voxels in each direction.
        window: Edge of the cubic window, voxels, odd.
        range_mpa: Range of the data, MPa.

    Raises:
        ConfigError: The window does not fit the grid, or the range is not above 0.
        MeshError: A field does not fit the mesh.
    """
    from skimage.metrics import structural_similarity

    check_on_mesh(mesh, "youngs", youngs)
    check_on_mesh(mesh, "truth", truth)
    if window % 2 == 0 or not 3 <= window <= voxels:
        raise ConfigError(f"window is {window}; it must be odd, and from 3 to {voxels} voxels")
    if not (np.isfinite(range_mpa) and range_mpa > 0):
        raise ConfigError(f"range_mpa is {range_mpa}; give a range above 0 MPa")
    grid = VoxelGrid(mesh, voxels)
    elements, inside = grid.nearest, grid.inside
    _, similarity = structural_similarity(
        youngs[elements], truth[elements], win_size=window, data_range=range_mpa, full=True
    )
    inner = np.zeros_like(inside)
    margin = window // 2
    inner[(slice(margin, -margin),) * 3] = True
    counted = inside & inner
    return float(similarity[counted if counted.any() else inside].mean())
