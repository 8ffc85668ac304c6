import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactorch.errors import ConfigError
from tactorch.mesh import box_mesh

lengths = st.floats(0.1, 50.0)
counts = st.integers(1, 4)


@settings(deadline=None, max_examples=25)
@given(
    size=st.tuples(lengths, lengths, lengths),
    divisions=st.tuples(counts, counts, counts),
    tets_per_cell=st.sampled_from([5, 6]),
)
def test_any_box(
    size: tuple[float, float, float], divisions: tuple[int, int, int], tets_per_cell: int
) -> None:
    mesh = box_mesh(size, divisions, tets_per_cell=tets_per_cell)
    a, b, c = divisions
    assert mesh.n_points == (a + 1) * (b + 1) * (c + 1)
    assert mesh.n_tets == a * b * c * tets_per_cell
    assert mesh.volumes.sum() == pytest.approx(np.prod(size))
    # Conforming: the boundary is that of the box, two triangles a cell side.
    assert len(mesh.surface.triangles) == 4 * (a * b + b * c + c * a)


def test_node_order() -> None:
    mesh = box_mesh((2.0, 3.0, 4.0), (2, 3, 4), origin_mm=(5.0, 6.0, 7.0))
    np.testing.assert_allclose(mesh.points[(1 * 4 + 2) * 5 + 3], (6.0, 8.0, 10.0))


def test_placing() -> None:
    assert box_mesh(2.0, 1).bounds.tolist() == [[0, 0, 0], [2, 2, 2]]
    assert box_mesh(2, 1, center_mm=(0, 0, 5)).bounds.tolist() == [[-1, -1, 4], [1, 1, 6]]


def test_deterministic() -> None:
    assert box_mesh(2.0, 3).content_hash() == box_mesh(2.0, 3).content_hash()


def test_five_favours_no_direction() -> None:
    """Each inner corner of the five-tetrahedra pattern is mirrored; six has one diagonal only."""
    mesh = box_mesh(2.0, 2, tets_per_cell=5)
    at_corners = np.bincount(mesh.tets.ravel())[[0, 2, 6, 8, 18, 20, 24, 26]]
    assert len(set(at_corners.tolist())) == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"size_mm": 0.0}, "size_mm"),
        ({"size_mm": (1, 2)}, "size_mm.*three"),
        ({"size_mm": "wide"}, "size_mm"),
        ({"size_mm": (1, 2, np.nan)}, "size_mm.*finite"),
        ({"divisions": 0}, "divisions=0"),
        ({"divisions": (1, 2)}, "divisions"),
        ({"tets_per_cell": 4}, "tets_per_cell=4"),
        ({"origin_mm": (0, 0, 0), "center_mm": (0, 0, 0)}, "not both"),
        ({"origin_mm": (0, 0)}, "origin_mm"),
    ],
)
def test_unusable_values(arguments: dict, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        box_mesh(**arguments)
