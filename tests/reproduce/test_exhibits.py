"""Each exhibit, from the smallest study that makes it."""

import csv
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from tactorch.errors import ConfigError, TactorchError
from tactorch.inverse.fields import InclusionShape
from tactorch.inverse.result.shapes import Interval, ShapeInclusion
from tactorch.mesh import box_mesh
from tactorch.phantoms import make_phantom
from tactorch.reproduce import EXHIBITS, depths, recognition, reproduce, sizes
from tactorch.reproduce.cases import CaseResult
from tactorch.reproduce.depths import classify_depth
from tactorch.reproduce.exhibits import STUDIES, TITLES
from tactorch.simulation import PressPlan, simulate

_COARSE = 0.25
TINY = {
    "credibility": {"divisions": 3, "layers": 3},
    "models": {
        "names": ["4c", "5b"],
        "relative_edge_length": _COARSE,
        "p_max_mpa": 0.02,
        "steps": 1,
        "patches": 2,
        "patch_steps": 1,
        "sensor_mm": 3.0,
        "noise_relative": 1e-5,
        "tnc_evaluations": 3,
        "tnc_patience": 2,
    },
    "design": {"meshes": ["same"], "relative_edge_length": 0.35, "layers": 4},
    "sizes": {"relative_edge_length": _COARSE, "steps": 1, "snr_db": 40.0},
    "depths": {
        "places": 1,
        "relative_edge_length": _COARSE,
        "faces": ["z+", "x+", "y+"],
        "p_max_mpa": 0.1,
        "steps": 1,
        "support": "fixed",
        "snr_db": 40.0,
        "seed": 1,
        "estimate": "map",
    },
}


@contextmanager
def _silent(study: str) -> Iterator:
    yield lambda done, total, note: None


def made(name: str, out: Path) -> str:
    (path,) = reproduce(name, TINY, out, workers=1, progress=_silent)
    assert path == out / f"{name}.md"
    text = path.read_text()
    assert text.startswith(f"# {TITLES[name]}\n")
    assert name in (out / "README.md").read_text()
    for picture in (line for line in text.splitlines() if line.startswith("![")):
        file = out / picture.rpartition("(")[2].rstrip(")")
        assert file.read_bytes()[:4] == b"\x89PNG"
    return text


