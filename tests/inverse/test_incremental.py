from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tactorch.errors import ConfigError, ConvergenceError, RecordingError
from tactorch.inverse import (
    LBFGS,
    GaussNewton,
    IncrementalInversion,
    InverseProblem,
    NewtonCG,
    NuisancePrior,
    Reconstruction,
    Settings,
    StopReason,
    invert_map,
)
from tactorch.inverse.fit.optimizers.schedule import warm_start_state
from tactorch.mesh import box_mesh
from tactorch.metrics import scores
from tactorch.phantoms import make_phantom
from tactorch.recording import Recording
from tactorch.simulation import PressPlan, simulate


@pytest.fixture(scope="module")
def noisy() -> Recording:
    """Six presses on a cube of 320 tetrahedra, from a finer mesh, with noise."""
    ball = make_phantom("cube_sphere", radius=0.3)
    return simulate(
        ball,
        PressPlan(("z+", "x+", "y-"), (0.01, 0.02)),
        mesh=box_mesh(10.0, 4, tets_per_cell=5),
        fine_mesh=box_mesh(10.0, 5, tets_per_cell=5),
        snr_db=40,
        samples=4,
    )


@pytest.fixture(scope="module")
def whole(noisy: Recording) -> Reconstruction:
    return invert_map(noisy)


@pytest.fixture(scope="module")
def grown(noisy: Recording) -> tuple[IncrementalInversion, list[Any]]:
    growing = IncrementalInversion(noisy, max_iterations=6)
    return growing, [growing.add([press]) for press in noisy.presses]


@pytest.mark.slow
def test_after_the_last_press_the_map_is_as_good_as_that_of_a_whole_inversion(
    noisy: Recording, grown: tuple[IncrementalInversion, list[Any]], whole: Reconstruction
) -> None:
    growing, updates = grown
    got, wanted = (
        scores(noisy.mesh, youngs, noisy.truth)
        for youngs in (updates[-1].result.youngs, whole.youngs)
    )
    assert got["pearson"] > wanted["pearson"] - 0.05
    assert got["ssim"] > wanted["ssim"] - 0.1
    assert updates[-1].result.history[-1]["chi2"] < 1.02
    assert np.abs(np.log(updates[-1].result.youngs / whole.youngs)).mean() < 0.15
    # Of two weights that fit the data to their noise the whole one's search ends nearby.
    assert 0.3 < updates[-1].weight / whole.history[-1]["weight"] < 3.0
    assert growing.recording.presses == noisy.presses


@pytest.mark.parametrize(
    "model_error", ["none", pytest.param("discretisation", marks=pytest.mark.slow)]
)
def test_restarted_updates_are_whole_inversions_from_the_map_before(
    noisy: Recording, model_error: str
) -> None:
    settings = Settings(model_error=model_error, optimizer=LBFGS(max_iterations=3))
    growing = IncrementalInversion(noisy, settings, max_iterations=1, restart=True)
    start: Any = 0.2
    for before, count in ((0, 1), (1, 3)):
        update = growing.add(noisy.presses[before:count])
        whole = invert_map(noisy.select(list(range(count))), settings, start_mpa=start)
        np.testing.assert_allclose(update.result.youngs, whole.youngs, rtol=1e-6)
        assert update.result.iterations == whole.iterations
        assert update.converged
        start = whole.youngs


def test_an_update_takes_no_more_iterations_than_it_may(
    grown: tuple[IncrementalInversion, list[Any]], whole: Reconstruction
) -> None:
    assert max(found.result.iterations for found in grown[1]) <= 6
    assert whole.iterations > 6


