import math
from collections.abc import Callable

import numpy as np
import pytest

from tactorch.errors import MeshError
from tactorch.inverse.result.lump import Depth, Lump
from tactorch.mesh import TetMesh, box_mesh
from tactorch.metrics import contrast_recovery, dice, find_inclusion, position_error_mm, scores

Cells = Callable[..., np.ndarray]


@pytest.fixture
def mesh() -> TetMesh:
    """4 x 4 x 4 cells of 1 mm, each of six tetrahedra."""
    return box_mesh((4.0, 4.0, 4.0), 4)


@pytest.fixture
def cells(mesh: TetMesh) -> Cells:
    """Mask the elements of a block of cells: (x, y, z) to below (x, y, z)."""

    def mask(low: tuple[int, int, int], high: tuple[int, int, int]) -> np.ndarray:
        index = np.floor(mesh.centroids)
        return ((index >= low) & (index < high)).all(axis=1)

    return mask


def test_finds_a_stiff_block(mesh: TetMesh, cells: Cells) -> None:
    block = cells((0, 0, 0), (2, 1, 1))
    youngs = np.where(block, 1.0, 0.2)
    found = find_inclusion(mesh, youngs)
    assert found is not None
    np.testing.assert_array_equal(found.elements, block)
    np.testing.assert_allclose(found.center_mm, [1.0, 0.5, 0.5])
    assert found.volume_mm3 == pytest.approx(2.0)
    assert found.equivalent_radius_mm == pytest.approx((2.0 * 3 / (4 * math.pi)) ** (1 / 3))
    assert found.mean_mpa == pytest.approx(1.0)
    line = "stiff, at (1.00, 0.50, 0.50) mm, radius 0.782 mm: 1 in 0.2 MPa"
    assert str(found).splitlines() == ["Inclusion", f"  {line}"]
    lump = Lump(found, np.array([2.0, 1.0, 1.0]), Depth(3.5, 3.0, np.eye(3)[2], np.zeros(3)), None)
    assert str(lump).splitlines() == ["Lump", f"  {line}, 3.5 mm deep"]
    assert found.background_mpa == pytest.approx(0.2)
    assert found.contrast == pytest.approx(5.0)
    assert found.side == "stiff"


def test_finds_a_soft_block(mesh: TetMesh, cells: Cells) -> None:
    block = cells((1, 1, 1), (3, 3, 3))
    found = find_inclusion(mesh, np.where(block, 0.05, 0.2))
    assert found is not None
    np.testing.assert_array_equal(found.elements, block)
    assert found.side == "soft"
    assert found.contrast == pytest.approx(0.25)


def test_finds_a_single_element(mesh: TetMesh) -> None:
    youngs = np.full(mesh.n_tets, 0.2)
    youngs[100] = 1.0
    found = find_inclusion(mesh, youngs)
    assert found is not None
    np.testing.assert_array_equal(np.flatnonzero(found.elements), [100])


def test_takes_the_larger_of_two_regions(mesh: TetMesh, cells: Cells) -> None:
    small, large = cells((0, 0, 0), (1, 1, 1)), cells((2, 2, 2), (4, 4, 3))
    youngs = np.where(large, 0.9, np.where(small, 1.0, 0.2))
    found = find_inclusion(mesh, youngs)
    assert found is not None
    np.testing.assert_array_equal(found.elements, large)
    assert found.background_mpa == pytest.approx(0.2)


def test_an_element_at_the_bound_hides_no_inclusion(mesh: TetMesh, cells: Cells) -> None:
    """One runaway element, 200 times too soft, against a block five times too stiff."""
    block = cells((0, 0, 0), (2, 2, 2))
    youngs = np.where(block, 1.0, 0.2)
    youngs[np.flatnonzero(~block)[-1]] = 0.001
    found = find_inclusion(mesh, youngs)
    assert found is not None
    assert found.side == "stiff"
    np.testing.assert_array_equal(found.elements, block)


def test_an_extreme_element_hides_no_inclusion_of_its_own_side(mesh: TetMesh, cells: Cells) -> None:
    """One element 250 times too stiff, beside a block half as stiff again as the background."""
    block = cells((0, 0, 0), (2, 2, 2))
    youngs = np.where(block, 0.3, 0.2)
    youngs[np.flatnonzero(~block)[-1]] = 50.0
    found = find_inclusion(mesh, youngs)
    assert found is not None
    np.testing.assert_array_equal(found.elements, block)


def test_background_is_the_median_not_the_mean(mesh: TetMesh, cells: Cells) -> None:
    """Beside a large stiff part, 0.65 is past half way from 0.2 to 1, but not from the mean."""
    stiff, medium = cells((0, 0, 0), (4, 3, 2)), cells((0, 3, 0), (4, 4, 1))
    youngs = np.where(stiff, 1.0, np.where(medium, 0.65, 0.2))
    found = find_inclusion(mesh, youngs)
    assert found is not None
    np.testing.assert_array_equal(found.elements, stiff | medium)


