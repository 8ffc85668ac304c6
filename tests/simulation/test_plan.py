import numpy as np
import pytest

from tactorch.config import to_mapping
from tactorch.errors import ConfigError
from tactorch.mesh import FACE_NAMES
from tactorch.simulation import PressPlan
from tactorch.simulation.plan import PressSite


def test_ramp_rises_in_equal_steps() -> None:
    plan = PressPlan(p_max_mpa=0.02, steps=4, faces=("x+", "z+"))
    np.testing.assert_allclose(plan.pressures_mpa, [0.005, 0.01, 0.015, 0.02], rtol=1e-15)
    assert plan.faces == ("x+", "z+")
    assert (len(plan.sites), len(plan.pressures)) == (2, 4)


@pytest.mark.parametrize("face", FACE_NAMES)
def test_direction_is_inward_and_the_opposite_face_is_supported(face: str) -> None:
    site = PressSite(face)
    assert site.opposite[0] == face[0]
    assert site.opposite != face
    assert site.direction["xyz".index(face[0])] == (-1.0 if face.endswith("+") else 1.0)
    assert np.abs(site.direction).sum() == 1.0


def test_every_patch_on_every_face() -> None:
    centers = [(1.0, 2.0, 3.0), (4.0, 5.0, 6.0)]
    plan = PressPlan(("x-", "y+"), patch_radius_mm=1.0, patch_centers_mm=centers)
    assert [(s.face, s.center_mm) for s in plan.sites] == [
        (face, center) for face in ("x-", "y+") for center in centers
    ]


def test_plan_survives_its_configuration() -> None:
    plan = PressPlan(
        "x-", (0.1, 0.2), patch_radius_mm=1.5, patch_centers_mm=[(1, 2, 3)], support="fixed"
    )
    assert PressPlan.from_mapping(to_mapping(plan)) == plan
    assert plan.faces == ("x-",)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"faces": ()}, "faces=.*not empty"),
        ({"faces": ("top",)}, "press.faces=.*top.*give a list of x-, x"),
        ({"faces": ("z+", "z+")}, "repeats"),
        ({"pressures_mpa": ()}, "pressures_mpa=.*not empty"),
        ({"pressures_mpa": (0.01, 0.01)}, "must increase"),
        ({"pressures_mpa": (0.01, -0.02)}, "pressures_mpa=.*above 0"),
        ({"patch_radius_mm": 0.0}, "patch_radius_mm"),
        ({"patch_centers_mm": [(0.0, 0.0, 0.0)]}, "without press.patch_radius_mm"),
        ({"patch_radius_mm": 1.0, "patch_centers_mm": []}, "patch_centers_mm=.*not empty"),
        (
            {"patch_radius_mm": 1.0, "patch_centers_mm": [(0.0, 1.0)]},
            "patch_centers_mm=.*points",
        ),
        ({"support": "glue"}, "support='glue'"),
        ({"spring_n_per_mm": 0.0}, "spring_n_per_mm"),
    ],
)
def test_wrong_plans_are_refused_by_name(fields: dict, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        PressPlan(**fields)


@pytest.mark.parametrize(("highest", "steps"), [(0.0, 3), (0.02, 0)])
def test_wrong_ramps_are_refused(highest: float, steps: int) -> None:
    with pytest.raises(ConfigError):
        PressPlan(p_max_mpa=highest, steps=steps)
