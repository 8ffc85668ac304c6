"""`tactorch live`."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Event, Thread

from omegaconf import DictConfig

from tactorch.cli.kinds import HOMOGENEOUS
from tactorch.cli.live_view import PAGE, Screen
from tactorch.cli.logs import log_text
from tactorch.cli.outputs import finding
from tactorch.cli.settings import build, folder, inversion_of, log, plain
from tactorch.errors import ConfigError, TactorchError
from tactorch.inverse import Start, homogeneous
from tactorch.recording import Recording
from tactorch.sampling.live import (
    Ended,
    Follower,
    FollowOptions,
    Source,
    Suggester,
    SuggestOptions,
    replay,
)

_OPTIONS = (
    "poll_seconds", "max_batch", "max_iterations", "update_seconds", "max_presses",
    "idle_seconds",
)  # fmt: skip


def run(cfg: DictConfig) -> Ended:
    """Follow a recording; Ctrl-C ends it, and what was found until then stays."""
    out, settings = folder(), inversion_of(cfg)
    for name in ("patience_seconds", "pause_seconds"):
        if cfg[name] < 0:
            raise ConfigError(f"{name}={cfg[name]}: give a time of at least 0 s.")
    options = FollowOptions(**{name: cfg[name] for name in _OPTIONS})
    suggester = Suggester(settings, build("suggest", SuggestOptions, plain(cfg.suggest)))
    played = None if cfg.replay is None else Recording.load(str(cfg.replay))
    path = _path(cfg, out)
    with Screen(out, path, plots=cfg.plots) as screen, _playing(cfg, played, path, screen):
        source = Source(
            path,
            patience_seconds=cfg.patience_seconds,
            check_units=cfg.check_units,
            tell=screen.show_message,
        )
        start: Start = homogeneous if cfg.start_mpa == HOMOGENEOUS else float(cfg.start_mpa)
        follower = Follower(
            source, settings, out, screen, options=options, suggester=suggester, start_mpa=start
        )
        ended = follower.run()
        screen.ended(ended)
    _say(ended, out)
    return ended


def _path(cfg: DictConfig, out: Path) -> Path:
    """What to follow."""
    if cfg.recording is not None:
        return Path(str(cfg.recording))
    if cfg.replay is None:
        raise ConfigError(
            "'recording' is missing; give recording=FILE.h5 or a folder, or replay=FILE.h5 to play "
            "a whole recording (see tactorch live --help)."
        )
    return out / "recording.h5"


@contextmanager
def _playing(
    cfg: DictConfig, recording: Recording | None, path: Path, screen: Screen
) -> Iterator[None]:
    """Play a recording beside the run, where that is asked for."""
    if recording is None:
        yield
        return
    if path.is_dir():
        raise ConfigError(f"recording={path} is a folder; a recording is played into a file.")
    stop = Event()

    def play() -> None:
        try:
            replay(recording, path, cfg.pause_seconds, stop)
        except TactorchError as error:
            screen.show_message(f"the replay has ended: {error}")

    thread = Thread(target=play, daemon=True)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


def _say(ended: Ended, out: Path) -> None:
    """A few last sentences."""
    logging.getLogger("tactorch").info("The run has ended: %s.", ended.reason)
    if ended.seen is not None:
        log.info("%s", finding(ended.seen.inclusion, ended.seen.entry["youngs_median_mpa"]))
        if ended.seen.recording.truth is not None:
            from tactorch.cli.outputs import score_table

            found = ended.seen.found.result.youngs
            table = score_table(ended.seen.recording, {"live": found}).table
            log_text(table.text(), table)
    log.info("results: %s", out / PAGE)
