"""The loop of a live run: wait for presses, update the map, show it, suggest the next place."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np

from tactorch.errors import ConfigError, ConvergenceError, FileError, RecordingError
from tactorch.findings import find_lump
from tactorch.inverse import START_MPA, IncrementalInversion, IncrementalResult, Settings, Start
from tactorch.metrics import Inclusion
from tactorch.plain import plain
from tactorch.recording import Recording
from tactorch.sampling.live.source import Arrival, Source
from tactorch.sampling.live.store import RESULT, Store, history_of
from tactorch.sampling.live.suggest import Suggester, Suggestion

_PATIENCE_S = 10.0  # for the presses of a run that is continued to be read again


@dataclass(frozen=True)
class FollowOptions:
    """When to look, how much to do at once, and when to end.

    Attributes:
        poll_seconds: Between looks for new presses.
        max_batch: Presses that are taken in one update where several wait.
        max_iterations: Of one update. While no press waits, the map is settled beyond that.
        update_seconds: Of one update, which ends before the iteration that would take it beyond
            (and makes one at the least); None for no limit.
        max_presses: After which the run ends; None for no end.
        idle_seconds: Without a new press after which the run ends; None for no end.
    """

    poll_seconds: float = 0.2
    max_batch: int = 4
    max_iterations: int = 6
    update_seconds: float | None = 2.2
    max_presses: int | None = None
    idle_seconds: float | None = None

    def __post_init__(self) -> None:
        """Check ranges."""
        for name in ("poll_seconds", "max_batch", "max_iterations"):
            if not getattr(self, name) > 0:
                raise ConfigError(f"{name}={getattr(self, name)} must be above 0.")
        for name in ("update_seconds", "max_presses", "idle_seconds"):
            value = getattr(self, name)
            if value is not None and not value > 0:
                raise ConfigError(f"{name}={value}: give a number above 0, or null for no end.")


@dataclass(frozen=True, eq=False)
class Seen:
    """What stands after an update.

    Attributes:
        recording: All presses so far.
        found: The map; its history is that of this update.
        inclusion: What stands out of it; None where nothing does.
        entry: The line of the history, plain values: press (how many so far), names, seconds,
            iterations, chi2, weight, inclusion, deviation, next and more.
        suggestion: Where to press next; None until that is known.
    """

    recording: Recording
    found: IncrementalResult
    inclusion: Inclusion | None
    entry: dict[str, Any]
    suggestion: Suggestion | None = None


@runtime_checkable
class View(Protocol):
    """Shows a live run."""

    def waiting(self, presses: int, idle_seconds: float) -> None:
        """Nothing has come since the last look."""

    def resumed(self, history: Sequence[Mapping[str, Any]]) -> None:
        """A run is continued, which has this history."""

    def show_message(self, text: str) -> None:
        """Something is wrong with a press or a file."""

    def updated(self, seen: Seen) -> None:
        """The map was updated; the suggestion is still to come."""

    def suggested(self, seen: Seen) -> None:
        """The suggestion is there too."""


@dataclass(frozen=True, eq=False)
class Ended:
    """How a run ended.

    Attributes:
        reason: In words.
        history: One entry an update.
        seen: What stands at the end; None where no press came.
        interrupted: Whether by Ctrl-C.
    """

    reason: str
    history: list[dict[str, Any]]
    seen: Seen | None
    interrupted: bool = False


class Follower:
    """Follows a source of presses until there is a reason to end."""

    def __init__(
        self,
        source: Source,
        settings: Settings,
        folder: str | Path,
        view: View,
        *,
        options: FollowOptions | None = None,
        suggester: Suggester | None = None,
        start_mpa: Start | None = None,
    ) -> None:
        """Take what to follow; nothing is read yet.

        Args:
            source: Where presses come from.
            settings: Of the inversions.
            folder: Of the run; a state there is continued.
            view: Shows it.
            options: When to look and to end.
            suggester: Of the next place.
            start_mpa: Where the first inversion starts.
        """
        self._source, self._settings, self._view = source, settings, view
        self._options = options or FollowOptions()
        self._suggester = suggester or Suggester(settings)
        self._start = START_MPA if start_mpa is None else start_mpa
        self._folder = Path(folder)
        digest = sha256(repr(plain(settings)).encode()).hexdigest()[:16]
        self._store = Store(folder, digest)
        self._waiting: list[Arrival] = []
        self._done: list[Arrival] = []
        self._history: list[dict[str, Any]] = []
        self._growing: IncrementalInversion | None = None
        self._seen: Seen | None = None

    def run(self) -> Ended:
        """Follow until the end; Ctrl-C is one.

        Raises:
            KeyboardInterrupt: before any press was seen.
            FileError: the state to continue cannot be read, or its presses are missing.
            RecordingError: the object changed, or presses that were read did.
        """
        try:
            self._continue()
            self._rest()  # which a run that was killed may not have come to
            reason = self._follow()
            self._rest()
        except KeyboardInterrupt:
            if self._seen is None and not self._history:
                raise
            return Ended("interrupted", self._history, self._seen, interrupted=True)
        return Ended(reason, self._history, self._seen)

    def _follow(self) -> str:
        """Update as presses come; returns why no more are awaited."""
        options, last = self._options, time.monotonic()
        while True:
            left = _left(options.max_presses, len(self._done))
            if left == 0:
                return f"{options.max_presses} presses were asked for, and have come"
            self._look()
            if self._waiting:
                count = min(options.max_batch, len(self._waiting), left or len(self._waiting))
                batch, self._waiting = self._waiting[:count], self._waiting[count:]
                self._update(batch)
                self._rest()
                last = time.monotonic()
                continue
            idle = time.monotonic() - last
            if options.idle_seconds is not None and idle >= options.idle_seconds:
                return f"no press has come for {options.idle_seconds:g} s"
            self._view.waiting(len(self._done), idle)
            time.sleep(options.poll_seconds)

    def _look(self) -> None:
        self._waiting += self._source.poll()

    def _continue(self) -> None:
        """Take up a run that this folder holds."""
        state = self._store.load()
        if state is None:
            return
        keys = [str(key) for key in state["keys"]]
        known = dict(zip(keys, map(str, state["marks"]), strict=True))
        came = self._await(keys)
        for arrival in came:
            if arrival.mark != known[arrival.key]:
                raise RecordingError(
                    f"{arrival.key} is another than when this run had it; choose another run_dir "
                    "for another recording."
                )
        growing = self._inversion()
        growing.restore([one.press for one in came], state)
        self._growing, self._done, self._history = growing, came, history_of(state)
        self._store.write_history(self._history)
        self._view.resumed(self._history)

    def _await(self, keys: Sequence[str]) -> list[Arrival]:
        """The presses that the run had, in its order; a file may take a while to be readable."""
        patience = time.monotonic() + _PATIENCE_S
        while True:
            self._look()
            there = {one.key: one for one in self._waiting}
            missing = [key for key in keys if key not in there]
            if not missing:
                break
            if time.monotonic() > patience:
                raise FileError(
                    f"'{self._source.path}' lacks {missing[0]!r} ({len(missing)} presses in all), "
                    f"which the run in '{self._folder}' had; give the recording that it followed, "
                    "or choose another run_dir."
                )
            time.sleep(self._options.poll_seconds)
        self._waiting = [one for one in self._waiting if one.key not in set(keys)]
        return [there[key] for key in keys]

    def _inversion(self) -> IncrementalInversion:
        assert self._source.about is not None
        return IncrementalInversion(
            self._source.about,
            self._settings,
            max_iterations=self._options.max_iterations,
            max_seconds_per_update=self._options.update_seconds,
            start_mpa=self._start,
        )

    def _update(self, batch: list[Arrival]) -> None:
        """Take presses into the map; one that cannot be is passed over."""
        began = time.perf_counter()
        growing = self._growing or self._inversion()
        try:
            found = growing.add([one.press for one in batch])
        except (ConvergenceError, RecordingError, ConfigError) as error:
            if len(batch) > 1:  # which one is it?
                for one in batch:
                    self._update([one])
                return
            if isinstance(error, ConfigError):
                raise
            self._view.show_message(f"{batch[0].key} is passed over: {error}")
            return
        self._growing = growing
        self._done += batch
        names = [one.key for one in batch]
        self._show(found, names, time.perf_counter() - began)

    def _rest(self) -> None:
        """Settle the map and suggest a place, unless a press has come that waits."""
        if not self._pressed():
            self._settle()
        seen = self._seen
        if seen is not None and seen.suggestion is None and not self._pressed():
            self._suggest(seen)

    def _pressed(self) -> bool:
        """Whether a press waits that is to be taken."""
        if _left(self._options.max_presses, len(self._done)) == 0:
            return False
        self._look()
        return bool(self._waiting)

    def _settle(self) -> None:
        """Where the last update had not come to its end, go on to it while no press comes."""
        growing, seen = self._growing, self._seen
        if growing is None or (seen is not None and seen.found.settled):
            return
        last = self._history[-1]
        if seen is None and last["settled"] and "next" in last:
            return
        began = time.perf_counter()
        found = growing.refine(stop=self._pressed)
        self._show(found, [], time.perf_counter() - began)

    def _show(self, found: IncrementalResult, names: list[str], seconds: float) -> None:
        growing = self._growing
        assert growing is not None
        result, recording = found.result, growing.recording
        inclusion = find_lump(recording.mesh, result.youngs)
        entry = {
            "press": len(self._done),
            "names": names,
            "seconds": seconds,
            "iterations": result.iterations,
            "stop_reason": result.stop_reason,
            "settled": found.settled,
            "chi2": float(result.history[-1]["chi2"]),
            "weight": found.weight,
            "youngs_median_mpa": float(np.median(result.youngs)),
            "inclusion": None if inclusion is None else inclusion.plain(),
        }
        self._history.append(entry)
        self._store.save(growing.state(), self._done, self._history)
        result.save(self._folder / RESULT)
        self._seen = Seen(recording, found, inclusion, entry)
        self._view.updated(self._seen)

    def _suggest(self, seen: Seen) -> None:
        made = self._suggester.suggest(seen.found.point, seen.found.weight, self._pressed)
        if made is None:
            return
        seen.entry.update(suggestion_values(made, seen))
        assert self._growing is not None
        self._store.save(self._growing.state(), self._done, self._history)
        self._seen = Seen(seen.recording, seen.found, seen.inclusion, seen.entry, made)
        self._view.suggested(self._seen)


def suggestion_values(made: Suggestion, seen: Seen) -> dict[str, Any]:
    """Return what a history holds of a suggestion, and of how sure the map is."""
    patch, deviation = made.patch, made.deviation
    volumes = seen.recording.mesh.volumes

    def rms(where: np.ndarray) -> float | None:
        if deviation is None or not where.any():
            return None
        share = volumes[where]
        return float(np.sqrt(share @ deviation[where] ** 2 / share.sum()))

    everywhere = np.ones(len(volumes), dtype=bool)
    within = everywhere & False if seen.inclusion is None else seen.inclusion.elements
    place = None
    if patch is not None:
        place = {
            "center_mm": [float(x) for x in patch.center],
            "inward": [float(x) for x in patch.inward],
            "radius_mm": float(patch.radius_mm),
        }
    return {
        "deviation": rms(everywhere),
        "deviation_inclusion": rms(within),
        "next": place,
        "next_why_not": made.why_not,
        "next_rule": made.rule,
        "next_seconds": made.seconds,
    }


def _left(most: int | None, done: int) -> int | None:
    return None if most is None else max(most - done, 0)
