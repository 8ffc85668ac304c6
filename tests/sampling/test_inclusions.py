"""The finding of a loop: shapes that are fitted while no press waits."""

import json
from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from typing import Any

import numpy as np
import pytest

from tactorch.errors import CancelledError, ConfigError, ConvergenceError
from tactorch.files import read_arrays, write_arrays
from tactorch.inverse import Settings, Status
from tactorch.inverse.errors.base import KeptRims
from tactorch.inverse.fields import BALL, ShapeField, ShapePrior
from tactorch.inverse.posterior.shapes import ShapePosterior
from tactorch.inverse.result.shapes import ShapeReconstruction
from tactorch.inverse.result.text import describe
from tactorch.mesh import box_mesh
from tactorch.phantoms import make_phantom
from tactorch.recording import Recording, append_press
from tactorch.sampling.inclusions import SHAPES
from tactorch.sampling.loop import STATE
from tactorch.simulation import PressPlan, simulate

Stop = Callable[[], bool]


def shapes_of(recording: Recording, radius_mm: float) -> ShapeReconstruction:
    """A ball of 0.8 MPa in 0.2 MPa, below the middle of the side z+."""
    field = ShapeField(ShapePrior.of(recording.mesh, 0.2), (BALL,))
    values = [np.log(0.2), 5.0, 5.0, 6.0, np.log(radius_mm), np.log(4.0)]
    z = field.standard(np.array(values))
    posterior = ShapePosterior(field, z, np.zeros(len(z)), 4e-4 * np.eye(len(z)))
    return ShapeReconstruction(field, z, posterior, 1.0, (50.0,), 50.0)


class Search:
    """A search for shapes in no time; each finds a ball that is a little larger.

    Attributes:
        calls: Number of presses and start of each search.
        before: Called with `stop` before the result of the next searches, one after the other.
        kept: Errors at rims that each search reuses.
    """

    def __init__(self) -> None:
        self.calls: list[tuple[int, ShapeReconstruction | None]] = []
        self.results: list[ShapeReconstruction] = []
        self.before: list[Callable[[Stop], None]] = []
        self.kept: list[KeptRims] = []

    def __call__(
        self,
        recording: Recording,
        settings: Settings,
        *,
        start: ShapeReconstruction | None,
        stop: Stop,
        kept: KeptRims,
    ) -> ShapeReconstruction:
        self.kept.append(kept)
        self.calls.append((len(recording.presses), start))
        if self.before:
            self.before.pop(0)(stop)
        self.results.append(shapes_of(recording, 2.0 + 0.1 * len(self.calls)))
        return self.results[-1]


@pytest.fixture
def search(monkeypatch: pytest.MonkeyPatch) -> Search:
    search = Search()
    monkeypatch.setattr(import_module("tactorch.inverse.invert"), "find_shapes", search)
    return search


def fail(error: BaseException) -> Callable[[Stop], None]:
    def raise_it(stop: Stop) -> None:
        raise error

    return raise_it


def test_shapes_are_fitted_once_to_all_presses_each_time_from_the_last_ones(
    live: Any, search: Search
) -> None:
    live.save(0)
    live.follow(live.new_view(), shapes=True, max_presses=1)
    live.save(0, 1, 2)
    ended = live.follow(shapes=True, max_batch=2, rule="shape_error")
    assert [presses for presses, _ in search.calls] == [1, 3]
    assert live.lines()[-1]["next_rule"] == "shape_error"
    assert search.calls[0][1] is None
    np.testing.assert_array_equal(search.calls[1][1].z, search.results[0].z)
    assert ended.update is not None
    assert ended.update.result.shapes is search.results[1]
    assert ended.update.result_presses == 3
    (seen,) = live.view.findings
    assert describe(seen.result) == describe(ended.update.result)
    entry = live.lines()[-1]
    assert entry == ended.history[-1]
    assert entry["searched"]
    assert entry["finding"] == json.loads(json.dumps(ended.update.result.plain()))
    kept = json.loads((live.run / SHAPES).read_text())
    np.testing.assert_array_equal(ShapeReconstruction.of(kept).z, search.results[1].z)