def test_background_is_what_fills_the_volume() -> None:
    """One thick layer of five is most of the body, though a fifth of its elements."""
    mesh = box_mesh((5.0, 5.0, 5.0), 5)
    points = mesh.points.copy()
    points[:, 0] = np.where(points[:, 0] > 0, points[:, 0] + 9, 0)
    mesh = TetMesh.create(points, mesh.tets)
    thick = mesh.centroids[:, 0] < 10
    found = find_inclusion(mesh, np.where(thick, 0.2, 1.0))
    assert found is not None
    np.testing.assert_array_equal(found.elements, ~thick)


def test_an_even_map_has_none(mesh: TetMesh) -> None:
    assert find_inclusion(mesh, np.full(mesh.n_tets, 0.2)) is None
    assert find_inclusion(mesh, np.linspace(0.2, 0.203, mesh.n_tets)) is None


def test_the_truth_scores_perfectly(mesh: TetMesh, cells: Cells) -> None:
    truth = np.where(cells((0, 0, 0), (2, 2, 2)), 1.0, 0.2)
    assert scores(mesh, truth, truth) == {
        "rmse_mpa": 0.0,
        "pearson": pytest.approx(1.0),
        "normalised_correlation": pytest.approx(1.0),
        "ssim": pytest.approx(1.0),
        "psnr": math.inf,
        "position_error_mm": 0.0,
        "contrast_recovery": pytest.approx(1.0),
        "dice": pytest.approx(1.0),
    }


def test_an_inclusion_one_cell_aside(mesh: TetMesh, cells: Cells) -> None:
    truth = np.where(cells((0, 0, 0), (2, 2, 2)), 1.0, 0.2)
    youngs = np.where(cells((1, 0, 0), (3, 2, 2)), 1.0, 0.2)
    assert position_error_mm(mesh, youngs, truth) == pytest.approx(1.0)
    assert dice(mesh, youngs, truth) == pytest.approx(0.5)
    # Half of the 8 mm^3 is found: 0.6 inside; outside, 4 of 56 mm^3 are too stiff.
    background = (4 * 1.0 + 52 * 0.2) / 56
    assert contrast_recovery(mesh, youngs, truth) == pytest.approx((0.6 - background) / 0.8)


def test_half_the_contrast(mesh: TetMesh, cells: Cells) -> None:
    block = cells((1, 1, 1), (3, 3, 3))
    truth, youngs = np.where(block, 1.0, 0.2), np.where(block, 0.6, 0.2)
    assert contrast_recovery(mesh, youngs, truth) == pytest.approx(0.5)
    assert dice(mesh, youngs, truth) == pytest.approx(1.0)


def test_volume_counts_not_the_number_of_elements() -> None:
    """A slab of cells four times as thick as the rest weighs four times as much."""
    mesh = box_mesh((5.0, 5.0, 5.0), 5)
    points = mesh.points.copy()
    points[:, 0] = np.where(points[:, 0] > 0, points[:, 0] + 3, 0)
    mesh = TetMesh.create(points, mesh.tets)
    x, y, z = mesh.centroids.T
    truth = np.where((x < 5) & (y < 1) & (z < 1), 1.0, 0.2)
    youngs = np.where((x < 4) & (y < 1) & (z < 1), 1.0, 0.2)
    assert dice(mesh, youngs, truth) == pytest.approx(2 * 4 / (4 + 5))
    assert position_error_mm(mesh, youngs, truth) == pytest.approx(0.5)
    assert contrast_recovery(mesh, youngs, truth) == pytest.approx(4 / 5)


def test_soft_truth_is_sought_on_the_soft_side(mesh: TetMesh, cells: Cells) -> None:
    hole, artefact = cells((0, 0, 0), (2, 2, 2)), cells((3, 3, 3), (4, 4, 4))
    truth = np.where(hole, 0.05, 0.2)
    youngs = np.where(hole, 0.1, np.where(artefact, 2.0, 0.2))
    assert dice(mesh, youngs, truth) == pytest.approx(1.0)
    assert position_error_mm(mesh, youngs, truth) == pytest.approx(0.0)


def test_an_inclusion_that_was_missed(mesh: TetMesh, cells: Cells) -> None:
    truth = np.where(cells((0, 0, 0), (2, 2, 2)), 1.0, 0.2)
    even = np.full(mesh.n_tets, 0.3)
    assert dice(mesh, even, truth) == 0
    assert contrast_recovery(mesh, even, truth) == pytest.approx(0.0)
    assert math.isnan(position_error_mm(mesh, even, truth))


def test_even_truth_has_no_inclusion_to_score(mesh: TetMesh, cells: Cells) -> None:
    truth = np.full(mesh.n_tets, 0.2)
    youngs = np.where(cells((0, 0, 0), (2, 2, 2)), 1.0, 0.2)
    result = scores(mesh, youngs, truth)
    applies = {name for name, value in result.items() if not math.isnan(value)}
    assert applies == {"rmse_mpa", "ssim", "psnr"}


def test_refuses_fields_of_another_mesh(mesh: TetMesh) -> None:
    other = np.ones(mesh.n_tets - 1)
    with pytest.raises(MeshError, match="youngs has 383 values but the mesh 384 elements"):
        find_inclusion(mesh, other)
    with pytest.raises(MeshError, match="youngs has 383 values but the mesh 384 elements"):
        dice(mesh, other, other)
