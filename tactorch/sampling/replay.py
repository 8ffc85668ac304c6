"""Replay of a recording press by press, to try a live run without a robot."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from threading import Event

from tactorch.errors import ConfigError, RecordingError
from tactorch.recording import Recording, append_press, compact
from tactorch.recording.append import digest


def replay(
    recording: Recording,
    target: str | Path,
    pause_seconds: float,
    stop: Event | None = None,
    on_press: Callable[[int], None] = lambda number: None,
) -> int:
    """Write a recording's presses into a growing one, with pauses.

    Args:
        recording: Recording to replay.
        target: The growing recording; presses it holds already are not written again.
        pause_seconds: Pause before each press but the first, s.
        stop: Ends the replay when set.
        on_press: Called with the number of presses after each.

    Returns:
        Number of presses that the target holds.

    Raises:
        ConfigError: the pause is negative.
        RecordingError: the target holds presses of another recording.
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
        on_press(index + 1)
    compact(target)
    return len(recording.presses)


def _played(recording: Recording, target: Path) -> int:
    """Number of the recording's presses that the target holds."""
    played = Recording.load(target, check_units=False)
    pairs = zip(played.presses, recording.presses, strict=False)
    if (
        played.mesh.content_hash() != recording.mesh.content_hash()
        or played.material != recording.material
        or len(played.presses) > len(recording.presses)
        or any(digest(old) != digest(new) for old, new in pairs)
    ):
        raise RecordingError(
            f"'{target}' holds presses of another recording than the replayed one; choose "
            "another run_dir."
        )
    return len(played.presses)
