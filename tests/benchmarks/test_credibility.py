"""The credibility benchmark: its profiles, and what it says of them."""

from types import ModuleType

import numpy as np
import pytest

from tactorch.mesh import box_mesh

NAME = "credibility"


@pytest.mark.slow
def test_profiles_run_from_the_top_and_keep_the_sum(benchmark: ModuleType):
    mesh = box_mesh(1.0, 3, tets_per_cell=5)
    values = benchmark.compute_metric(mesh, 5.0, 0.1)
    found = benchmark.layer_sums(mesh, values, 3)
    assert found.sum() == pytest.approx(values.sum())
    assert found[0] > found[1] > found[2]
    harder = benchmark.layer_sums(mesh, benchmark.compute_metric(mesh, 5.0, 0.14), 3)
    stiffer = benchmark.layer_sums(mesh, benchmark.compute_metric(mesh, 10.0, 0.1), 3)
    assert np.all(harder > found)
    assert np.all(found > stiffer)
    assert benchmark.across(mesh, {(7.5, 0.1): values})["top_sides_over_middle"] > 0


def test_trends_are_told_as_they_are(benchmark: ModuleType):
    fall = np.array([8.0, 4.0, 2.0])
    profiles = {(e, p): fall * p / e for e in benchmark.YOUNGS_MPA for p in benchmark.PRESSURES_MPA}
    found = benchmark.trends(profiles)
    assert all(found["falls_with_depth"].values())
    assert set(found["top_over_bottom"].values()) == {4.0}
    assert found["rises_with_pressure"]
    assert found["rises_with_softness"]
    assert found["ratio_by_pressure"][0]["least"] == pytest.approx(0.1 / 0.06)
    assert found["relative_ratio_by_softness"][0]["most"] == pytest.approx(1.0)
    profiles[5.0, 0.14] = fall[::-1]
    found = benchmark.trends(profiles)
    assert not found["falls_with_depth"]["5 MPa, 0.14 MPa"]
    assert found["falls_with_depth"]["5 MPa, 0.1 MPa"]


def test_reach_is_where_a_profile_falls_below_a_level(benchmark: ModuleType):
    profile = np.array([4.0, 2.0, 1.0, 0.5])
    assert benchmark.reach(profile, 3.0) == pytest.approx(0.25)
    assert benchmark.reach(profile, 0.1) == 1.0
    assert benchmark.reach(profile, 9.0) == 0.0