def rows(out: Path, name: str) -> list[dict[str, str]]:
    with open(out / f"{name}.csv") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def out(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("reproduced")


def test_credibility_falls_with_depth(out):
    text = made("fig3", out)
    assert "in 9 of 9 cubes" in text
    table = rows(out, "fig3")
    assert len(table) == 27
    softest = [float(r["L, mm/MPa"]) for r in table if r["Young's modulus, MPa"] == "5.0"]
    stiffest = [float(r["L, mm/MPa"]) for r in table if r["Young's modulus, MPa"] == "10.0"]
    assert np.all(np.array(softest) > np.array(stiffest))


@pytest.mark.slow
def test_table1_holds_both_methods_beside_the_paper(out):
    text = made("table1", out)
    table = {r["model"]: r for r in rows(out, "table1")}
    assert set(table) == {"4c", "5b"}
    assert table["4c"]["s / iteration: paper"] == "0.36"
    assert float(table["4c"]["SSIM at the end: ours"]) > 0.5
    # Three solves are too few for truncated Newton: its time is a lower bound, and said to be.
    assert table["4c"]["s to the paper's SSIM: TNC"].startswith(">")
    assert "lower bound" in text


@pytest.mark.slow
def test_maps_of_the_models_come_from_the_same_cases(out):
    made("fig4", out)
    stored = sorted(path.name for path in (out / "cases" / "models").glob("*.npz"))
    made("fig5", out)
    assert sorted(p.name for p in (out / "cases" / "models").glob("*.npz")) == stored
    assert {r["model"] for r in rows(out, "fig4")} == {"4c"}
    assert {r["model"] for r in rows(out, "fig5")} == {"5b"}


@pytest.mark.slow
def test_sizes_shift_the_modulus_as_the_paper_says(out, monkeypatch):
    monkeypatch.setattr(sizes, "SIZES", {k: sizes.SIZES[k] for k in ("80 %", "120 %")})
    monkeypatch.setattr(sizes, "_METHODS", ("contact",))
    made("fig9", out)
    table = {(r["assumed"], r["method"]): r for r in rows(out, "fig9")}
    assert len(table) == 2
    small, large = (float(table[size, "contact"]["median, MPa"]) for size in ("80 %", "120 %"))
    assert small > 0.2 > large


def test_depths_are_told(out, monkeypatch):
    monkeypatch.setattr(depths, "DEPTHS_MM", (3.0, 6.0))
    text = made("fig10", out)
    table = rows(out, "fig10")
    assert [float(r["true depth, mm"]) for r in table] == [3, 6]
    assert "accuracy of the depth class, of seven | 0.9500" in text
    off = [abs(float(r["estimate, mm"]) - float(r["true depth, mm"])) for r in table]
    assert max(off) < 1.0
    for depth, error in zip((3, 6), off, strict=True):
        (line,) = [one for one in text.splitlines() if one.startswith(f"| {depth} | 1 |")]
        assert f"| {error:.2f} |" in line


@pytest.mark.parametrize("count", [0, 2])
def test_the_ball_is_the_surest_hard_shape(monkeypatch, count):
    """A soft shape and two hard ones, or none."""
    mesh = box_mesh(10.0, 3)
    recording = simulate(make_phantom("uniform_cube"), PressPlan(("z+",), (0.01,)), mesh=mesh)

    def inclusion(youngs_mpa, probability, x):
        axes = tuple(map(tuple, np.eye(3)))
        shape = InclusionShape((x, 5.0, 7.0), (2.0,) * 3, axes, youngs_mpa / 4)
        interval = Interval(1.0, 2.0)
        return ShapeInclusion(
            shape, youngs_mpa, 4.0, (0.1,) * 3, interval, interval, interval, probability
        )

    hard = [inclusion(30.0, 0.9, 4.0), inclusion(30.0, 0.99, 6.0)][:count]
    found = SimpleNamespace(
        inclusions=[inclusion(1.0, 1.0, 5.0), *hard], youngs_at=lambda points: points[:, 2]
    )
    monkeypatch.setattr(depths, "find_shapes", lambda given: found)
    youngs, ball = depths._from_shapes(recording)
    np.testing.assert_array_equal(youngs, mesh.centroids[:, 2])
    if not count:
        assert ball is None
        return
    assert ball.center_mm.tolist() == [6.0, 5.0, 7.0]
    assert ball.radius_mm == pytest.approx(2.0)


@pytest.mark.slow
def test_shapes_tell_the_depth_more_exactly(out, monkeypatch):
    monkeypatch.setattr(depths, "DEPTHS_MM", (3.0,))
    monkeypatch.setitem(TINY, "depths", TINY["depths"] | {"estimate": "shapes"})
    made("fig10", out)
    (row,) = rows(out, "fig10")
    assert abs(float(row["estimate, mm"]) - 3.0) < 0.25


def test_depths_without_any_lump_are_reported():
    case = CaseResult({"depth_mm": None, "off_mm": None, "radius_mm": None, "seconds": 1.0})
    exhibit = depths.fig10({"2mm-00": case}, {"places": 1})
    assert exhibit.figure is None
    text = "\n".join(exhibit.paragraphs)
    assert "| no inclusion detected |  | 1 |" in text
    assert "accuracy of the depth class, of seven | 0.9500 | 0.0000" in text


@pytest.mark.parametrize(("depth", "told"), [(2.49, 2.0), (2.51, 3.0), (9.9, 8.0), (-1.0, 2.0)])
def test_the_nearest_depth(depth, told):
    assert classify_depth(depth) == told


def test_every_exhibit_has_a_study_and_cases_of_distinct_names():
    assert set(TITLES) == set(EXHIBITS)
    for study in set(EXHIBITS.values()) & set(TINY):
        names = STUDIES[study].cases(TINY[study])
        assert len(names) == {"credibility": 9, "models": 2, "sizes": 21, "depths": 7}.get(
            study, 24
        )
        assert all(re.fullmatch(r"[\w.-]+", name) for name in names)


def test_depths_of_a_larger_study_begin_with_those_of_a_smaller():
    small = STUDIES["depths"].cases(TINY["depths"])
    large = STUDIES["depths"].cases({**TINY["depths"], "places": 3})
    assert {name: large[name] for name in small} == small


def test_unknown_exhibits_are_refused(tmp_path):
    with pytest.raises(ConfigError, match="exhibit=fig6"):
        reproduce("fig6", TINY, tmp_path, workers=1, progress=_silent)
    assert not list(tmp_path.iterdir())


def test_failures_are_told_and_the_rest_is_written(tmp_path):
    # A load that collapses the object.
    hard = {**TINY, "models": {**TINY["models"], "p_max_mpa": 5.0, "names": ["5b"]}}
    with pytest.raises(TactorchError, match="models 5b"):
        reproduce("table1", hard, tmp_path, workers=1, progress=_silent)
    assert not (tmp_path / "table1.md").exists()


def test_an_exhibit_that_is_nothing_without_what_failed_ends_no_other(tmp_path, monkeypatch):
    from tactorch.reproduce import credibility

    first = next(iter(STUDIES["credibility"].cases(TINY["credibility"]).values()))

    def failing(settings, scratch):
        if settings == first:
            raise ConfigError("no such cube")
        return CaseResult({"layers": [3.0, 2.0, 1.0]})

    monkeypatch.setattr(credibility, "run_case", failing)
    with pytest.raises(TactorchError, match=r"1 cases failed: .*no such cube"):
        reproduce("fig3", TINY, tmp_path, workers=1, progress=_silent)
    assert not (tmp_path / "fig3.md").exists()
    assert len(list((tmp_path / "cases" / "credibility").glob("*.npz"))) == 8


def test_confusion_is_by_the_shapes_of_the_paper(monkeypatch):
    """From scores as `tactorch evaluate-model` writes them, whose classes go by the alphabet."""
    scores = {
        "samples": 24,
        "accuracy": 19 / 24,
        "accuracy_deviation": 0.06,
        "classes": {name: {"recall": 0.75} for name in ("cake", "cone", "torus")},
        "confusion": [[6, 2, 0], [3, 3, 0], [0, 0, 10]],
    }
    drawn = {}
    monkeypatch.setattr(recognition, "matrices_figure", drawn.update)
    (text,) = recognition.fig11({"recognizer": CaseResult(scores)}, {}).paragraphs
    assert "| accuracy of the recognizer | 0.900 | 0.792 |" in text
    ((shares, names),) = drawn.values()
    assert names == ("cake", "torus", "cone")
    np.testing.assert_allclose(shares, [[0.75, 0, 0.25], [0, 1, 0], [0.5, 0, 0.5]])
