import numpy as np
import pytest

from tactorch.errors import ConfigError
from tactorch.mesh import Box, Sphere
from tactorch.phantoms import HOLE_MPA, make_phantom


@pytest.mark.parametrize(
    ("name", "depth"), [("cube_shallow_sphere", 3.0), ("cube_deep_sphere", 6.0)]
)
def test_depth_study_cubes(name: str, depth: float) -> None:
    phantom = make_phantom(name)
    ((ball, youngs),) = phantom.inclusions
    assert phantom.body == Box((5.0, 5.0, 5.0), (10.0, 10.0, 10.0))
    assert ball == Sphere((5.0, 5.0, 10.0 - depth), 2.0)
    assert (phantom.youngs_mpa, youngs) == (0.2, 1.0)


def test_changes_reach_the_phantom() -> None:
    phantom = make_phantom("cube_shallow_sphere", side_mm=20.0, inclusion_mpa=3.0, radius=0.1)
    assert phantom.inclusions == ((Sphere((10.0, 10.0, 14.0), 2.0), 3.0),)


@pytest.mark.parametrize(
    ("name", "changes", "message"),
    [
        ("cube_spher", {}, "phantom=cube_spher is unknown; choose one of uniform_cube"),
        ("cube_sphere", {"widht": 1}, "widht"),
        ("cube_sphere", {"radius": 0.6}, "out of the body"),
        ("cube_sphere", {"radius": -0.2}, "phantom.radius=-0.2: give a number above 0"),
        ("cube_sphere", {"side_mm": 0.0}, "side_mm"),
        ("cube_box", {"youngs_mpa": -1.0}, "youngs_mpa"),
    ],
)
def test_wrong_names_and_values_are_refused(name: str, changes: dict, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        make_phantom(name, **changes)


def test_two_tiers_are_one_above_the_other() -> None:
    phantom = make_phantom("cube_two_tiers")
    x = np.array([0.0, 1.4, 1.6, 2.9, 3.1])
    low = np.column_stack((5 + x, np.full(5, 5.0), np.full(5, 3.5)))
    high = low + np.array([0.0, 0.0, 3.0])
    np.testing.assert_array_equal(phantom.youngs_at(low) == 1.0, [1, 1, 1, 1, 0])
    np.testing.assert_array_equal(phantom.youngs_at(high) == 1.0, [1, 1, 0, 0, 0])


def test_depth_study_is_four_and_thirty_megapascal() -> None:
    phantom = make_phantom("depth_cube", depth=0.3, offset=(0.1, -0.1))
    assert phantom.inclusions == ((Sphere((6.0, 4.0, 7.0), 2.0), 30.0),)
    assert phantom.youngs_mpa == 4.0


def test_hole_bears_nothing() -> None:
    phantom = make_phantom("cylinder_hole_sphere")
    assert sorted(youngs for _, youngs in phantom.inclusions) == [HOLE_MPA, 1.0]
