"""Descriptions of sensors: what is in them, and what is refused."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactorch.errors import ConfigError, FileError
from tactorch.sensor.description import (
    SENSORS,
    GelLayer,
    MarkerGrid,
    SensorDescription,
    load_sensor,
    save_sensor,
)

GEL_LINE = "gel: {thickness_mm: 2, youngs_mpa: 0.1, radius_mm: 3}\n"
HEAD = "name: s\nimage_size_px: [64, 48]\nmm_per_px: [.1, .1]\n"
GEL = {"thickness_mm": 3.0, "youngs_mpa": 0.2, "size_mm": (20.0, 16.0)}


def sensor(**changes: object) -> SensorDescription:
    fields = {"name": "s", "image_size_px": (64, 48), "mm_per_px": (0.3, 0.3)}
    return SensorDescription(**{**fields, "gel": GelLayer(**GEL), **changes})


@pytest.mark.parametrize("name", SENSORS)
def test_shipped_descriptions_are_sound(name: str, tmp_path: Path) -> None:
    found = load_sensor(name)
    assert found.name == name
    assert found.markers is not None
    inside = found.gel.covers(found.markers.positions_mm)
    assert inside.all()
    save_sensor(found, tmp_path / "sensor.yaml")
    assert load_sensor(tmp_path / "sensor.yaml") == found


def test_every_field_is_kept(tmp_path: Path) -> None:
    one = sensor(
        raw_size_px=(120, 100), intrinsics_px=(100, 100, 60, 50), distortion=[0.1, 0, 0, 0],
        warp_corners_px=[[1, 2], [99, 0], [99, 80], [0, 80]], warped_size_px=(70, 60),
        crop_px=[2, 3, 64, 48], frame_rate_hz=30, markers=MarkerGrid(3, 2, [2, 1], 0.4),
    )  # fmt: skip
    save_sensor(one, tmp_path / "sensor.yaml")
    assert load_sensor(tmp_path / "sensor.yaml") == one


def test_whole_numbers_may_have_a_point(tmp_path: Path) -> None:
    (tmp_path / "sensor.yaml").write_text(HEAD.replace("64", "64.0") + GEL_LINE)
    assert load_sensor(tmp_path / "sensor.yaml").image_size_px == (64, 48)


def test_the_name_may_be_empty(tmp_path: Path) -> None:
    (tmp_path / "sensor.yaml").write_text(HEAD.replace("name: s", "name:") + GEL_LINE)
    assert load_sensor(tmp_path / "sensor.yaml").name == ""


def test_the_papers_finger() -> None:
    finger = load_sensor("finger")
    assert len(finger.markers.positions_mm) == 145
    assert (finger.gel.youngs_mpa, finger.gel.radius_mm, finger.frame_rate_hz) == (0.12, 15.0, 30.0)


@given(x=st.floats(0, 63), y=st.floats(0, 47))
def test_pixels_and_millimetres_go_both_ways(x: float, y: float) -> None:
    one = sensor(mm_per_px=(0.3, 0.25))
    place = np.array([x, y])
    np.testing.assert_allclose(one.to_px(one.to_mm(place)), place, atol=1e-9)
    np.testing.assert_allclose(one.to_mm(np.array([31.5, 23.5])), 0.0, atol=1e-12)
    assert one.size_mm == pytest.approx((19.2, 12.0))


def test_a_curved_face_falls_away_from_the_middle() -> None:
    gel = GelLayer(4.0, 0.12, radius_mm=10.0, curvature_radius_mm=26.0)
    heights = gel.height_mm(np.array([(0.0, 0.0), (10.0, 0.0), (0.0, -10.0)]))
    np.testing.assert_allclose(heights, [0.0, -2.0, -2.0], atol=1e-12)


def test_markers_lie_about_the_middle() -> None:
    grid = MarkerGrid(3, 2, (2.0, 1.0), 0.4, shift_mm=(0.5, 0.0))
    np.testing.assert_allclose(grid.positions_mm.mean(axis=0), (0.5, 0.0), atol=1e-12)
    np.testing.assert_allclose(grid.positions_mm[:3, 0], (-1.5, 0.5, 2.5))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"image_size_px": (64,)}, r"image_size_px=\(64,\): give a list of two whole numbers"),
        ({"image_size_px": (64, 4)}, "whole numbers: .*8 to 20000"),
        ({"mm_per_px": (19.58, 19.58)}, "looks like pixels per mm.*0.05107"),
        ({"mm_per_px": (0.1, -0.1)}, r"mm_per_px=\(0.1, -0.1\): .*above 0"),
        ({"frame_rate_hz": 0.0}, "frame_rate_hz"),
        ({"distortion": (0.1, 0, 0, 0)}, "without intrinsics_px"),
        ({"intrinsics_px": (0, 50, 32, 24)}, "give positive focal lengths"),
        ({"intrinsics_px": (50, 50, 32, 24), "distortion": (0.1,)}, "distortion has 1 number"),
        ({"raw_size_px": (80, 60)}, "give crop_px or warped_size_px"),
        ({"raw_size_px": (80, 60), "crop_px": (20, 0, 64, 48)}, "exceeds the warped image"),
        ({"raw_size_px": (80, 60), "crop_px": (0, 0, 60, 48)}, "keeps 60 x 48"),
        (
            {"warp_corners_px": [(0, 0), (9, 0), (9, 9)]},
            r"four lists of two numbers: \[\[X,Y\],...\]",
        ),
        ({"name": 3}, "name=3: give text. Put it in quotes."),
        ({"warp_corners_px": [(0, 0), (0, 9), (9, 9), (9, 0)]}, "go round a convex figure"),
    ],
)
def test_wrong_descriptions_are_refused(changes: dict, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        sensor(**changes)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"youngs_mpa": 120000.0}, "in Pa.* Then give 0.12"),
        ({"thickness_mm": 0.0}, "thickness_mm"),
        ({"radius_mm": 9.0}, "size_mm .* or radius_mm"),
        ({"size_mm": None}, "size_mm .* or radius_mm"),
        ({"curvature_radius_mm": 12.0}, "overhang"),
        ({"curvature_radius_mm": 15.0}, "falls by"),
    ],
)
def test_wrong_gels_are_refused(changes: dict, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        GelLayer(**{**GEL, **changes})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"columns": 0}, "columns=0"),
        ({"diameter_mm": 2.0}, "markers would overlap"),
        ({"within_mm": 0.1}, "excludes every marker"),
    ],
)
def test_wrong_markers_are_refused(changes: dict, message: str) -> None:
    fields = {"columns": 4, "rows": 4, "pitch_mm": (1.5, 1.5), "diameter_mm": 0.5}
    with pytest.raises(ConfigError, match=message):
        MarkerGrid(**{**fields, **changes})


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name: s\n  gel: [", "is not valid YAML"),
        ("- a\n", "has no fields"),
        (HEAD, "'gel' is missing"),
        (HEAD + "gel: [1, 2]\n", "'gel' is missing or not a table of fields"),
        (HEAD + f"{GEL_LINE}markers: none\n", "'markers' is not a table of fields; give null"),
        (HEAD + "gel: {thickness_mm: 3e0}\n", "gel.thickness_mm='3e0' must be a number"),
        (HEAD + "gel: {thickness_mm: 2, youngs_mpa: 0.1}\n", "gel: give size_mm"),
        (HEAD + "gel: {thickness_mm: 2}\n", "'gel.youngs_mpa' is missing"),
        (f"ppmm: 19\n{GEL_LINE}", "unknown setting 'ppmm'"),
    ],
)
def test_files_that_are_no_descriptions(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "sensor.yaml"
    path.write_text(text)
    with pytest.raises((ConfigError, FileError), match=message) as caught:
        load_sensor(path)
    assert "sensor.yaml" in str(caught.value)


def test_a_description_that_is_not_there() -> None:
    with pytest.raises(FileError, match="or one of finger, gelsight_markers, gelsight_mini"):
        load_sensor("nosuch")
