"""The loop of press, inversion and suggestion, over any source of presses."""

import json
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from tactorch.config import Options, option, to_mapping
from tactorch.errors import (
    CancelledError,
    ConfigError,
    ConvergenceError,
    FileError,
    RecordingError,
)
from tactorch.files import read_arrays, write_arrays, write_file
from tactorch.inverse import (
    IncrementalInversion,
    IncrementalResult,
    Reconstruction,
    Settings,
    Start,
    StopReason,
)
from tactorch.inverse.fit.starts import START_MPA
from tactorch.recording import Recording
from tactorch.sampling.inclusions import InclusionSearch
from tactorch.sampling.sources import Arrival, PressSource
from tactorch.sampling.suggest import Suggester, Suggestion

STATE, HISTORY, RESULT = "state.npz", "history.jsonl", "reconstruction.h5"
_RESUME_TIMEOUT_S = 10.0  # for the presses of a continued run to be readable


@dataclass(frozen=True)
class LoopOptions(Options):
    """Pace of the loop, and when it ends."""

    poll_seconds: float = option(0.2, "Interval between looks for new presses", unit="s", gt=0)
    max_batch: int = option(4, "Largest number of waiting presses taken in one update", ge=1)
    max_iterations: int = option(
        6, "Iterations of one update; while no press waits, the map is refined beyond that", ge=1
    )
    update_seconds: float | None = option(
        2.2, "Time limit of one update, which makes at least one iteration", unit="s", gt=0
    )
    max_presses: int | None = option(None, "Number of presses after which the run ends", ge=1)
    idle_seconds: float | None = option(
        None, "Time without a new press after which the run ends", unit="s", gt=0
    )


@dataclass(frozen=True, eq=False)
class Update:
    """State after an inversion.

    Attributes:
        recording: All presses so far.
        solution: Element map of all presses; its history is that of this update.
        result: The result that is shown: by the inclusions that were fitted last, or the map.
        result_presses: Number of presses that the result is of, the first ones of the recording.
        entry: Line of the history, plain values: press (number so far), names, seconds,
            iterations, chi2, weight, finding, finding_presses, searched (whether inclusions were
            fitted to all presses), deviation, next and more.
        suggestion: Suggested next press; None until it is known.
    """

    recording: Recording
    solution: IncrementalResult
    result: Reconstruction
    result_presses: int
    entry: dict[str, Any]
    suggestion: Suggestion | None = None

    @property
    def youngs(self) -> np.ndarray:
        """Young's modulus of each element in the result, MPa."""
        return self.result.youngs

    @property
    def rms_deviation(self) -> float | None:
        """Volume-weighted root mean square of the parameters' standard deviations."""
        return self._rms(np.ones(self.recording.mesh.n_tets, dtype=bool))

    def suggested(self, suggestion: Suggestion) -> "Update":
        """Return the update with a suggestion, also in its entry."""
        update, patch = replace(self, suggestion=suggestion), suggestion.patch
        place = None
        if patch is not None:
            place = {
                "center_mm": patch.center.tolist(),
                "inward": patch.inward.tolist(),
                "radius_mm": float(patch.radius_mm),
            }
        update.entry.update(
            deviation=update.rms_deviation,
            deviation_inclusion=update._rms_in_lump(),
            next=place,
            next_why_not=suggestion.reason,
            next_rule=suggestion.rule,
            next_seconds=suggestion.seconds,
        )
        return update

    def found(self, result: Reconstruction) -> "Update":
        """Return the update with the result of a search in all presses, also in its entry."""
        count = len(self.recording.presses)
        self.entry.update(finding=result.plain(), finding_presses=count, searched=True)
        return replace(self, result=result, result_presses=count)

    def _rms_in_lump(self) -> float | None:
        lumps = self.solution.result.lumps
        return self._rms(lumps[0].inclusion.elements) if lumps else None

    def _rms(self, elements: np.ndarray) -> float | None:
        deviation = None if self.suggestion is None else self.suggestion.deviation
        if deviation is None or not elements.any():
            return None
        volumes = self.recording.mesh.volumes[elements]
        return float(np.sqrt(volumes @ deviation[elements] ** 2 / volumes.sum()))


