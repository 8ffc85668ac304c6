"""`tactorch invert`."""

from pathlib import Path

from omegaconf import DictConfig

from tactorch.cli.report import write_outputs
from tactorch.cli.resume import CHECKPOINT, checkpoint_of
from tactorch.cli.settings import folder, inversion_of, plain
from tactorch.inverse import Reconstruction, invert
from tactorch.recording import Recording


def run(cfg: DictConfig) -> Reconstruction:
    """Invert a recording and write everything about it."""
    path = cfg.recording
    return invert_recording(cfg, Recording.load(path), str(path))


def invert_recording(cfg: DictConfig, recording: Recording, source: str) -> Reconstruction:
    """Invert as the settings say; results go to the run's folder."""
    out = folder()
    reconstruction = invert(
        recording,
        inversion_of(cfg),
        start_mpa=cfg.start_mpa,
        checkpoint=out / CHECKPOINT,
        resume=None if cfg.resume is None else checkpoint_of(cfg.resume),
    )
    others = [Path(other) for other in plain(cfg.compare)]
    write_outputs(out, recording, reconstruction, source=source, compare=others, plots=cfg.plots)
    return reconstruction
