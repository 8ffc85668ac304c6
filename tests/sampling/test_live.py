import subprocess
import sys
import threading
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tactorch.errors import ConfigError, ConvergenceError, FileError, RecordingError
from tactorch.inverse import IncrementalInversion, Reconstruction, Settings, invert_map
from tactorch.metrics import scores
from tactorch.recording import MaterialSpec, Recording, append_press
from tactorch.sampling import LoopOptions, SuggestOptions
from tactorch.sampling.loop import HISTORY, RESULT, STATE
from tactorch.sampling.sources import replay


@pytest.mark.slow
def test_a_recording_that_another_process_writes_is_followed_to_its_end(live: Any) -> None:
    source = live.path.parent / "whole.h5"
    live.whole.save(source)
    writer = (
        "import sys; from tactorch.sampling.sources import replay; "
        "from tactorch.recording import Recording; "
        "replay(Recording.load(sys.argv[1]), sys.argv[2], 0.2)"
    )
    process = subprocess.Popen([sys.executable, "-c", writer, str(source), str(live.path)])
    ended = live.follow(idle_seconds=60.0, max_presses=4)
    assert process.wait() == 0
    assert "4 presses" in ended.reason
    assert not live.view.notes
    # The map may settle between two presses; updates are those that name presses.
    assert [seen.entry["press"] for seen in live.view.maps if seen.entry["names"]] == [1, 2, 3, 4]
    assert live.lines() == ended.history
    saved = Reconstruction.load(live.run / RESULT)
    assert ended.update is not None
    np.testing.assert_array_equal(saved.youngs, ended.update.youngs)
    assert len(saved.displacements) == 4


@pytest.mark.slow
def test_the_last_map_is_close_to_that_of_a_whole_inversion(live: Any) -> None:
    live.save(0, 1, 2, 3)
    ended = live.follow(idle_seconds=0.01)
    assert ended.update is not None
    assert ended.update.solution.converged
    one, other = (
        scores(live.whole.mesh, youngs, live.whole.truth)
        for youngs in (ended.update.youngs, invert_map(live.whole).youngs)
    )
    assert one["pearson"] == pytest.approx(other["pearson"], abs=0.05)
    assert "no press came" in ended.reason


