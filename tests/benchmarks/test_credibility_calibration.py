"""The calibration benchmark: how it draws, and how it counts."""

import importlib
import json
from types import ModuleType

import numpy as np
import pytest

from tactorch.mesh import box_mesh

NAME = "calibration"


@pytest.fixture
def objects(benchmark: ModuleType) -> ModuleType:
    """The script's other half, by the path that the script has set."""
    return importlib.import_module("calibration_objects")


def test_objects_are_drawn_from_the_stated_kind(objects: ModuleType):
    cases = [objects.draw_case(np.random.default_rng([0, i])) for i in range(60)]
    youngs = [case.phantom.youngs_mpa for case in cases]
    assert 0.1 <= min(youngs) < 0.15 < 0.3 < max(youngs) <= 0.4
    assert {len(case.phantom.inclusions) for case in cases} == {0, 1, 2}
    assert {len(case.plan.faces) for case in cases} == {1, 2, 3}
    ratios = [m / c.phantom.youngs_mpa for c in cases for _, m in c.phantom.inclusions]
    assert 1 / 3 <= min(ratios) < 1 < max(ratios) <= 6
    again = objects.draw_case(np.random.default_rng([0, 7]))
    assert again.phantom.to_config() == cases[7].phantom.to_config()


def test_draws_of_the_normal_prior_have_its_precision(objects: ModuleType):
    prior = objects.NormalPrior(box_mesh(10.0, 1, tets_per_cell=5), -1.0)
    rng = np.random.default_rng(0)
    drawn = np.array([prior.draw(rng) for _ in range(3000)])
    expected = np.linalg.inv(prior.precision.toarray())
    np.testing.assert_allclose(np.cov(drawn.T), expected, atol=0.1 * expected.max())
    np.testing.assert_allclose(drawn.mean(axis=0), -1.0, atol=0.15)


def test_summary_counts_by_hand(benchmark: ModuleType, objects: ModuleType):
    def outcome(error: float, inclusions: int) -> object:
        truth = np.array([0.0, error])
        normal = (np.zeros(2), np.ones(2))
        inside = np.array([False, inclusions > 0])
        return objects.Outcome(truth, np.array([3.0, 1.0]), inclusions, inside, {"a": normal}, 1)

    found = benchmark.summary([outcome(0.1, 0), outcome(5.0, 1)], "a")
    assert found["objects"] == 2
    assert found["elements"] == 4
    assert found["coverage_90"] == 0.75
    assert found["coverage_90_volume"] == 0.875
    assert found["coverage_90_by_inclusions"] == {"0": 1.0, "1": 0.5}
    assert found["coverage_90_inside_inclusions"] == 0.0


@pytest.mark.slow
def test_the_normal_case_is_covered_as_stated(benchmark: ModuleType, objects: ModuleType):
    outcomes = [objects.judge_gaussian(2, 5, i) for i in range(8)]
    found = benchmark.summary(outcomes, "laplace")
    assert found["coverage_90"] == pytest.approx(0.9, abs=0.08)
    assert found["mean_deviation"] == pytest.approx(found["mean_rms_error"], rel=0.2)


@pytest.mark.slow
def test_the_last_line_is_the_figures_that_count(
    benchmark: ModuleType, capsys: pytest.CaptureFixture[str]
):
    benchmark.main(["--objects", "1", "--divisions", "2", "--only", "other mesh"])
    report = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert report["objects"] == 1
    assert report["coverage_90"] == report["kinds"]["other mesh"]["variational"]["coverage_90"]