def test_before_the_search_the_finding_is_that_of_fewer_presses_or_of_the_map(
    live: Any, search: Search
) -> None:
    live.save(0)
    live.follow(live.new_view(), shapes=True, max_presses=1, max_iterations=30)
    live.save(0, 1)
    live.follow(shapes=True, max_iterations=30)
    first, second = (entry for entry in live.lines() if entry["names"])
    assert first["finding_presses"] == 1
    seen = live.view.maps[0]
    assert (seen.result_presses, seen.result.shapes is not None) == (1, True)
    # Then searched: the entry of an update is completed.
    assert (second["finding_presses"], second["searched"]) == (2, True)


def test_a_press_that_comes_stops_the_search_and_goes_first(live: Any, search: Search) -> None:
    live.save(0)

    def press(stop: Stop) -> None:
        assert not stop()
        append_press(live.path, live.whole.presses[1])
        assert stop()
        raise CancelledError

    search.before = [press]
    ended = live.follow(shapes=True, max_iterations=30)
    assert [presses for presses, _ in search.calls] == [1, 2]
    assert search.calls[1][1] is None
    assert [seen.result_presses for seen in live.view.findings] == [2]
    first = live.lines()[0]
    assert (first["press"], first["searched"]) == (1, False)
    of_map = live.view.maps[0]
    assert first["finding"] == of_map.solution.result.plain()
    assert of_map.result is of_map.solution.result
    assert ended.update is not None
    assert ended.update.result.shapes is search.results[0]


def test_a_search_goes_on_from_what_a_stopped_one_reached(live: Any, search: Search) -> None:
    live.save(0)
    reached = shapes_of(live.whole, 1.5)
    search.before = [fail(CancelledError(reached=reached))]
    live.follow(shapes=True)
    assert [start for _, start in search.calls] == [None, reached]


def test_a_search_that_was_stopped_is_made_at_the_end_of_the_run(live: Any, search: Search) -> None:
    live.save(0)
    stops: list[Stop] = []
    search.before = [fail(CancelledError()), stops.append]
    ended = live.follow(shapes=True)
    assert [presses for presses, _ in search.calls] == [1, 1]
    assert ended.update is not None
    assert ended.update.result.shapes is search.results[0]
    append_press(live.path, live.whole.presses[1])
    assert not stops[0]()  # a press that comes after the end is not taken
    assert live.lines()[-1]["searched"]


def test_control_c_ends_the_last_search_and_keeps_everything(live: Any, search: Search) -> None:
    live.save(0)
    search.before = [fail(CancelledError()), fail(KeyboardInterrupt())]
    ended = live.follow(shapes=True)
    assert ended.reason == "interrupted"
    assert ended.update is not None
    assert live.lines() == ended.history
    assert not ended.history[-1]["searched"]
    assert (live.run / "reconstruction.h5").is_file()
    assert not (live.run / SHAPES).exists()


def test_a_run_that_was_killed_in_the_search_makes_it_when_it_is_continued(
    live: Any, search: Search
) -> None:
    live.save(0)
    search.before = [fail(SystemExit())]
    with pytest.raises(SystemExit):
        live.follow(live.new_view(), shapes=True)
    live.follow(live.new_view(), shapes=True)
    assert [presses for presses, _ in search.calls] == [1, 1]
    ended = live.follow(shapes=True)  # nothing is left to do
    assert len(search.calls) == 2
    assert not live.view.maps
    assert ended.history[-1]["searched"]


def test_shapes_that_cannot_be_read_are_fitted_from_the_beginning(
    live: Any, search: Search
) -> None:
    live.save(0)
    live.follow(live.new_view(), shapes=True)
    (live.run / SHAPES).write_text("{}")
    live.save(0, 1)
    live.follow(shapes=True)
    assert search.calls[-1] == (2, None)


