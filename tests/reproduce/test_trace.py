"""Inversions that are scored on their way, and go on where they were killed."""

import dataclasses

import numpy as np
import pytest

from tactorch.inverse import TNC, Settings
from tactorch.reproduce import models
from tactorch.reproduce.models import TracedRun, TracePoint, run_with_trace
from tactorch.reproduce.paper import press_object

OBJECT = {"phantom": "cube_sphere", "relative_edge_length": 0.3, "p_max_mpa": 0.02, "steps": 1}


def settings(count):
    return Settings(
        optimizer=TNC(max_evaluations=count),
        parameterization="scaled",
        regularization="none",
        model_error="none",
    )


@pytest.fixture(scope="module")
def recording():
    return press_object(OBJECT)


def test_each_iteration_is_scored_without_showing_the_truth(recording, tmp_path):
    run = run_with_trace(recording, settings(12), tmp_path)
    assert [m.evaluations for m in run.trace] == sorted(m.evaluations for m in run.trace)
    assert all(m.ssim <= 1.0 for m in run.trace)
    assert run.seconds > 0
    other = dataclasses.replace(recording, truth=np.full_like(recording.truth, 0.7))
    blind = run_with_trace(other, settings(12), tmp_path / "other")
    assert np.allclose(blind.result.youngs, run.result.youngs)


def test_a_run_that_was_stopped_goes_on(recording, tmp_path):
    first = run_with_trace(recording, settings(6), tmp_path)
    again = run_with_trace(recording, settings(20), tmp_path)
    assert again.trace[: len(first.trace)] == first.trace
    assert again.trace[-1].evaluations > first.trace[-1].evaluations
    assert again.seconds > first.seconds


def test_levels_and_counts_are_found_on_the_way(recording, tmp_path):
    run = run_with_trace(recording, settings(4), tmp_path)
    way = [TracePoint(1, 0.1, 0.2), TracePoint(50, 1.0, 0.6), TracePoint(120, 2.0, 0.5)]
    limited = TracedRun(run.result, way)
    assert limited.ssim_after(100) == 0.6
    assert limited.ssim_after(500) is None  # it was stopped before
    assert limited.first_at(0.55) == way[1]
    assert limited.first_at(0.9) is None
    ended = TracedRun(dataclasses.replace(run.result, stop_reason="a local minimum"), way)
    assert ended.ssim_after(500) == 0.5


@pytest.mark.slow
def test_truncated_newton_goes_on_until_it_has_had_time_enough(recording, tmp_path):
    ours = run_with_trace(recording, Settings(model_error="none"), tmp_path / "ours")
    best = max(point.ssim for point in ours.trace)
    given = {"tnc_evaluations": 4, "tnc_patience": 0}

    def after(target, patience, name):
        allowed = {**given, "tnc_patience": patience}
        return models._truncated_newton(recording, allowed, target, ours, tmp_path / name)

    short = after(best, 0, "tnc")
    assert short.trace[-1].evaluations <= 4
    longer = after(
        best, 8 * short.seconds / ours.first_at(best).seconds, "tnc"
    )  # goes on from there
    assert longer.trace[: len(short.trace)] == short.trace
    assert longer.trace[-1].evaluations > 4
    assert after(2.0, 1e6, "never").trace[-1].evaluations <= 4  # where ours is never either
