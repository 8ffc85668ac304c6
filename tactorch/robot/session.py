"""A robot in a closed loop: press, map, next press, until the stop rule is met."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tactorch.errors import ConfigError, FileError, RecordingError, RobotError
from tactorch.files import read_json, write_json
from tactorch.inverse import Settings
from tactorch.inverse.search.draft import DraftShapes
from tactorch.inverse.search.draft_errors import DraftOptions
from tactorch.recording import Recording, append_press
from tactorch.robot.presser import RobotPresser
from tactorch.robot.stop import StopRule
from tactorch.sampling import (
    LoopOptions,
    LoopResult,
    Observer,
    Patch,
    RecordingSource,
    SamplingLoop,
    Suggester,
    SuggestOptions,
    Update,
)
from tactorch.sampling.candidates import Candidates
from tactorch.sampling.inclusions import InclusionSearch
from tactorch.sampling.shape_design import LumpPosition

PRESSES, STATE = "recording.h5", "robot.json"
_PATIENCE_S = 10.0  # after which a press that the loop does not take counts as failed


@dataclass(eq=False)
class RobotSession(Observer):
    """Presses where the loop suggests, whenever it waits for a press.

    Each press is appended to the recording in the run folder. Candidates at which the robot failed
    are kept in a file beside it, and are not tried again, unless the run ended by failures one
    after the other and is continued.

    Attributes:
        presser: The robot.
        patches: Candidates.
        folder: Folder of the run.
        stop: When to end.
        max_failures: Number of failures one after the other at which the run ends.
        observers: Receive messages.
    """

    presser: RobotPresser
    patches: Sequence[Patch]
    folder: Path
    stop: StopRule = field(default_factory=StopRule)
    max_failures: int = 5
    observers: Sequence[Observer] = ()
    _places: dict[str, int] = field(default_factory=dict)  # candidate of each press, by its name
    _failed: dict[int, str] = field(default_factory=dict)  # reason, by candidate
    _in_row: int = 0
    _entry: Mapping[str, Any] | None = None
    _next: int | None = None

    def __post_init__(self) -> None:
        """Take over the state of a run that is continued."""
        if not self.patches:
            raise ConfigError("there is no candidate to press; use a smaller radius of the sensor.")
        path = self.folder / STATE
        if not path.is_file():
            return
        plain = read_json(path, "state of the robot", "delete it, or choose another run_dir.")
        if plain.get("candidates") != self._plain_candidates():
            raise FileError(
                f"'{path}' is of a run with other candidates; give the same object, radius and "
                "number of candidates, or choose another run_dir."
            )
        known = self._recorded()
        self._places = {k: int(v) for k, v in plain["pressed"].items() if k in known}
        self._failed = {int(k): str(v) for k, v in plain["failed"].items()}
        if (streak := int(plain.get("failures_in_row", 0))) >= self.max_failures:
            # The robot was out of order, and the candidates are not to blame.
            self._failed = dict(list(self._failed.items())[:-streak])
        self.presser.restore({k: v for k, v in plain["poses"].items() if k in known})

    @property
    def recording(self) -> Path:
        """The recording that presses are appended to."""
        return self.folder / PRESSES

    @property
    def failed(self) -> dict[int, str]:
        """Reason of the failure of each candidate that failed."""
        return dict(self._failed)

    @property
    def pressed(self) -> tuple[int, ...]:
        """Candidates that were pressed, in order."""
        return tuple(self._places.values())

    @property
    def _remaining(self) -> list[int]:
        done = {*self._places.values(), *self._failed}
        return [i for i in range(len(self.patches)) if i not in done]

    def candidates(self, recording: Recording) -> Candidates:
        """Return the candidates; those that failed count as pressed."""
        done = (*self._places.values(), *self._failed)
        if len(done) == len(self.patches):
            raise ConfigError("all candidates were pressed, or failed")
        return Candidates(self.patches, done, self.presser.plan)

    def end(self) -> str:
        """Return the reason to end now; empty to go on."""
        if self._in_row >= self.max_failures:
            last = list(self._failed.values())[-1]
            return f"the robot failed {self._in_row} times one after the other ({last})"
        entry = self._entry
        if entry is not None and int(entry["press"]) >= len(self._places):
            if reason := self.stop.decide(entry):
                return reason
            if not self._remaining:
                return "all candidates were pressed, or failed"
        if not self._remaining and not self._places:
            return "the robot failed at all candidates"
        return ""

    def resumed(self, history: Sequence[Mapping[str, Any]]) -> None:
        """See `Observer.resumed`."""
        self._entry = history[-1] if history else None
        place = None if self._entry is None else self._entry.get("next")
        if place is not None:
            offsets = [p.center - np.array(place["center_mm"]) for p in self.patches]
            self._next = int(np.argmin(np.linalg.norm(offsets, axis=1)))

    def updated(self, update: Update) -> None:
        """See `Observer.updated`."""
        self._entry, self._next = update.entry, None

    def suggested(self, update: Update) -> None:
        """See `Observer.suggested`."""
        self._next = None if update.suggestion is None else update.suggestion.index

    def waiting(self, presses: int, idle_seconds: float) -> None:
        """Press, if all presses are in the map."""
        if presses < len(self._places):
            if idle_seconds > _PATIENCE_S:
                name, place = self._places.popitem()
                self._fail(place, f"the press {name} cannot be used")
            return
        remaining = self._remaining
        if remaining:
            self._press(self._next if self._next in remaining else self._farthest(remaining))

    def _farthest(self, remaining: Sequence[int]) -> int:
        """Return the candidate that is farthest from those pressed; the first one at first."""
        if not self._places:
            return remaining[0]
        centers = np.array([patch.center for patch in self.patches])
        pressed = centers[list(self._places.values())]
        gaps = np.linalg.norm(centers[remaining, None] - pressed, axis=2).min(axis=1)
        return remaining[int(gaps.argmax())]

    def _press(self, place: int) -> None:
        try:
            press = self.presser.press(self.patches[place])
        except (RobotError, RecordingError, ConfigError) as error:
            self._in_row += 1
            self._fail(place, str(error))
            return
        self._in_row = 0
        self._places[press.name] = place
        # The state is first: a press without its pose could not be corrected for the mesh.
        self._save()
        if self.recording.is_file():
            append_press(self.recording, press)
        else:
            mesh, material = self.presser.mesh, self.presser.material
            Recording(mesh, (press,), material, check_units=False).save(self.recording)

    def _fail(self, place: int, reason: str) -> None:
        self._failed[place] = reason
        self._save()
        center = ", ".join(f"{x:.2f}" for x in self.patches[place].center)
        for observer in self.observers:
            observer.show_message(f"The press at ({center}) mm failed: {reason}")

    def _save(self) -> None:
        plain = {
            "candidates": self._plain_candidates(),
            "pressed": self._places,
            "failed": {str(place): reason for place, reason in self._failed.items()},
            "failures_in_row": self._in_row,
            "poses": self.presser.plain(),
        }
        write_json(self.folder / STATE, plain)

    def _plain_candidates(self) -> list[list[float]]:
        return [[*patch.center.tolist(), *patch.inward.tolist()] for patch in self.patches]

    def _recorded(self) -> set[str]:
        if not self.recording.is_file():
            return set()
        return {press.name for press in Recording.load(self.recording, check_units=False).presses}


def press_until_known(
    session: RobotSession,
    settings: Settings | None = None,
    *,
    options: LoopOptions | None = None,
    suggest: SuggestOptions | None = None,
    draft: DraftOptions | None = None,
) -> LoopResult:
    """Press with a robot until the stop rule is met; a run in the same folder is continued.

    After each press the map is updated and balls are fitted, see
    `tactorch.inverse.search.draft`. The run also ends after `options.max_presses`, when no
    candidate is left, or after several failures of the robot one after the other.

    Args:
        session: The robot with its candidates.
        settings: Settings of the inversions.
        options: Pace of the loop.
        suggest: Rule for the next press; by default that of the least uncertain position.
        draft: Errors that the fits of balls take into account.
    """
    settings = settings or Settings()
    suggest = suggest or SuggestOptions(rule=LumpPosition())
    shapes = DraftShapes(settings, session.presser.fine_prediction, draft)
    return SamplingLoop(
        RecordingSource(session.recording, check_units=False),
        settings,
        session.folder,
        session,
        *session.observers,
        options=options or LoopOptions(poll_seconds=0.01),
        suggester=Suggester(settings, suggest, candidates=session.candidates),
        inclusions=InclusionSearch(settings, session.folder, shapes),
        end=session.end,
    ).run()