def test_the_error_of_the_mesh_is_estimated_once_a_press(
    noisy: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    counts: list[int] = []
    original = InverseProblem.evaluate

    def evaluate(self: InverseProblem, *arguments: Any, **others: Any) -> Any:
        if self.body.discretisation.element.quadratic:
            counts.append(len(self.recording.presses))
        return original(self, *arguments, **others)

    monkeypatch.setattr(InverseProblem, "evaluate", evaluate)
    growing = IncrementalInversion(noisy, max_iterations=1)
    for press in noisy.presses[:3]:
        growing.add([press])
    assert counts == [1, 1, 1]


def test_a_restored_one_goes_on_as_if_nothing_had_been(noisy: Recording) -> None:
    one = IncrementalInversion(noisy, max_iterations=3)
    one.add(noisy.presses[:2])
    two = IncrementalInversion(noisy, max_iterations=3)
    point = two.restore(noisy.presses[:2], one.state())
    np.testing.assert_allclose(point.youngs, one.state()["youngs"], rtol=1e-12)
    a, b = (growing.add(noisy.presses[2:4]) for growing in (one, two))
    np.testing.assert_allclose(a.result.youngs, b.result.youngs, rtol=1e-9)
    assert a.weight == b.weight


def test_what_fails_changes_nothing(
    noisy: Recording, fail_evaluation: Callable[[int, BaseException], None]
) -> None:
    growing = IncrementalInversion(noisy, max_iterations=2)
    growing.add(noisy.presses[:1])
    before = growing.state()
    with pytest.raises(RecordingError, match="nodes"):
        growing.add([replace_nodes(noisy.presses[1])])
    heavy = replace(noisy.presses[1], forces=1e4 * noisy.presses[1].forces)
    with pytest.raises(ConvergenceError):
        growing.add([heavy])
    fail_evaluation(8, KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        growing.add([noisy.presses[1]])
    assert len(growing.recording.presses) == 1
    for name, values in growing.state().items():
        np.testing.assert_array_equal(values, before[name])


def replace_nodes(press: Any) -> Any:
    """The press over one node less."""
    names = ("forces", "observed", "displacement", "springs", "fixed", "prescribed")
    return replace(press, **{name: getattr(press, name)[1:] for name in names})


def test_settling_ends_where_the_optimizer_does(noisy: Recording) -> None:
    growing = IncrementalInversion(noisy, max_iterations=1)
    assert not growing.add(noisy.presses[:2]).converged
    assert growing.refine().converged


def test_a_weight_without_end_is_not_carried_on() -> None:
    state = {"weight": 1e18, "first_weight": 2.0, "ended": 1.0}
    assert warm_start_state(state, 1.5) == {"weight": 300.0, "first_weight": 3.0, "ended": 1.0}
    assert warm_start_state({**state, "weight": 4.0}, 1.5)["weight"] == 4.0
    assert warm_start_state({}, 2.0) == {}
    assert warm_start_state({**state, "ended": 2.0}, 2.0) == {}  # the prior was exhausted


@pytest.mark.slow
def test_newton_cg_and_data_of_the_same_model_go_too(recording: Recording) -> None:
    growing = IncrementalInversion(recording, Settings(optimizer=NewtonCG(), model_error="none"))
    for press in recording.presses:
        found = growing.add([press])
    assert found.result.history[-1]["chi2"] < found.result.history[0]["chi2"] * 1.01
    again = IncrementalInversion(recording, Settings(optimizer=NewtonCG(), model_error="none"))
    point = again.restore(recording.presses, growing.state())
    np.testing.assert_allclose(point.youngs, found.result.youngs, rtol=1e-12)


@pytest.mark.parametrize(
    ("settings", "most", "words"),
    [
        (Settings(nuisance=NuisancePrior(poisson=0.02)), 3, "nuisance"),
        (Settings(optimizer="tnc"), 3, "optimizer=tnc"),
        (Settings(optimizer=GaussNewton()), 0, "max_iterations=0"),
    ],
)
def test_settings_that_it_cannot_use_are_refused(
    recording: Recording, settings: Settings, most: int, words: str
) -> None:
    with pytest.raises(ConfigError, match=words):
        IncrementalInversion(recording, settings, max_iterations=most)


def test_a_state_of_other_presses_is_refused(noisy: Recording) -> None:
    growing = IncrementalInversion(noisy, max_iterations=1)
    growing.add(noisy.presses[:2])
    with pytest.raises(ConfigError, match="start again"):
        IncrementalInversion(noisy).restore(noisy.presses[:1], growing.state())


def test_a_state_without_model_errors_is_refused_where_they_are_corrected(
    noisy: Recording,
) -> None:
    growing = IncrementalInversion(noisy, Settings(model_error="none"), max_iterations=1)
    growing.add(noisy.presses[:2])
    corrected = IncrementalInversion(noisy)
    with pytest.raises(ConfigError, match=r"model errors of \[0, 0\] data.*start again"):
        corrected.restore(noisy.presses[:2], growing.state())
    assert not corrected._state.presses


def test_settling_can_be_broken_off_and_goes_on(noisy: Recording) -> None:
    growing = IncrementalInversion(noisy, max_iterations=1)
    growing.add(noisy.presses[:2])
    broken = growing.refine(stop=lambda: True)
    assert (broken.result.iterations, broken.converged) == (1, False)
    assert broken.result.stop_reason is StopReason.STOPPED
    assert growing.refine().converged


def test_an_update_in_no_time_makes_one_iteration(noisy: Recording) -> None:
    growing = IncrementalInversion(noisy, max_iterations=5, max_seconds_per_update=1e-9)
    found = growing.add(noisy.presses[:1])
    assert (found.result.iterations, found.converged) == (1, False)
    patient = IncrementalInversion(noisy, max_iterations=5, max_seconds_per_update=1e9)
    assert patient.add(noisy.presses[:1]).result.iterations == 5


def test_without_a_stated_noise_later_presses_are_fitted_as_well_as_the_first(
    caplog: pytest.LogCaptureFixture,
) -> None:
    mesh = box_mesh(10.0, 4, tets_per_cell=5)
    plan = PressPlan(("z+", "x+"), (0.01,))
    exact = simulate(make_phantom("cube_sphere", radius=0.3), plan, mesh=mesh)
    growing = IncrementalInversion(exact, max_iterations=40)
    first = growing.add(exact.presses[:1]).result
    assert first.history[-1]["chi2"] < 1.02
    growing.add(exact.presses[1:])
    last = growing.refine().result
    assert last.stop_reason == "the data are fitted to their noise"
    assert last.history[-1]["chi2"] < 1.02
    assert caplog.text.count("does not state its noise") == 1


def test_a_weight_that_another_rule_had_chosen_is_chosen_anew() -> None:
    chosen = {"weight": 4.0, "first_weight": 2.0, "ended": 3.0}
    assert warm_start_state(chosen, 1.5) == {"weight": 4.0, "first_weight": 3.0, "ended": 0.0}


def test_a_press_that_moved_nothing_is_refused_by_name(noisy: Recording) -> None:
    growing = IncrementalInversion(noisy, max_iterations=1)
    growing.add(noisy.presses[:1])
    still = replace(noisy.presses[1], displacement=np.zeros_like(noisy.presses[1].displacement))
    with pytest.raises(RecordingError, match=r"press 2.*displacements are zero"):
        growing.add([still])
    assert len(growing.recording.presses) == 1