class Observer:
    """Receives the events of a loop; override the methods of interest."""

    def waiting(self, presses: int, idle_seconds: float) -> None:
        """No press came since the last look."""

    def resumed(self, history: Sequence[Mapping[str, Any]]) -> None:
        """A run with this history is continued."""

    def show_message(self, text: str) -> None:
        """A press or a file is invalid."""

    def updated(self, update: Update) -> None:
        """The map was updated; the suggestion is not known yet."""

    def suggested(self, update: Update) -> None:
        """The next press was suggested."""

    def found(self, update: Update) -> None:
        """Inclusions were fitted to all presses, or cannot be: the result is of all presses."""


@dataclass(frozen=True, eq=False)
class LoopResult:
    """End of a loop.

    Attributes:
        reason: Why it ended.
        history: One entry per update.
        update: Last update; None if no press came.
    """

    reason: str
    history: list[dict[str, Any]]
    update: Update | None


class Store:
    """State and history of a run, from which a killed one continues.

    Each file is replaced as a whole. The state holds the history too, so that the two never
    disagree: a run that was killed between writing them writes the history again. A run is
    continued with the same settings only; `task` is their digest.
    """

    def __init__(self, folder: str | Path, task: str) -> None:
        self.folder, self._task = Path(folder), task

    def save(
        self,
        state: Mapping[str, np.ndarray],
        arrivals: Sequence[Arrival],
        history: Sequence[Mapping[str, Any]],
    ) -> None:
        """Write the state and the history, one JSON object a line."""
        lines = [json.dumps(entry, allow_nan=False) for entry in history]
        texts = {"keys": [a.key for a in arrivals], "marks": [a.digest for a in arrivals]}
        texts |= {"history": lines, "task": [self._task]}
        arrays = {name: np.array(values, dtype=str) for name, values in texts.items()}
        write_arrays(self.folder / STATE, {**arrays, **state})
        write_file(self.folder / HISTORY, "".join(f"{line}\n" for line in lines))

    def load(self) -> tuple[dict[str, np.ndarray], dict[str, str], list[dict[str, Any]]] | None:
        """Return state, digests of the presses by key, and history; None if the folder has none."""
        path = self.folder / STATE
        if not path.exists():
            return None
        state = read_arrays(path, "state", "delete it, or choose another run_dir.")
        if [self._task] != state.get("task", np.empty(0)).tolist():
            raise FileError(
                f"'{path}' is of a run with other settings; give those, to continue it, or choose "
                "another run_dir."
            )
        digests = dict(zip(state["keys"].tolist(), state["marks"].tolist(), strict=True))
        return state, digests, [json.loads(line) for line in state["history"].tolist()]


