"""`tactorch evaluate`: score a reconstruction against the truth that a recording contains.

    tactorch evaluate run=runs/gauss_newton
    tactorch evaluate run=reconstruction.h5 recording=FILE.h5 out=scores.json

The scores are printed and written to scores.json in the folder of the reconstruction, or to `out`.
"""

from dataclasses import dataclass
from pathlib import Path

from tactorch.cli.console import log, log_text
from tactorch.cli.outputs import score_table
from tactorch.cli.settings import CommandOptions, UnitCheck
from tactorch.config import option
from tactorch.errors import FileError, RecordingError
from tactorch.files import read_json, write_json
from tactorch.inverse import Reconstruction
from tactorch.recording import Recording

_REMEDY = "give recording=FILE.h5."


@dataclass(frozen=True, kw_only=True)
class EvaluateOptions(UnitCheck, CommandOptions):
    """Settings of the command."""

    run: Path = option(help="Run folder of `tactorch invert`, or its reconstruction.h5")
    recording: Path | None = option(None, "Recording; null: the one that the run names")
    out: Path | None = option(
        None, "Scores as JSON; null: scores.json in the folder of the reconstruction"
    )


def run(options: EvaluateOptions) -> dict[str, float]:
    """Score a reconstruction; prints a table and writes JSON."""
    path = options.run / "reconstruction.h5" if options.run.is_dir() else options.run
    reconstruction = Reconstruction.load(path)
    source = options.recording or _recording_path(path)
    recording = Recording.load(source, check_units=options.check_units)
    if recording.truth is None:
        raise RecordingError(f"recording '{source}' contains no truth, so there is no score.")
    if recording.mesh.content_hash() != reconstruction.mesh.content_hash():
        raise RecordingError(
            f"recording '{source}' and reconstruction '{path}' are on different meshes; give the "
            "recording that was inverted."
        )
    values, table = score_table(recording, reconstruction)
    log_text(f"reconstruction: {reconstruction.name}", table)
    for reason in reconstruction.reasons:
        log.warning("Do not trust this result: %s", reason)
    out = options.out or path.parent / "scores.json"
    write_json(out, {"recording": str(source), "description": reconstruction.name, **values})
    log.info("scores: %s", out)
    return values["reconstruction"]


def _recording_path(path: Path) -> Path:
    """Return the recording that a run's summary names."""
    summary = path.parent / "summary.json"
    try:
        return Path(read_json(summary, "summary", _REMEDY, "recording")["recording"])
    except TypeError as error:
        raise FileError(f"'{summary}' does not name a recording ({error}); {_REMEDY}") from error
