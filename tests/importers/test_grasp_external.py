"""Real grasps of balls: holds, repetitions, and the order of their moduli."""

from pathlib import Path

import pytest

from tactorch.importers import import_grasp
from tactorch.importers.holds import GraspColumns
from tactorch.inverse import invert
from tactorch.sensor.description import GelLayer

pytestmark = pytest.mark.external
COLUMNS = {"width": "gripper_width_mm"}


@pytest.fixture(scope="module")
def grasps(shared_data: Path) -> Path:
    return shared_data / "grasps"


@pytest.mark.parametrize(
    ("name", "force_n", "width_mm"),
    [
        ("golf_ball_1", 24.0, 35.8),
        ("orange_ball_1", 22.7, 32.3),
        ("orange_ball_2", 23.1, 32.3),
        ("purple_ball_1", 23.1, 39.3),
        ("purple_ball_2", 23.1, 39.3),
        ("red_foam_brick_0", 21.8, 13.2),
    ],
)
def test_holds_are_where_the_tables_show_them(
    grasps: Path, name: str, force_n: float, width_mm: float
) -> None:
    hold = GraspColumns(columns=COLUMNS).hold(grasps / f"{name}.csv")
    assert (hold.force_n, hold.width_mm) == pytest.approx((force_n, width_mm), abs=0.1)
    assert (abs(hold.creep_mm) > 1.0) == (name in ("orange_ball_2", "red_foam_brick_0"))


@pytest.mark.slow
def test_repetitions_agree_and_moduli_are_in_the_order_of_the_hardness(grasps: Path) -> None:
    """About 100 s a grasp."""
    found = []
    for name in ("orange_ball_1", "orange_ball_2", "purple_ball_1", "purple_ball_2"):
        recording = import_grasp(
            grasps / f"{name}.csv", columns=COLUMNS, size_mm=(50.0,), edge_mm=6.0,
            reference=grasps / "golf_ball_1.csv", reference_mm=42.7,
            gel=GelLayer(4.5, 0.2, size_mm=(36.0, 27.0)),
        )  # fmt: skip
        found.append(invert(recording).background_mpa)
    assert found[0] == pytest.approx(found[1], rel=0.1)
    assert found[2] == pytest.approx(found[3], rel=0.1)
    assert found[1] < 0.5 * found[2]
    assert 0.204 < found[2] < 0.553  # conversions of Shore A 2 and Shore 00 62