class SamplingLoop:
    """Inverts presses as they come, and suggests the next one.

    Args:
        source: Source of presses.
        settings: Settings of the inversions; with `method="map"` no inclusions are fitted while no
            press waits.
        folder: Folder of the run; a run there is continued. None keeps none.
        observers: Receive the loop's events.
        options: Pace and end.
        suggester: Suggests the next press; expected error by default.
        start_mpa: Start of the first inversion.
        restart: See `IncrementalInversion`; for presses on request. A press that cannot be inverted
            then raises, and is otherwise reported and skipped. No shapes are fitted.
        target_deviation: Root mean square deviation of the parameters at which the loop ends.
        inclusions: Search for shapes; `find_shapes` by default.
        end: Called before each press, in a closed loop, whose presses follow the suggestions: the
            reason to end, or an empty text. Rules that use shapes then suggest after the search.
    """

    def __init__(
        self,
        source: PressSource,
        settings: Settings,
        folder: str | Path | None = None,
        *observers: Observer,
        options: LoopOptions | None = None,
        suggester: Suggester | None = None,
        start_mpa: Start = START_MPA,
        restart: bool = False,
        target_deviation: float = 0.0,
        inclusions: InclusionSearch | None = None,
        end: Callable[[], str] | None = None,
    ) -> None:
        self._source, self._settings, self._start = source, settings, start_mpa
        self._observers, self._options = observers, options or LoopOptions()
        self._suggester = suggester or Suggester(settings)
        self._restart, self._target_deviation = restart, target_deviation
        self._max_presses = self._options.max_presses or sys.maxsize
        digest = _digest(to_mapping(replace(settings, max_seconds=None, method="auto")))
        self._store = None if folder is None else Store(folder, digest)
        self._inclusions = inclusions or InclusionSearch(settings, folder)
        self._closed_end = end
        self._fits_shapes = settings.method != "map" and not restart
        self._waiting: list[Arrival] = []
        self._done: list[Arrival] = []
        self._history: list[dict[str, Any]] = []
        self._inversion: IncrementalInversion | None = None
        self._update: Update | None = None

    def run(self) -> LoopResult:
        """Run to the end; Ctrl-C ends it with the last complete update, or raises without any."""
        try:
            self._resume()
            self._use_idle_time()  # a run that was killed may not have come to it
            reason = self._follow()
            if not self._restart:  # it would carry out another press
                self._refine_and_suggest()
                self._find_and_suggest(stop=lambda: False)
        except KeyboardInterrupt:
            if not self._history:
                raise
            reason = "interrupted"
        return LoopResult(reason, self._history, self._update)

    def _follow(self) -> str:
        """Update as presses come; return the reason of the end."""
        options, last = self._options, time.monotonic()
        while not (reason := self._end()):
            if self._press_waits():
                count = min(options.max_batch, self._max_presses - len(self._done))
                batch, self._waiting = self._waiting[:count], self._waiting[count:]
                self._add(batch)
                self._use_idle_time()
                last = time.monotonic()
                continue
            idle = time.monotonic() - last
            if options.idle_seconds is not None and idle >= options.idle_seconds:
                return f"no press came for {options.idle_seconds:g} s"
            for observer in self._observers:
                observer.waiting(len(self._done), idle)
            time.sleep(options.poll_seconds)
        return reason

    def _end(self) -> str:
        """Reason to end now; empty if there is none."""
        if len(self._done) >= self._max_presses:
            return f"{self._max_presses} presses (max_presses) were made"
        if self._closed_end is not None and (reason := self._closed_end()):
            return reason
        update = self._update
        if update is None:
            return ""
        if update.solution.result.stop_reason == StopReason.INTERRUPTED:
            return "interrupted"
        deviation = update.rms_deviation
        reached = deviation is not None and deviation <= self._target_deviation
        return f"the deviation is {deviation:.3g}, as low as the target" if reached else ""

    def _press_waits(self) -> bool:
        if len(self._done) >= self._max_presses:
            return False
        self._waiting += self._source.poll()
        return bool(self._waiting)

    def _make_inversion(self) -> IncrementalInversion:
        assert self._source.about is not None
        return IncrementalInversion(
            self._source.about,
            self._settings,
            start_mpa=self._start,
            max_iterations=self._options.max_iterations,
            max_seconds_per_update=self._options.update_seconds,
            restart=self._restart,
        )

    def _add(self, batch: list[Arrival]) -> None:
        """Invert new presses; invalid ones are reported and skipped."""
        started = time.perf_counter()
        try:
            inversion = self._inversion or self._make_inversion()
            solution = inversion.add([arrival.press for arrival in batch])
        except (ConvergenceError, RecordingError, ConfigError) as error:
            if self._restart:
                raise
            if len(batch) > 1:  # find the invalid one
                for arrival in batch:
                    self._add([arrival])
                return
            if isinstance(error, ConfigError):
                raise
            for observer in self._observers:
                observer.show_message(f"{batch[0].key} is invalid and skipped: {error}")
            return
        self._inversion = inversion
        self._done += batch
        self._publish(solution, [a.key for a in batch], time.perf_counter() - started)

    def _use_idle_time(self) -> None:
        """Refine the map, suggest a press and fit inclusions, until a press waits."""
        self._refine_and_suggest()
        self._find_and_suggest(stop=self._press_waits)

    def _refine_and_suggest(self) -> None:
        """Refine the map and suggest a press, unless a press waits."""
        if not self._press_waits():
            self._refine()
        waits_for_shapes = (
            self._closed_end is not None and self._suggester.uses_shapes and self._fits_shapes
        )
        if self._update is not None and self._update.suggestion is None and not waits_for_shapes:
            self._suggest()

    def _suggest(self) -> None:
        """Suggest a press, unless a press waits."""
        update = self._update
        if update is None or self._press_waits():
            return
        solution, shapes = update.solution, self._inclusions.shapes
        suggestion = self._suggester.suggest(
            solution.point, solution.weight, self._press_waits, shapes
        )
        if suggestion is not None:
            self._update = update.suggested(suggestion)
            self._save()
            for observer in self._observers:
                observer.suggested(self._update)

    def _find_and_suggest(self, stop: Callable[[], bool]) -> None:
        """Fit shapes to all presses, once for each number of them, and suggest a press by them."""
        update = self._update
        if update is None or not self._lacks_shapes() or stop():
            return
        try:
            result = self._inclusions.search(update.recording, update.solution.result, stop)
        except CancelledError:
            return
        self._update = update.found(result)
        self._save(result)
        for observer in self._observers:
            observer.found(self._update)
        has_shapes = result.shapes is not None and bool(result.shapes.inclusions)
        if self._suggester.uses_shapes and (has_shapes or self._closed_end is not None):
            self._suggest()

    def _lacks_shapes(self) -> bool:
        """Whether shapes are still to be fitted to the presses of the last update."""
        return self._fits_shapes and not self._history[-1].get("searched", False)

    def _refine(self) -> None:
        """Continue an update that ended at its limit, until a press comes."""
        inversion, update = self._inversion, self._update
        if inversion is None or (update is not None and update.solution.converged):
            return
        last = self._history[-1]
        is_complete = last["settled"] and "next" in last and not self._lacks_shapes()
        if update is None and is_complete:
            return
        started = time.perf_counter()
        solution = inversion.refine(stop=self._press_waits)
        self._publish(solution, [], time.perf_counter() - started)

    def _publish(self, solution: IncrementalResult, names: list[str], seconds: float) -> None:
        assert self._inversion is not None
        result, recording = solution.result, self._inversion.recording
        shown, presses = self._inclusions.present(recording, result)
        searched = not names and bool(self._history) and self._history[-1].get("searched", False)
        entry = {
            "press": len(self._done),
            "names": names,
            "seconds": seconds,
            "iterations": result.iterations,
            "stop_reason": result.stop_reason,
            "settled": solution.converged,
            "chi2": float(result.history[-1]["chi2"]),
            "weight": solution.weight,
            "youngs_median_mpa": float(np.median(result.youngs)),
            "finding": shown.plain(),
            "finding_presses": presses,
            "searched": searched,
        }
        self._history.append(entry)
        self._update = Update(recording, solution, shown, presses, entry)
        self._save(shown)
        for observer in self._observers:
            observer.updated(self._update)

    def _save(self, result: Reconstruction | None = None) -> None:
        """Save the state, and a result that has changed."""
        if self._store is None or self._inversion is None:
            return
        state = {**self._inversion.state(), "object": np.array(self._object_digest())}
        self._store.save(state, self._done, self._history)
        if result is not None:
            result.save(self._store.folder / RESULT)

    def _object_digest(self) -> str:
        about = self._source.about
        assert about is not None
        weight = about.density, about.gravity.tolist()
        return _digest((about.mesh.content_hash(), about.material, weight))

    def _resume(self) -> None:
        saved = None if self._store is None else self._store.load()
        if saved is None:
            self._inclusions.clear()
            return
        state, digests, history = saved
        arrivals = self._await(list(digests))
        if str(state.get("object")) != self._object_digest():
            raise RecordingError(
                f"{self._source.name} is of another object than this run: its mesh, material, "
                "density or gravity differs; choose another run_dir."
            )
        for arrival in arrivals:
            if arrival.digest != digests[arrival.key]:
                raise RecordingError(
                    f"{arrival.key} differs from the press of this run; choose another run_dir "
                    "for another recording."
                )
        self._inversion, self._done = self._make_inversion(), arrivals
        self._inversion.restore([arrival.press for arrival in arrivals], state)
        self._inclusions.restore(self._inversion.recording)
        self._history = history
        self._save()
        for observer in self._observers:
            observer.resumed(self._history)

    def _await(self, keys: Sequence[str]) -> list[Arrival]:
        """Presses of the continued run in its order; a file may not be readable at once."""
        deadline = time.monotonic() + _RESUME_TIMEOUT_S
        while True:
            self._waiting += self._source.poll()
            available = {arrival.key: arrival for arrival in self._waiting}
            missing = [key for key in keys if key not in available]
            if not missing:
                break
            if time.monotonic() > deadline:
                raise FileError(
                    f"{self._source.name} lacks {missing[0]!r} ({len(missing)} presses in all) of "
                    "the continued run; give the recording that it followed, or choose another "
                    "run_dir."
                )
            time.sleep(self._options.poll_seconds)
        self._waiting = [arrival for arrival in self._waiting if arrival.key not in set(keys)]
        return [available[key] for key in keys]


def _digest(value: Any) -> str:
    return sha256(repr(value).encode()).hexdigest()[:16]