@pytest.mark.slow
def test_a_run_that_is_killed_goes_on_to_the_same_map(
    live: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    live.save(0, 1, 2, 3)
    alone = live.follow(live.new_view(), folder=live.run.with_name("alone"))
    add, count = IncrementalInversion.add, iter(range(9))

    def dying(self: IncrementalInversion, presses: object) -> object:
        if next(count) == 2:
            raise SystemExit  # in the midst of the third press
        return add(self, presses)

    monkeypatch.setattr(IncrementalInversion, "add", dying)
    with pytest.raises(SystemExit):
        live.follow(live.new_view())
    monkeypatch.undo()
    assert [entry["press"] for entry in live.lines()] == [1, 2]
    (live.run / HISTORY).write_text("")  # killed between the state and the history
    again = live.follow()
    assert [entry["press"] for entry in live.view.history] == [1, 2]
    assert again.update is not None
    assert alone.update is not None
    one, other = (ended.update.youngs for ended in (again, alone))
    np.testing.assert_allclose(one, other, rtol=1e-6)
    assert [entry["press"] for entry in live.lines()] == [e["press"] for e in alone.history]


def test_a_run_that_had_ended_has_nothing_to_do(live: Any) -> None:
    live.save(0)
    live.follow(live.new_view(), max_iterations=30)
    ended = live.follow()
    assert not live.view.maps
    assert len(ended.history) == 1


def test_a_run_that_was_killed_at_rest_settles_and_suggests_when_it_is_continued(
    live: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    live.save(0)

    def dying(self: IncrementalInversion, **_: object) -> object:
        (live.run / RESULT).unlink()  # as if killed before it was written, too
        raise SystemExit

    with monkeypatch.context() as patch:
        patch.setattr(IncrementalInversion, "refine", dying)
        with pytest.raises(SystemExit):
            live.follow(live.new_view())
    assert [entry["settled"] for entry in live.lines()] == [False]
    live.follow(rule="largest_uncertainty")
    assert [entry["settled"] for entry in live.lines()] == [False, True]
    assert len(live.view.suggestions) == 1
    assert (live.run / RESULT).is_file()


def test_a_run_is_not_continued_with_other_presses_or_settings(
    live: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    live.save(0, 1)
    live.follow(live.new_view())
    live.save(1, 0)
    with pytest.raises(RecordingError, match="differs from the press of this run"):
        live.follow(live.new_view())
    live.save(0)
    monkeypatch.setattr("tactorch.sampling.loop._RESUME_TIMEOUT_S", 0.05)
    with pytest.raises(FileError, match=r"lacks 'session\.h5, press 2'"):
        live.follow(live.new_view())
    (live.run / STATE).write_bytes((live.run / STATE).read_bytes()[:-40])
    with pytest.raises(FileError, match="cannot be read"):
        live.follow(live.new_view())


@pytest.mark.parametrize(
    "settings",
    [Settings(misfit="adaptive"), Settings(parameterization="identity")],
    ids=["misfit", "parameterization"],
)
def test_a_run_is_not_continued_with_another_method(live: Any, settings: Settings) -> None:
    live.save(0)
    live.follow(live.new_view(), max_iterations=1)
    with pytest.raises(FileError, match="other settings"):
        live.follow(settings=settings)
    live.follow(settings=Settings(max_seconds=1e6))


@pytest.mark.parametrize(
    "changes",
    [
        {"material": MaterialSpec("neo_hookean", 0.2)},
        {"material": MaterialSpec("linear", 0.45)},
        {"density": 1e-9, "gravity": np.array([0.0, 0.0, -9806.65])},
    ],
    ids=["poisson", "law", "weight"],
)
def test_a_run_is_not_continued_with_another_object(live: Any, changes: dict) -> None:
    live.save(0)
    live.follow(live.new_view(), max_iterations=1)
    live.whole = replace(live.whole, **changes)
    live.save(0)
    with pytest.raises(RecordingError, match=r"another object.*choose another run_dir"):
        live.follow()


def test_a_press_that_nothing_carries_is_passed_over(live: Any) -> None:
    heavy = replace(live.whole.presses[1], forces=1e5 * live.whole.presses[1].forces)
    live.save(0, heavy, 2)
    ended = live.follow(max_batch=3)
    assert ended.update is not None
    assert len(ended.update.recording.presses) == 2
    assert live.view.notes[0].startswith("session.h5, press 2 is invalid and skipped")


def test_a_press_that_moved_nothing_is_passed_over(live: Any) -> None:
    press = live.whole.presses[1]
    live.save(0, replace(press, displacement=np.zeros_like(press.displacement)), 2)
    ended = live.follow()
    assert ended.update is not None
    assert len(ended.update.recording.presses) == 2
    assert "press 2 is invalid and skipped" in live.view.notes[0]
    assert "displacements are zero" in live.view.notes[0]


def test_the_size_of_suggested_places_follows_the_presses(live: Any) -> None:
    from tactorch.sampling import Suggester
    from tactorch.sampling.candidates import sensor_radius_mm

    suggester, mesh = Suggester(Settings(), SuggestOptions(candidates=4)), live.whole.mesh
    sizes = []
    for presses in (live.whole.presses[:1], [narrow(live.whole)] * 2):
        radius = sensor_radius_mm(mesh, presses)
        places = suggester._candidates(
            replace(live.whole, presses=tuple(presses), check_units=False)
        ).patches
        assert {place.radius_mm for place in places} == {radius}
        sizes.append(radius)
    assert sizes[1] < sizes[0]


def narrow(whole: Recording) -> Any:
    """The first press, loaded at one node alone."""
    press = whole.presses[0]
    forces = np.zeros_like(press.forces)
    node = int(np.abs(press.forces[:, 2]).argmax())
    forces[node] = press.forces[node]
    return replace(press, forces=forces)


def test_presses_that_wait_are_taken_together_and_no_suggestion_holds_them_up(live: Any) -> None:
    live.save(0, 1, 2, 3)
    live.follow(max_batch=3, rule="largest_uncertainty")
    assert [seen.entry["press"] for seen in live.view.maps][:2] == [3, 4]
    assert 3 not in [seen.entry["press"] for seen in live.view.suggestions]
    assert live.view.suggestions[0].entry["press"] == 4


def test_an_update_ends_in_time_and_the_map_settles_while_no_press_waits(live: Any) -> None:
    live.save(0, 1, 2, 3)
    live.follow(max_iterations=30, update_seconds=1e-6, rule="largest_uncertainty")
    updates = [(e["press"], bool(e["names"]), e["settled"]) for e in live.lines()]
    assert updates == [(n, True, False) for n in (1, 2, 3, 4)] + [(4, False, True)]
    assert [e["iterations"] for e in live.lines()][:4] == [1] * 4
    assert [seen.entry["names"] for seen in live.view.suggestions] == [[]]


@pytest.mark.parametrize("rule", ["expected_error", "largest_uncertainty"])
def test_the_next_press_is_suggested_on_the_free_surface(live: Any, rule: str) -> None:
    live.save(0)
    live.follow(rule=rule)
    seen = live.view.suggestions[0]
    place = seen.entry["next"]
    assert place is not None, seen.entry["next_why_not"]
    center, inward = np.array(place["center_mm"]), np.array(place["inward"])
    low, high = live.whole.mesh.bounds
    assert (np.isclose(center, low) | np.isclose(center, high)).any()
    assert center[2] > low[2] + 1e-6  # held below
    inside = center + 1e-3 * inward
    assert ((inside > low - 1e-9) & (inside < high + 1e-9)).all()
    assert np.abs(inward).max() > 0.85  # neither an edge nor a corner
    assert (seen.entry["deviation"] is not None) == (rule == "expected_error")
    assert live.lines()[-1]["next"] == place


def test_a_press_that_comes_meanwhile_stops_the_suggestion(
    live: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    from tactorch.sampling.suggest import _WarmStartedPosterior

    live.save(0)
    posterior = _WarmStartedPosterior.__call__

    def pressed_meanwhile(self: _WarmStartedPosterior, point: Any, weight: float) -> Any:
        if len(Recording.load(live.path).presses) == 1:
            append_press(live.path, live.whole.presses[1])
        return posterior(self, point, weight)

    monkeypatch.setattr(_WarmStartedPosterior, "__call__", pressed_meanwhile)
    live.follow(rule="expected_error", max_iterations=30)
    assert [seen.entry["press"] for seen in live.view.suggestions] == [2]


def test_where_no_place_can_be_suggested_it_says_why(live: Any) -> None:
    live.save(0)
    live.follow(suggest=SuggestOptions(radius_mm=0.01), max_iterations=2)
    assert live.view.suggestions[0].entry["next"] is None
    assert "no surface" in live.view.suggestions[0].entry["next_why_not"]


def test_where_derivatives_fail_it_says_why_and_goes_on(
    live: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    from tactorch.sampling.suggest import _WarmStartedPosterior

    def fail(self: _WarmStartedPosterior, point: Any, weight: float) -> Any:
        raise ConvergenceError("The equilibrium is unstable")

    monkeypatch.setattr(_WarmStartedPosterior, "__call__", fail)
    live.save(0)
    live.follow(rule="expected_error", max_iterations=2)
    assert live.view.suggestions[0].entry["next"] is None
    assert "unstable" in live.view.suggestions[0].entry["next_why_not"]


def test_control_c_ends_a_run_with_what_it_has(live: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    live.save(0)

    def waiting(presses: int, idle_seconds: float) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(live.view, "waiting", waiting)
    ended = live.follow(idle_seconds=None)
    assert ended.reason == "interrupted"
    assert [entry["settled"] for entry in ended.history] == [False, True]
    live.path = live.path.with_name("never.h5")
    with pytest.raises(KeyboardInterrupt):
        live.follow(folder=live.run.with_name("other"), idle_seconds=None)


def test_a_replay_goes_on_where_it_was_and_can_be_stopped(live: Any) -> None:
    stop = threading.Event()
    stop.set()
    assert replay(live.whole, live.path, 60.0, stop) == 1
    assert len(Recording.load(live.path).presses) == 1
    append_press(live.path, live.whole.presses[1])
    assert replay(live.whole, live.path, 0.0) == 4
    assert [press.name for press in Recording.load(live.path).presses] == [
        press.name for press in live.whole.presses
    ]
    with pytest.raises(ConfigError, match="pause_seconds"):
        replay(live.whole, live.path, -1.0)
    with pytest.raises(RecordingError, match=r"session\.h5' holds presses of another recording"):
        replay(live.whole.select([1, 0, 2, 3]), live.path, 0.0)
    with pytest.raises(RecordingError, match="another recording"):
        replay(live.whole.select([0, 1]), live.path, 0.0)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"poll_seconds": 0.0}, "poll_seconds=0.0"),
        ({"max_batch": 0}, "max_batch=0"),
        ({"max_iterations": 0}, "max_iterations=0"),
        ({"max_presses": 0}, "max_presses=0"),
        ({"update_seconds": 0.0}, "update_seconds=0.0"),
        ({"idle_seconds": -1.0}, "idle_seconds=-1.0"),
    ],
)
def test_options_that_cannot_be_used_are_refused(options: dict, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        LoopOptions(**options)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"rule": "guess"}, "guess"),
        ({"radius_mm": 0.0}, "radius_mm=0.0"),
        ({"candidates": 0}, "candidates=0"),
    ],
)
def test_suggestions_that_cannot_be_made_are_refused(options: dict, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        SuggestOptions(**options)