def test_a_new_run_has_no_shapes_of_an_earlier_one(live: Any, search: Search) -> None:
    live.save(0)
    live.run.mkdir()
    (live.run / SHAPES).write_text("{}")
    live.follow()
    assert not (live.run / SHAPES).exists()


@pytest.mark.parametrize("error", [ConvergenceError("it collapses"), ConfigError("no bounds")])
def test_where_shapes_cannot_be_fitted_the_map_is_the_finding(
    live: Any, search: Search, error: Exception
) -> None:
    live.save(0)
    search.before = [fail(error)]
    ended = live.follow(shapes=True)
    assert len(search.calls) == 1
    assert ended.update is not None
    result, of_map = ended.update.result, live.view.maps[-1]
    assert result.shapes is None
    assert str(error) in result.warnings[0]
    assert replace(result, warnings=()).plain() == of_map.solution.result.plain()
    assert live.view.findings[0].result is result


def test_a_map_that_cannot_be_trusted_cannot_tell(
    live: Any, search: Search, monkeypatch: pytest.MonkeyPatch
) -> None:
    reasons = ("40% of the map is at a bound.",)
    monkeypatch.setattr("tactorch.inverse.result.build._reasons", lambda result: reasons)
    live.save(0)
    search.before = [fail(ConvergenceError("it collapses"))]
    ended = live.follow(shapes=True)
    assert ended.update is not None
    assert ended.update.result.status is Status.UNKNOWN
    assert ended.update.result.reasons == reasons
    assert {entry["finding"]["status"] for entry in live.lines()} == {"cannot tell"}


def test_a_map_that_cannot_be_trusted_replaces_the_shapes_of_fewer_presses(
    live: Any, search: Search, monkeypatch: pytest.MonkeyPatch
) -> None:
    live.save(0)
    live.follow(live.new_view(), shapes=True)
    reasons = ("40% of the map is at a bound.",)
    monkeypatch.setattr("tactorch.inverse.result.build._reasons", lambda result: reasons)
    live.save(0, 1)
    ended = live.follow(shapes=True)
    assert live.view.maps[0].result.reasons == reasons
    assert ended.update is not None
    assert ended.update.result.shapes is search.results[1]


def test_with_the_method_map_the_result_is_the_map(live: Any, search: Search) -> None:
    live.save(0, 1)
    ended = live.follow(shapes=False)
    assert not search.calls
    assert not live.view.findings
    assert ended.update is not None
    assert ended.update.result.shapes is None
    assert ended.update.result_presses == 2
    assert ended.history[-1]["finding"] == ended.update.result.plain()


def test_a_run_of_an_earlier_version_is_continued(live: Any, search: Search) -> None:
    live.save(0)
    live.follow(live.new_view(), max_iterations=30)
    state = read_arrays(live.run / STATE, "state", "")
    lines = [json.loads(line) for line in state["history"].tolist()]
    for line in lines:
        for name in ("finding", "finding_presses", "searched"):
            del line[name]
    history = np.array([json.dumps(line) for line in lines])
    write_arrays(live.run / STATE, {**state, "history": history})
    live.follow(live.new_view())
    assert live.lines() == lines
    ended = live.follow(shapes=True)
    assert [presses for presses, _ in search.calls] == [1]
    assert ended.history[0] == lines[0]
    assert ended.history[-1]["searched"]


@pytest.mark.slow
def test_the_ball_is_found_in_the_presses(live: Any) -> None:
    phantom, plan = make_phantom("cube_sphere", radius=0.3), PressPlan(("z+", "x+"), (0.01,))
    live.whole = simulate(phantom, plan, mesh=box_mesh(10.0, 4, tets_per_cell=5), snr_db=40)
    live.save(0, 1)
    ended = live.follow(shapes=True)
    assert ended.update is not None
    result = ended.update.result
    assert result.shapes is not None
    assert result.probability == pytest.approx(1.0)
    lump = result.lumps[0]
    assert lump.inclusion.side == "stiff"
    np.testing.assert_allclose(lump.inclusion.center_mm[:2], 5.0, atol=1.0)
