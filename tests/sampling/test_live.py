import json
import subprocess
import sys
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tactorch.errors import ConfigError, FileError, RecordingError
from tactorch.inverse import IncrementalInversion, Reconstruction, Settings, invert
from tactorch.metrics import scores
from tactorch.recording import Recording, append_press
from tactorch.sampling import LoopOptions, SuggestOptions, replay
from tactorch.sampling.store import HISTORY, RESULT, STATE


def lines(folder: Path) -> list[dict]:
    return [json.loads(line) for line in (folder / HISTORY).read_text().splitlines()]


def test_a_recording_that_another_process_writes_is_followed_to_its_end(
    path: Path, whole: Recording, tmp_path: Path, view: Any, follow: Callable[..., Any]
) -> None:
    source = tmp_path / "whole.h5"
    whole.save(source)
    writer = (
        "import sys; from tactorch.sampling import replay; "
        "from tactorch.recording import Recording; "
        "replay(Recording.load(sys.argv[1]), sys.argv[2], 0.2)"
    )
    process = subprocess.Popen([sys.executable, "-c", writer, str(source), str(path)])
    ended = follow(path, tmp_path / "run", view, idle_seconds=60.0, max_presses=4)
    assert process.wait() == 0
    assert "4 presses" in ended.reason
    assert not view.notes
    # The map may settle between two presses; updates are those that name presses.
    assert [seen.entry["press"] for seen in view.maps if seen.entry["names"]] == [1, 2, 3, 4]
    assert lines(tmp_path / "run") == ended.history
    saved = Reconstruction.load(tmp_path / "run" / RESULT)
    assert ended.update is not None
    np.testing.assert_array_equal(saved.youngs, ended.update.youngs)
    assert len(saved.displacements) == 4


@pytest.mark.slow
def test_the_last_map_is_close_to_that_of_a_whole_inversion(
    path: Path, whole: Recording, tmp_path: Path, view: Any, follow: Callable[..., Any]
) -> None:
    whole.save(path)
    ended = follow(path, tmp_path / "run", view, idle_seconds=0.01)
    assert ended.update is not None
    assert ended.update.solution.converged
    one, other = (
        scores(whole.mesh, youngs, whole.truth)
        for youngs in (ended.update.youngs, invert(whole).youngs)
    )
    assert one["pearson"] == pytest.approx(other["pearson"], abs=0.05)
    assert "no press came" in ended.reason


def test_a_run_that_is_killed_goes_on_to_the_same_map(
    path: Path,
    whole: Recording,
    tmp_path: Path,
    view: Any,
    monkeypatch: pytest.MonkeyPatch,
    follow: Callable[..., Any],
    new_view: Callable[[], Any],
) -> None:
    whole.save(path)
    alone = follow(path, tmp_path / "alone", new_view())
    run, add, count = tmp_path / "run", IncrementalInversion.add, iter(range(9))

    def dying(self: IncrementalInversion, presses: object) -> object:
        if next(count) == 2:
            raise SystemExit  # in the midst of the third press
        return add(self, presses)

    monkeypatch.setattr(IncrementalInversion, "add", dying)
    with pytest.raises(SystemExit):
        follow(path, run, new_view())
    monkeypatch.undo()
    assert [entry["press"] for entry in lines(run)] == [1, 2]
    (run / HISTORY).write_text("")  # killed between the state and the history
    again = follow(path, run, view)
    assert [entry["press"] for entry in view.history] == [1, 2]
    assert again.update is not None
    assert alone.update is not None
    one, other = (ended.update.youngs for ended in (again, alone))
    np.testing.assert_allclose(one, other, rtol=1e-6)
    assert [entry["press"] for entry in lines(run)] == [e["press"] for e in alone.history]


def test_a_run_that_had_ended_has_nothing_to_do(
    path: Path,
    whole: Recording,
    tmp_path: Path,
    view: Any,
    follow: Callable[..., Any],
    new_view: Callable[[], Any],
) -> None:
    whole.select([0]).save(path)
    follow(path, tmp_path / "run", new_view(), max_iterations=30)
    ended = follow(path, tmp_path / "run", view)
    assert not view.maps
    assert len(ended.history) == 1


