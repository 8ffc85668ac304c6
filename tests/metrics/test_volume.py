import numpy as np
import pytest
from skimage.metrics import structural_similarity

from tactorch.errors import ConfigError, MeshError
from tactorch.mesh import TetMesh, box_mesh
from tactorch.metrics import ssim


@pytest.fixture
def mesh() -> TetMesh:
    return box_mesh((8.0, 4.0, 2.0), (8, 4, 2))


def by_x(mesh: TetMesh, values: np.ndarray) -> np.ndarray:
    return values[np.floor(mesh.centroids[:, 0]).astype(int)]


def test_a_box_is_plain_ssim_of_the_grids(mesh: TetMesh) -> None:
    """Moduli that vary with x only, a voxel a cell: the grids are known without any search."""
    truth, found = np.linspace(0.2, 1.0, 8), np.linspace(0.3, 0.7, 8)
    grids = [np.broadcast_to(values[:, None, None], (8, 8, 8)).copy() for values in (found, truth)]
    expected = structural_similarity(*grids, win_size=3, data_range=1.0)
    assert ssim(mesh, by_x(mesh, found), by_x(mesh, truth), voxels=8, window=3) == pytest.approx(
        expected
    )


def test_constant_fields_follow_the_formula(mesh: TetMesh) -> None:
    """Without variance only the term of the means is left: (2ab + c) / (a^2 + b^2 + c)."""
    a, b, c = 0.5, 1.0, 0.01**2
    value = ssim(mesh, np.full(mesh.n_tets, a), np.full(mesh.n_tets, b))
    assert value == pytest.approx((2 * a * b + c) / (a * a + b * b + c))
    wide = ssim(mesh, np.full(mesh.n_tets, a), np.full(mesh.n_tets, b), range_mpa=10.0)
    assert wide == pytest.approx((2 * a * b + 100 * c) / (a * a + b * b + 100 * c))


def test_voxels_outside_the_body_do_not_count() -> None:
    """An L of two right and one wrong quarter of a block; the gap takes what is nearest."""
    block = box_mesh((8.8, 8.0, 8.0), 8)
    x, y, _ = block.centroids.T
    kept = ~((x > 4.4) & (y > 4))
    nodes, tets = np.unique(block.tets[kept], return_inverse=True)
    body = TetMesh.create(block.points[nodes], tets.reshape(-1, 4))
    x, y, _ = body.centroids.T
    truth, youngs = np.full(body.n_tets, 0.2), np.where((x < 4.4) & (y > 4), 5.0, 0.2)
    i, j, _ = np.indices((8, 8, 8))
    wrong = ((i < 4) & (j >= 4)) | ((i >= 4) & (j > i))
    _, similarity = structural_similarity(
        np.where(wrong, 5.0, 0.2), np.full((8,) * 3, 0.2), win_size=3, data_range=1.0, full=True
    )
    gap = (i >= 4) & (j >= 4)
    inner = (slice(1, -1),) * 3
    expected = similarity[inner][~gap[inner]].mean()
    assert ssim(body, youngs, truth, voxels=8, window=3) == pytest.approx(expected)
    assert abs(similarity[inner].mean() - expected) > 0.03


@pytest.mark.parametrize("window", [4, 1, 25])
def test_refuses_windows(mesh: TetMesh, window: int) -> None:
    field = np.ones(mesh.n_tets)
    with pytest.raises(ConfigError, match=f"window is {window}"):
        ssim(mesh, field, field, window=window)


def test_refuses_ranges_and_fields(mesh: TetMesh) -> None:
    field = np.ones(mesh.n_tets)
    with pytest.raises(ConfigError, match="range_mpa is 0"):
        ssim(mesh, field, field, range_mpa=0.0)
    with pytest.raises(MeshError, match="youngs has 3 values but the mesh 384"):
        ssim(mesh, np.ones(3), np.ones(3))
