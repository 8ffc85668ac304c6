"""What the folder of an inversion holds."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tactorch.errors import FileError, RecordingError
from tactorch.files import require_file, require_folder
from tactorch.inverse import Reconstruction, Settings
from tactorch.recording import Recording

_LOG_LINES = 200


@dataclass(frozen=True, eq=False)
class Run:
    """An inversion, read from its folder.

    Attributes:
        folder: Where it is.
        name: What the report calls it.
        found: Its result.
        recording: What was inverted, or None where it is gone.
        missing: Why there is no recording; empty where there is one.
        summary: `summary.json`.
        text: `summary.txt`.
        log: The end of its log.
        settings: Settings of the inversion, where the result does not hold them all.
    """

    folder: Path
    name: str
    found: Reconstruction
    recording: Recording | None
    missing: str
    summary: dict[str, Any]
    text: str
    log: str
    settings: Settings | None = None


def load_run(
    folder: str | Path,
    *,
    name: str = "",
    recording: str | Path | None = None,
    check_units: bool = True,
) -> Run:
    """Read what an inversion left.

    Args:
        folder: Folder of `tactorch invert` or `tactorch demo`.
        name: What to call it; by default as the folder is called.
        recording: What was inverted, where it is not the file that the run names.
        check_units: Refuse a recording whose numbers look like another unit.

    Raises:
        FileError: it is not the folder of a finished inversion, or a file cannot be read.
        RecordingError: the recording that is given is on another mesh.
    """
    place = require_folder(folder, "run")
    found = Reconstruction.load(_required(place, "reconstruction.h5"))
    summary = _summary(_required(place, "summary.json"))
    text = place / "summary.txt"
    seen, missing = _recording(place, found, summary, recording, check_units)
    return Run(
        folder=place,
        name=name or place.resolve().name,
        found=found,
        recording=seen,
        missing=missing,
        summary=summary,
        text=text.read_text(encoding="utf-8", errors="replace") if text.is_file() else "",
        log=_log(place),
    )


def names_of(folders: Sequence[Path]) -> list[str]:
    """Return a short name for each run, no two the same."""
    parts = [folder.resolve().parts for folder in folders]
    for length in range(1, max(map(len, parts)) + 1):
        names = ["/".join(part[-length:]) for part in parts]
        if len(set(names)) == len(names):
            return names
    return [f"{name} ({number})" for number, name in enumerate(names, start=1)]


def _required(place: Path, name: str) -> Path:
    """Return a file of a finished inversion, or say that it is none."""
    try:
        return require_file(place / name, "result of an inversion")
    except FileError as error:
        raise FileError(
            f"{error} Give the folder of a finished `tactorch invert` or `tactorch demo`."
        ) from error


def _summary(path: Path) -> dict[str, Any]:
    try:
        summary = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(summary, dict):
            raise ValueError("not a table")
    except (OSError, ValueError) as error:
        raise FileError(f"'{path}' cannot be read ({error}); run the inversion again.") from error
    return summary


def _recording(
    place: Path,
    found: Reconstruction,
    summary: dict[str, Any],
    given: str | Path | None,
    check_units: bool,
) -> tuple[Recording | None, str]:
    """Return the recording, or why there is none; one that is given has to be there and fit."""
    source = summary.get("recording") if given is None else given
    if source is None:
        return None, f"'{place / 'summary.json'}' names no recording"
    try:
        recording = Recording.load(Path(str(source)), check_units=check_units)
        if recording.mesh.content_hash() != found.mesh.content_hash():
            raise RecordingError(f"recording '{source}' is on another mesh than the result.")
        if len(recording.presses) != len(found.displacements):
            raise RecordingError(
                f"recording '{source}' has {len(recording.presses)} presses, the result"
                f" {len(found.displacements)}."
            )
    except (FileError, RecordingError) as error:
        if given is not None:
            raise
        return None, str(error)
    return recording, ""


def _log(place: Path) -> str:
    """Return the end of the log that the run was written to."""
    logs = sorted(place.glob("*.log"), key=lambda path: path.stat().st_mtime)
    if not logs:
        return ""
    lines = logs[-1].read_text(encoding="utf-8", errors="replace").splitlines()
    left = len(lines) - _LOG_LINES
    head = [f"... {left} lines before"] if left > 0 else []
    return "\n".join([*head, *lines[-_LOG_LINES:]])
