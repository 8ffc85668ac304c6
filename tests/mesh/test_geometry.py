import numpy as np
import pytest

from tactorch.mesh.geometry import farthest_point_order


def test_each_is_farthest_from_those_before() -> None:
    points = np.array([[0.0], [1.0], [4.0], [10.0]])
    assert farthest_point_order(points, 3, 0) == [0, 3, 2]
    assert farthest_point_order(points, 9, 1) == [1, 3, 2, 0]


@pytest.mark.parametrize("seed", range(5))
def test_no_index_comes_twice(seed: int) -> None:
    points = np.random.default_rng(seed).integers(0, 2, (12, 2)).astype(float)  # many coincide
    assert sorted(farthest_point_order(points, 12, seed)) == list(range(12))
