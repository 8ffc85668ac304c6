"""The benchmark of active sampling: its object, and how it counts presses."""

from types import ModuleType

import numpy as np
import pytest

NAME = "active_sampling"


def made(benchmark: ModuleType, *errors: list[float]) -> list:
    return [
        benchmark.Run(list(range(len(e))), np.array(e), np.zeros(len(e)), np.ones(len(e)), 1.0)
        for e in errors
    ]


def test_hemispheres_are_alike_however_fine(benchmark: ModuleType):
    exact = 2.0 / 3.0 * np.pi * benchmark.RADIUS_MM**3
    for cells in ((4, 2), (7, 4)):
        mesh = benchmark.hemisphere(*cells)
        assert mesh.volumes.min() > 0
        assert mesh.volumes.sum() == pytest.approx(exact)
        top = np.linalg.norm(mesh.points[mesh.surface.nodes()], axis=1).max()
        assert top == pytest.approx(benchmark.RADIUS_MM, rel=0.05)
        flat = mesh.points[benchmark.held(mesh)]
        assert np.ptp(flat[:, 2]) < 1e-9
        assert len(flat) == (cells[0] + 1) ** 2


def test_balls_lie_within_and_apart(benchmark: ModuleType):
    for seed in range(20):
        one, other = benchmark.Hemisphere.draw(seed).balls
        gap = np.linalg.norm(np.subtract(one.center_mm, other.center_mm))
        assert gap > 2.0
        for ball in (one, other):
            assert np.linalg.norm(ball.center_mm) + ball.radius_mm < benchmark.RADIUS_MM
            assert ball.center_mm[2] > 0.0
    body = benchmark.Hemisphere.draw(0)
    centers = np.array([ball.center_mm for ball in body.balls])
    np.testing.assert_allclose(np.exp(body.log_youngs(centers)), 0.5)
    np.testing.assert_allclose(np.exp(body.log_youngs(-centers)), 0.1)


def test_presses_are_counted_by_the_lowest_error_so_far(benchmark: ModuleType):
    errors = np.array([0.5, 0.3, 0.4, 0.2])
    assert benchmark.presses_needed(errors, 0.3) == 2
    assert benchmark.presses_needed(errors, 0.25) == 4
    assert benchmark.presses_needed(errors, 0.1) == 5


def test_ratios_are_to_what_the_grid_needs_itself(benchmark: ModuleType):
    runs = {
        "grid of 4": made(benchmark, [5, 4, 3, 2], [5, 4, 2, 2]),
        "grid of 2": made(benchmark, [5, 4.0], [6, 3.0]),
        "error": made(benchmark, [5, 2, 2, 2], [5, 4, 3, 3]),
    }
    found = benchmark.judge(runs, [2, 4])
    four = found["grids"]["4"]
    assert (four["target_error"], four["presses"]) == (2.0, 4)
    ours = four["rules"]["error"]
    assert ours["presses_by_seed"] == [2, 5]  # the second never gets there
    assert ours["ratio_by_seed"] == pytest.approx(3.5 / 3.5)
    assert ours["presses"] == 5
    assert ours["ratio"] == pytest.approx(5 / 4)
    two = found["grids"]["2"]
    assert (two["target_error"], two["presses"]) == (3.5, 2)
    assert two["rules"]["error"]["presses"] == 2
    assert "> 4" in benchmark.table(found)[-1]


def test_score_is_by_volume(benchmark: ModuleType):
    truth, shares = np.array([0.0, 1.0]), np.array([0.75, 0.25])
    error, r = benchmark.score(np.array([0.0, 3.0]), truth, shares)
    assert error == pytest.approx(1.0)
    assert r == pytest.approx(1.0)
    assert benchmark.score(np.zeros(2), truth, shares)[1] == 0.0


@pytest.mark.slow
def test_runs_from_end_to_end(benchmark: ModuleType, tmp_path, capsys):
    small = "--seeds 1 --grids 2 --candidates 6 --cells 4 2 --finer 6 3 --rules error"
    benchmark.main([*small.split(), "--worlds", "other mesh", "--out", str(tmp_path)])
    assert '"error"' in capsys.readouterr().out.splitlines()[-1]
    assert (tmp_path / "active_sampling_other_mesh.png").stat().st_size > 1000