def test_a_run_that_was_killed_at_rest_settles_and_suggests_when_it_is_continued(
    path: Path,
    whole: Recording,
    tmp_path: Path,
    view: Any,
    monkeypatch: pytest.MonkeyPatch,
    follow: Callable[..., Any],
    new_view: Callable[[], Any],
) -> None:
    whole.select([0]).save(path)
    run = tmp_path / "run"

    def dying(self: IncrementalInversion, **_: object) -> object:
        (run / RESULT).unlink()  # as if killed before it was written, too
        raise SystemExit

    with monkeypatch.context() as patch:
        patch.setattr(IncrementalInversion, "refine", dying)
        with pytest.raises(SystemExit):
            follow(path, run, new_view())
    assert [entry["settled"] for entry in lines(run)] == [False]
    follow(path, run, view, rule="largest_uncertainty")
    assert [entry["settled"] for entry in lines(run)] == [False, True]
    assert len(view.suggestions) == 1
    assert (run / RESULT).is_file()


def test_a_run_is_not_continued_with_other_presses_or_settings(
    path: Path,
    whole: Recording,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    follow: Callable[..., Any],
    new_view: Callable[[], Any],
) -> None:
    run = tmp_path / "run"
    whole.select([0, 1]).save(path)
    follow(path, run, new_view())
    whole.select([1, 0]).save(path)
    with pytest.raises(RecordingError, match="differs from the press of this run"):
        follow(path, run, new_view())
    whole.select([0]).save(path)
    monkeypatch.setattr("tactorch.sampling.loop._RESUME_TIMEOUT_S", 0.05)
    with pytest.raises(FileError, match=r"lacks 'session\.h5, press 2'"):
        follow(path, run, new_view())
    (run / STATE).write_bytes((run / STATE).read_bytes()[:-40])
    with pytest.raises(FileError, match="cannot be read"):
        follow(path, run, new_view())


def test_a_press_that_nothing_carries_is_passed_over(
    path: Path, whole: Recording, tmp_path: Path, view: Any, follow: Callable[..., Any]
) -> None:
    heavy = replace(whole.presses[1], forces=1e5 * whole.presses[1].forces)
    replace(whole, presses=(whole.presses[0], heavy, whole.presses[2]), check_units=False).save(
        path
    )
    ended = follow(path, tmp_path / "run", view, max_batch=3)
    assert ended.update is not None
    assert len(ended.update.recording.presses) == 2
    assert view.notes[0].startswith("session.h5, press 2 is invalid and skipped")


def test_a_press_that_moved_nothing_is_passed_over(
    path: Path, whole: Recording, tmp_path: Path, view: Any, follow: Callable[..., Any]
) -> None:
    still = replace(whole.presses[1], displacement=np.zeros_like(whole.presses[1].displacement))
    replace(whole, presses=(whole.presses[0], still, whole.presses[2]), check_units=False).save(
        path
    )
    ended = follow(path, tmp_path / "run", view)
    assert ended.update is not None
    assert len(ended.update.recording.presses) == 2
    assert "press 2 is invalid and skipped" in view.notes[0]
    assert "displacements are zero" in view.notes[0]


