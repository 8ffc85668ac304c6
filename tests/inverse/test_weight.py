"""The prior's weight: cooled until the data are fitted to their noise, and no further."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tactorch.inverse import (
    GaussNewton,
    NoiseModel,
    Point,
    Settings,
    StopReason,
    invert_map,
    make_objective,
)
from tactorch.inverse.fit.optimizers import schedule as rules
from tactorch.inverse.fit.optimizers.damped import DampedNewton
from tactorch.inverse.fit.optimizers.schedule import RegularizationSchedule
from tactorch.mesh import TetMesh
from tactorch.recording import MaterialSpec, Press, Recording


@pytest.fixture
def point(recording: Recording) -> Point:
    return make_objective(recording, Settings()).at(np.full(recording.mesh.n_tets, np.log(0.2)))


def test_weight_falls_fast_then_slowly_then_ends(point: Point) -> None:
    cooling = RegularizationSchedule.start(point, {})
    first = cooling.weight
    traces = [(point.jacobian**2).sum(), point.penalty_curvature.diagonal().sum()]
    assert first == pytest.approx(30.0 * traces[0] / traces[1])
    cooling.lower(chi2=50.0)
    after_far = cooling.weight
    cooling.lower(chi2=2.0)
    assert first / after_far > after_far / cooling.weight > 1.0
    last = cooling.weight
    assert cooling.ended is None
    cooling.lower(chi2=1.0)
    assert cooling.ended is StopReason.FITTED
    cooling.lower(chi2=5.0)  # the end is final
    assert cooling.weight == last


def test_the_weight_leaps_only_far_from_the_data_and_where_steps_do_as_foretold(
    point: Point,
) -> None:
    def factor(chi2: float, gain: float) -> float:
        cooling = RegularizationSchedule.start(point, {})
        first = cooling.weight
        cooling.lower(chi2, gain)
        return cooling.weight / first

    usual = factor(1e4, 0.0)
    assert factor(1e4, 1.0) < usual
    assert factor(1e4, 0.5) == usual
    assert factor(50.0, 1.0) == usual
    assert factor(5.0, 1.0) > usual


def test_near_the_noise_the_weight_waits_for_a_step_that_was_foretold(point: Point) -> None:
    """Else it falls on while the map has not followed, until noise is all that is fitted."""
    cooling = RegularizationSchedule.start(point, {})
    first = cooling.weight
    for _ in range(2):
        cooling.lower(2.0, gain=-0.2)
        assert (cooling.weight, cooling.held, cooling.ended) == (first, True, None)
    assert RegularizationSchedule.start(point, cooling.state()) == cooling
    cooling.lower(2.0, gain=0.5)
    assert cooling.weight < first
    assert not cooling.held
    second = cooling.weight
    cooling.lower(50.0, gain=-0.2)  # far from the data there is no waiting
    assert cooling.weight < second


def test_a_leap_that_leads_nowhere_is_none(
    recording: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    step, leaps = DampedNewton._step, []

    def lost(self: DampedNewton, *arguments: Any, trials: int | None = None) -> Any:
        leaps.append(trials)
        return None if trials else step(self, *arguments)

    settings = Settings(GaussNewton(max_iterations=8), noise=NoiseModel(relative=1e-4))
    with monkeypatch.context() as patched:
        patched.setattr(DampedNewton, "_step", lost)
        found = invert_map(recording, settings)
    assert leaps.count(1) > 1
    monkeypatch.setattr(rules, "_LEAP", rules._FAST)
    expected = invert_map(recording, settings)
    np.testing.assert_allclose(found.youngs, expected.youngs, rtol=1e-9)
    assert [e["weight"] for e in found.history] == pytest.approx(
        [e["weight"] for e in expected.history]
    )


def test_an_exhausted_prior_says_that_the_noise_is_larger(point: Point) -> None:
    cooling = RegularizationSchedule.start(point, {})
    for _ in range(200):
        cooling.lower(chi2=2.0)
    assert cooling.ended is StopReason.NOT_FITTED
    assert cooling.weight > 0


def test_state_resumes(point: Point) -> None:
    for steps in ([], [50.0], [50.0, 2.0, 0.9]):
        cooling = RegularizationSchedule.start(point, {})
        for chi2 in steps:
            cooling.lower(chi2)
        assert RegularizationSchedule.start(point, cooling.state()) == cooling


def test_a_given_weight_stays(point: Point) -> None:
    given = replace(point, objective=replace(point.objective, weight=0.5))
    cooling = RegularizationSchedule.start(
        given, {"weight": 3.0, "first_weight": 9.0, "ended": 0.0}
    )
    assert (cooling.weight, cooling.fixed, cooling.state()) == (0.5, True, {})


def test_no_prior_has_no_weight(recording: Recording) -> None:
    objective = make_objective(recording, Settings(regularization="none"))
    point = objective.at(np.full(recording.mesh.n_tets, np.log(0.2)))
    for weight in (None, 0.0):
        given = replace(point, objective=replace(objective, weight=weight))
        cooling = RegularizationSchedule.start(given, {})
        assert (cooling.weight, cooling.fixed) == (0.0, True)


def test_a_single_element_has_nothing_to_regularise() -> None:
    mesh = TetMesh(10.0 * np.vstack([np.zeros(3), np.eye(3)]), np.array([[0, 1, 2, 3]]))
    fixed = np.zeros((4, 3), dtype=bool)
    fixed[:3] = True
    force, seen = np.zeros((4, 3)), np.zeros((4, 3), dtype=bool)
    force[3, 2], seen[3] = -0.1, True
    press = Press(force, seen, np.where(seen, -0.1, np.nan), fixed=fixed)
    recording = Recording(mesh, (press,), MaterialSpec("neo_hookean", 0.4))
    point = make_objective(recording, Settings()).at(np.array([np.log(0.2)]))
    assert RegularizationSchedule.start(point, {}) == RegularizationSchedule(0.0, 0.0, fixed=True)


@pytest.fixture
def fitted(recording: Recording, monkeypatch: pytest.MonkeyPatch) -> Callable[[float], Point]:
    """A point of a recording that states its noise, made to fit as well as one likes."""
    presses = tuple(replace(press, noise_mm=0.01) for press in recording.presses)
    objective = make_objective(replace(recording, presses=presses), Settings())
    point = objective.at(np.full(recording.mesh.n_tets, np.log(0.2)))

    def made(chi2: float) -> Point:
        monkeypatch.setattr(type(point.evaluation), "chi2", chi2)
        return point

    return made


def test_an_overfitted_map_raises_the_weight_by_as_much_as_it_says(
    fitted: Callable[[float], Point],
) -> None:
    cooling = RegularizationSchedule(1.0, 30.0, False)
    assert not cooling.retry(fitted(0.01))  # the weight still falls
    cooling.lower(0.5)
    for chi2, weight in ((0.05, 20.0), (0.8, 60.0)):  # 1 / chi2, but no less than threefold
        assert cooling.retry(fitted(chi2))
        assert cooling.weight == pytest.approx(weight)
    assert cooling.retry(fitted(3.0))  # too much: between the last two
    assert 20.0 < cooling.weight < 60.0
    assert not cooling.retry(fitted(0.97))


def test_where_noise_may_be_less_a_weight_is_lowered_again_but_not_raised(
    fitted: Callable[[float], Point], recording: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    """More presses may misfit at a weight at which the first ones had been fitted."""
    cooling = RegularizationSchedule(1.0, 30.0, False)
    cooling.lower(0.5)
    monkeypatch.setattr(NoiseModel, "floored", lambda *_: True)
    assert not cooling.retry(fitted(0.01))
    assert not cooling.retry(fitted(20.0), converged=False)
    assert cooling.weight == 1.0
    assert cooling.retry(fitted(20.0))
    assert cooling.weight == pytest.approx(1.0 / 3.0)


def test_a_misfit_of_the_noise_alone_is_no_overfit(fitted: Callable[[float], Point]) -> None:
    """Half of the variance is for a model's error that may not be there."""
    cooling = RegularizationSchedule(1.0, 30.0, False)
    cooling.lower(0.5)
    point = fitted(0.6)
    problem = point.objective.problem
    half = problem.with_data(replace(problem.data, noise_fraction=0.5))
    objective = replace(point.objective, problem=half)
    assert not cooling.retry(replace(point, objective=objective))
    assert cooling.retry(replace(fitted(0.4), objective=objective))
    assert cooling.retry(fitted(0.6))


