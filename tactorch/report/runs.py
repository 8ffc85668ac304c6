"""Run folders of inversions."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from tactorch.budget import TEXT, read_content
from tactorch.errors import FileError, RecordingError, TactorchError
from tactorch.files import read_json, require_file, require_folder
from tactorch.inverse import NoiseModel, Reconstruction, Settings
from tactorch.inverse.result.build import of_inclusions, with_lumps
from tactorch.loading import load
from tactorch.recording import Recording
from tactorch.text import one_line

_FILES = ("reconstruction.h5", "summary.json")  # of a finished inversion
_SHAPES = "shapes.json"  # of earlier versions
_LOG_LINES = 200
_MAX_NAME_LENGTH = 255


@dataclass(frozen=True, eq=False)
class Run:
    """An inversion, read from its folder.

    Attributes:
        folder: Folder of the run.
        name: Name of the run in the report.
        result: Result of the inversion.
        recording: Inverted recording, or None if it is missing.
        missing: Reason why the recording is missing, or empty.
        summary: Content of `summary.json`.
        text: Content of `summary.txt`.
        log: Last lines of the log.
        settings: Settings of the inversion if the result does not contain all of them.
    """

    folder: Path
    name: str
    result: Reconstruction
    recording: Recording | None
    missing: str = ""
    summary: dict[str, Any] = field(default_factory=dict)
    text: str = ""
    log: str = ""
    settings: Settings | None = None

    @property
    def noise(self) -> NoiseModel:
        """Noise of the inversion; the default for a run of another version."""
        if self.settings is not None:
            return self.settings.noise
        stored = self.result.config.get("settings", {}).get("noise", {})
        try:
            return NoiseModel(**stored)
        except (TypeError, TactorchError):
            return Settings().noise


def load_run(
    folder: str | Path,
    *,
    name: str = "",
    recording: str | Path | None = None,
    check_units: bool = True,
) -> Run:
    """Read the folder of an inversion.

    Args:
        folder: Folder of `tactorch invert` or `tactorch demo`.
        name: Name of the run; the name of the folder if empty.
        recording: Inverted recording, if it is not the file that the run refers to.
        check_units: Whether recordings whose numbers suggest another unit are refused.
    """
    path = require_folder(folder, "run")
    try:
        files = [require_file(path / file, "result of an inversion") for file in _FILES]
    except FileError as error:
        raise FileError(
            f"{error} Give the folder of a finished `tactorch invert` or `tactorch demo`."
        ) from error
    result = Reconstruction.load(files[0])
    summary = read_json(files[1], "summary", "run the inversion again.")
    text = path / "summary.txt"
    loaded, missing = None, ""
    try:
        source = summary.get("recording") if recording is None else recording
        if source is None:
            raise FileError(f"'{files[1]}' refers to no recording")
        loaded = _load_recording(source, result, check_units)
    except (FileError, RecordingError) as error:
        if recording is not None:
            raise
        missing = str(error)
    return Run(
        folder=path,
        name=one_line(name or path.resolve().name, _MAX_NAME_LENGTH),
        result=_complete(result, loaded, path),
        recording=loaded,
        missing=missing,
        summary=summary,
        text=read_content(text).decode("utf-8", errors="replace") if text.is_file() else "",
        log=_load_log(path),
    )


def runs_in(folder: Path) -> list[Path]:
    """Return a folder, or those of the finished inversions in it if it is not one itself."""
    if (folder / _FILES[0]).is_file() or not folder.is_dir():
        return [folder]
    found = sorted(path.parent for path in folder.glob(f"*/{_FILES[0]}"))
    return [run for run in found if (run / _FILES[1]).is_file()] or [folder]


def run_names(folders: Sequence[Path]) -> list[str]:
    """Return a short, unique name of each run folder."""
    parts = [folder.resolve().parts for folder in folders]
    for length in range(1, max(map(len, parts)) + 1):
        names = ["/".join(part[-length:]) for part in parts]
        if len(set(names)) == len(names):
            return names
    return [f"{name} ({number})" for number, name in enumerate(names, start=1)]


def _load_recording(path: str | Path, result: Reconstruction, check_units: bool) -> Recording:
    recording = Recording.load(Path(str(path)), check_units=check_units)
    if recording.mesh.content_hash() != result.mesh.content_hash():
        raise RecordingError(f"recording '{path}' is on another mesh than the result.")
    if len(result.displacements) not in (len(recording.presses), 0):
        raise RecordingError(
            f"recording '{path}' has {len(recording.presses)} presses, the result"
            f" {len(result.displacements)}."
        )
    return recording


def _complete(result: Reconstruction, recording: Recording | None, folder: Path) -> Reconstruction:
    """Return a result of an earlier version with the depths of its lumps, or with its inclusions.

    These versions kept inclusions in a separate file.
    """
    if recording is None or result.shapes is not None or result.residuals is not None:
        return result
    elements, path = with_lumps(result, recording), folder / _SHAPES
    if not path.is_file():
        return elements
    found = of_inclusions(recording, load(path), result.config, result.seconds)
    return replace(found, other=elements)


def _load_log(folder: Path) -> str:
    logs = sorted(folder.glob("*.log"), key=lambda path: path.stat().st_mtime)
    if not logs:
        return ""
    lines = read_content(logs[-1], TEXT).decode("utf-8", errors="replace").splitlines()
    omitted = len(lines) - _LOG_LINES
    head = [f"... {omitted} lines omitted"] if omitted > 0 else []
    return "\n".join([*head, *lines[-_LOG_LINES:]])
