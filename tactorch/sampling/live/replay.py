"""Playing a recording press by press, as a robot would make it: to try without one."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from threading import Event

from tactorch.errors import ConfigError, RecordingError
from tactorch.recording import Recording, append_press
from tactorch.recording.append import digest


def replay(
    recording: Recording,
    target: str | Path,
    pause_seconds: float,
    stop: Event | None = None,
    told: Callable[[int], None] = lambda number: None,
) -> int:
    """Write a recording's presses into a growing one, with pauses; returns how many were written.

    What the target holds already counts as played.

    Args:
        recording: What to play.
        target: The growing recording.
        pause_seconds: Before each press but the first.
        stop: Ends the play when set.
        told: Called with the number of presses after each.

    Raises:
        ConfigError: the pause is negative.
        RecordingError: the target is of another recording.
        FileError: the target cannot be written.
    """
    if not pause_seconds >= 0:
        raise ConfigError(f"pause_seconds={pause_seconds}: give a time of at least 0 s.")
    target, stop = Path(target), stop or Event()
    done = _played(recording, target) if target.exists() else 0
    for index in range(done, len(recording.presses)):
        if index > done and stop.wait(pause_seconds):
            return index
        if index == 0:
            replace(recording, presses=recording.presses[:1], check_units=False).save(target)
        else:
            append_press(target, recording.presses[index])
        told(index + 1)
    return len(recording.presses)


def _played(recording: Recording, target: Path) -> int:
    """How many presses the target holds already, which are those of the recording."""
    there = Recording.load(target, check_units=False)
    same = there.mesh.content_hash() == recording.mesh.content_hash()
    pairs = zip(there.presses, recording.presses, strict=False)
    if (
        not same
        or there.material != recording.material
        or len(there.presses) > len(recording.presses)
        or any(digest(one) != digest(other) for one, other in pairs)
    ):
        raise RecordingError(
            f"'{target}' holds presses of another recording than the one to be replayed; choose "
            "another run_dir for it."
        )
    return len(there.presses)