@pytest.mark.parametrize(
    ("course", "weight"),
    [
        ((1.125, 1.212, 1.24), 1.0 / 3.0),  # it misfits, ever more slowly
        ((0.38, 0.44, 0.47), 3.0),  # it overfits, and will
        ((0.70, 0.79, 0.87), None),  # it overfits yet
        ((1.30, 1.20, 1.12), None),  # it misfits yet
        ((0.80, 0.70, 0.75), None),  # who knows
        ((0.50, 0.55, 0.60), None),  # it does not slow down
        ((1.03, 1.04, 1.045), None),  # it hardly misfits
    ],
)
def test_what_the_course_of_the_misfit_foretells_is_not_waited_for(
    fitted: Callable[[float], Point], course: tuple[float, ...], weight: float | None
) -> None:
    cooling = RegularizationSchedule(1.0, 30.0, False)
    cooling.lower(0.5)
    told = []
    for chi2 in course:
        told.append(cooling.retry(fitted(chi2), converged=False))
        cooling = RegularizationSchedule.start(
            fitted(chi2), cooling.state()
        )  # as a resumed run does
    assert told == [False, False, weight is not None]
    assert cooling.weight == pytest.approx(1.0 if weight is None else weight)


def test_far_overfitted_maps_need_not_converge_but_are_no_bound(
    fitted: Callable[[float], Point],
) -> None:
    cooling = RegularizationSchedule(1.0, 30.0, False)
    cooling.lower(0.5)
    assert not cooling.retry(fitted(0.5), converged=False)
    for weight in (100.0, 1e4, 1e6):
        assert cooling.retry(fitted(0.0), converged=False)
        assert cooling.weight == pytest.approx(weight)
        assert cooling.below == 0.0
    assert not cooling.retry(fitted(0.0), converged=False)  # often enough
    assert cooling.retry(fitted(0.1))
    assert cooling.below == pytest.approx(1e6)
