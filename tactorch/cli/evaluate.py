"""`tactorch evaluate`."""

import json
from pathlib import Path

from omegaconf import DictConfig

from tactorch.cli.logs import tell
from tactorch.cli.outputs import score_table, write_json
from tactorch.cli.settings import log
from tactorch.errors import FileError, RecordingError
from tactorch.inverse import Reconstruction
from tactorch.recording import Recording


def run(cfg: DictConfig) -> dict[str, float]:
    """Score a reconstruction; prints a table and writes JSON."""
    path = Path(str(cfg.run))
    path = path / "reconstruction.h5" if path.is_dir() else path
    reconstruction = Reconstruction.load(path)
    source = _recording_of(path) if cfg.recording is None else Path(str(cfg.recording))
    recording = Recording.load(source, check_units=cfg.check_units)
    if recording.truth is None:
        raise RecordingError(f"recording '{source}' carries no truth, so there is no score.")
    if recording.mesh.content_hash() != reconstruction.mesh.content_hash():
        raise RecordingError(
            f"recording '{source}' and reconstruction '{path}' are on different meshes; give the "
            "recording that was inverted."
        )
    columns = score_table(recording, {"reconstruction": reconstruction.youngs})
    tell(columns.table.text(), columns.table)
    out = path.parent / "scores.json" if cfg.out is None else Path(str(cfg.out))
    write_json(out, columns.values)
    log.info("scores: %s", out)
    return columns.values["reconstruction"]


def _recording_of(path: Path) -> Path:
    """The recording that a run's summary names."""
    summary = path.parent / "summary.json"
    try:
        return Path(json.loads(summary.read_text())["recording"])
    except (OSError, KeyError, ValueError) as error:
        raise FileError(
            f"'{summary}' does not name a recording ({error}); give recording=FILE.h5."
        ) from error
