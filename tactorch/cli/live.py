"""`tactorch live`."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Event, Thread

from omegaconf import DictConfig

from tactorch.cli.kinds import HOMOGENEOUS
from tactorch.cli.live_view import PAGE, Screen
from tactorch.cli.logs import tell
from tactorch.cli.settings import folder, inversion_of, log, plain
from tactorch.config import build, settings_of
from tactorch.errors import ConfigError, TactorchError
from tactorch.findings.text import summarize_inclusion
from tactorch.inverse import Start, homogeneous
from tactorch.recording import Recording
from tactorch.sampling import (
    LoopOptions,
    LoopResult,
    RecordingSource,
    SamplingLoop,
    Suggester,
    SuggestOptions,
    replay,
)


def run(cfg: DictConfig) -> LoopResult:
    """Follow a recording; Ctrl-C ends the run and keeps its results."""
    out, settings = folder(), inversion_of(cfg)
    for name in ("patience_seconds", "pause_seconds"):
        if cfg[name] < 0:
            raise ConfigError(f"{name}={cfg[name]}: give a time of at least 0 s.")
    options = LoopOptions(**{s.name: cfg[s.name] for s in settings_of(LoopOptions)})
    suggester = Suggester(settings, build(SuggestOptions, plain(cfg.suggest), "suggest"))
    replayed = None if cfg.replay is None else Recording.load(str(cfg.replay))
    path = _path(cfg, out)
    with Screen(out, path, plots=cfg.plots) as screen, _replaying(cfg, replayed, path, screen):
        source = RecordingSource(
            path,
            patience_seconds=cfg.patience_seconds,
            check_units=cfg.check_units,
            report=screen.show_message,
        )
        start: Start = homogeneous if cfg.start_mpa == HOMOGENEOUS else float(cfg.start_mpa)
        result = SamplingLoop.following(
            source, settings, out, screen, options=options, suggester=suggester, start_mpa=start
        ).run()
        screen.ended(result)
    _log_result(result, out)
    return result


def _path(cfg: DictConfig, out: Path) -> Path:
    """Path of the recording to follow."""
    if cfg.recording is not None:
        return Path(str(cfg.recording))
    if cfg.replay is None:
        raise ConfigError(
            "'recording' is missing; give recording=FILE.h5 or a folder, or replay=FILE.h5 to "
            "replay a whole recording (see tactorch live --help)."
        )
    return out / "recording.h5"


@contextmanager
def _replaying(
    cfg: DictConfig, recording: Recording | None, path: Path, screen: Screen
) -> Iterator[None]:
    """Replay a recording during the run, if one is given."""
    if recording is None:
        yield
        return
    if path.is_dir():
        raise ConfigError(
            f"recording={path} is a folder; give a file to replay the recording into."
        )
    stop = Event()

    def play() -> None:
        try:
            replay(recording, path, cfg.pause_seconds, stop)
        except TactorchError as error:
            screen.show_message(f"the replay failed: {error}")

    thread = Thread(target=play, daemon=True)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


def _log_result(result: LoopResult, out: Path) -> None:
    """Log how the run ended, the finding, and the scores if the truth is known."""
    logging.getLogger("tactorch").info("The run ended: %s.", result.reason)
    update = result.update
    if update is not None:
        log.info("%s", summarize_inclusion(update.lump, update.entry["youngs_median_mpa"]))
        if update.recording.truth is not None:
            from tactorch.cli.outputs import score_table

            table = score_table(update.recording, {"live": update.youngs}).table
            tell(table.text(), table)
    log.info("results: %s", out / PAGE)