def test_the_size_of_suggested_places_follows_the_presses(whole: Recording) -> None:
    from tactorch.sampling import Suggester
    from tactorch.sampling.candidates import sensor_radius_mm

    suggester, mesh = Suggester(Settings(), SuggestOptions(candidates=4)), whole.mesh
    sizes = []
    for presses in (whole.presses[:1], [narrow(whole)] * 2):
        radius = sensor_radius_mm(mesh, presses)
        places = suggester._candidates(
            replace(whole, presses=tuple(presses), check_units=False)
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


def test_presses_that_wait_are_taken_together_and_no_suggestion_holds_them_up(
    path: Path, whole: Recording, tmp_path: Path, view: Any, follow: Callable[..., Any]
) -> None:
    whole.save(path)
    follow(path, tmp_path / "run", view, max_batch=3, rule="largest_uncertainty")
    assert [seen.entry["press"] for seen in view.maps][:2] == [3, 4]
    assert 3 not in [seen.entry["press"] for seen in view.suggestions]
    assert view.suggestions[0].entry["press"] == 4


def test_an_update_ends_in_time_and_the_map_settles_while_no_press_waits(
    path: Path, whole: Recording, tmp_path: Path, view: Any, follow: Callable[..., Any]
) -> None:
    whole.save(path)
    run = tmp_path / "run"
    follow(path, run, view, max_iterations=30, update_seconds=1e-6, rule="largest_uncertainty")
    updates = [(e["press"], bool(e["names"]), e["settled"]) for e in lines(run)]
    assert updates == [(n, True, False) for n in (1, 2, 3, 4)] + [(4, False, True)]
    assert [e["iterations"] for e in lines(run)][:4] == [1] * 4
    assert [seen.entry["names"] for seen in view.suggestions] == [[]]


@pytest.mark.parametrize("rule", ["expected_error", "largest_uncertainty"])
def test_the_next_press_is_suggested_on_the_free_surface(
    path: Path, whole: Recording, tmp_path: Path, view: Any, rule: str, follow: Callable[..., Any]
) -> None:
    whole.select([0]).save(path)
    follow(path, tmp_path / "run", view, rule=rule)
    seen = view.suggestions[0]
    place = seen.entry["next"]
    assert place is not None, seen.entry["next_why_not"]
    center, inward = np.array(place["center_mm"]), np.array(place["inward"])
    low, high = whole.mesh.bounds
    assert (np.isclose(center, low) | np.isclose(center, high)).any()
    assert center[2] > low[2] + 1e-6  # held below
    inside = center + 1e-3 * inward
    assert ((inside > low - 1e-9) & (inside < high + 1e-9)).all()
    assert np.abs(inward).max() > 0.85  # neither an edge nor a corner
    assert (seen.entry["deviation"] is not None) == (rule == "expected_error")
    assert lines(tmp_path / "run")[-1]["next"] == place


def test_a_press_that_comes_meanwhile_stops_the_suggestion(
    path: Path,
    whole: Recording,
    tmp_path: Path,
    view: Any,
    monkeypatch: pytest.MonkeyPatch,
    follow: Callable[..., Any],
) -> None:
    from tactorch.sampling.suggest import _WarmStartedPosterior

    whole.select([0]).save(path)
    posterior = _WarmStartedPosterior.__call__

    def pressed_meanwhile(self: _WarmStartedPosterior, point: Any, weight: float) -> Any:
        if len(Recording.load(path).presses) == 1:
            append_press(path, whole.presses[1])
        return posterior(self, point, weight)

    monkeypatch.setattr(_WarmStartedPosterior, "__call__", pressed_meanwhile)
    follow(path, tmp_path / "run", view, rule="expected_error", max_iterations=30)
    assert [seen.entry["press"] for seen in view.suggestions] == [2]


def test_where_no_place_can_be_suggested_it_says_why(
    path: Path, whole: Recording, tmp_path: Path, view: Any
) -> None:
    whole.select([0]).save(path)
    from tactorch.sampling import RecordingSource, SamplingLoop, Suggester

    options = LoopOptions(idle_seconds=0.01, max_iterations=2)
    suggester = Suggester(Settings(), SuggestOptions(radius_mm=0.01))
    SamplingLoop(
        RecordingSource(path),
        Settings(),
        tmp_path / "run",
        view,
        options=options,
        suggester=suggester,
    ).run()
    assert view.suggestions[0].entry["next"] is None
    assert "no surface" in view.suggestions[0].entry["next_why_not"]


def test_control_c_ends_a_run_with_what_it_has(
    path: Path,
    whole: Recording,
    tmp_path: Path,
    view: Any,
    monkeypatch: pytest.MonkeyPatch,
    follow: Callable[..., Any],
) -> None:
    whole.select([0]).save(path)

    def waiting(presses: int, idle_seconds: float) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(view, "waiting", waiting)
    ended = follow(path, tmp_path / "run", view, idle_seconds=None)
    assert ended.interrupted
    assert [entry["settled"] for entry in ended.history] == [False, True]
    with pytest.raises(KeyboardInterrupt):
        follow(tmp_path / "never.h5", tmp_path / "other", view, idle_seconds=None)


def test_a_replay_goes_on_where_it_was_and_can_be_stopped(path: Path, whole: Recording) -> None:
    stop = threading.Event()
    assert replay(whole, path, 60.0, stop, on_press=lambda number: stop.set()) == 1
    assert len(Recording.load(path).presses) == 1
    append_press(path, whole.presses[1])
    assert replay(whole, path, 0.0) == 4
    assert [press.name for press in Recording.load(path).presses] == [
        press.name for press in whole.presses
    ]
    with pytest.raises(ConfigError, match="pause_seconds"):
        replay(whole, path, -1.0)
    with pytest.raises(RecordingError, match=r"session\.h5' holds presses of another recording"):
        replay(whole.select([1, 0, 2, 3]), path, 0.0)
    with pytest.raises(RecordingError, match="another recording"):
        replay(whole.select([0, 1]), path, 0.0)


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
