"""`tactorch invert`."""

from pathlib import Path

from omegaconf import DictConfig

from tactorch.cli.outputs import MADE_OF_RESULTS, RESULTS, histories_of, write_outputs
from tactorch.cli.resume import CHECKPOINT, checkpoint_of
from tactorch.cli.settings import folder, inversion_of, plain, start_of
from tactorch.inverse import Reconstruction, StopReason, invert
from tactorch.recording import Recording


def run(cfg: DictConfig) -> Reconstruction:
    """Invert a recording and write everything about it."""
    path = Path(str(cfg.recording))
    return invert_recording(cfg, Recording.load(path, check_units=cfg.check_units), path)


def invert_recording(cfg: DictConfig, recording: Recording, source: Path) -> Reconstruction:
    """Invert as the settings say; results go to the run's folder.

    Raises:
        KeyboardInterrupt: Ctrl-C ended the inversion; the results of its best map are written.
    """
    out, settings = folder(), inversion_of(cfg)
    others = histories_of([Path(str(run)) for run in plain(cfg.compare)], cfg.optimizer.name)
    start, settings = start_of(cfg, settings, recording)
    resume = None if cfg.resume is None else checkpoint_of(str(cfg.resume))
    _clear(out, resume)
    reconstruction = invert(
        recording,
        settings,
        start_mpa=start,
        checkpoint=out / CHECKPOINT,
        resume=resume,
    )
    named = str(source.resolve())
    write_outputs(out, recording, reconstruction, source=named, others=others, plots=cfg.plots)
    if reconstruction.stop_reason == StopReason.INTERRUPTED:
        raise KeyboardInterrupt
    return reconstruction


def _clear(out: Path, resume: Path | None) -> None:
    """Remove what an earlier run left: a killed run must not seem to have its results."""
    for name in (*RESULTS, *MADE_OF_RESULTS, CHECKPOINT):
        stale = out / name
        if resume is None or resume.resolve() != stale.resolve():
            stale.unlink(missing_ok=True)
