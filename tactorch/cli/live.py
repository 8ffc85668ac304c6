"""`tactorch live`: follow a growing recording: map and lumps, and where to press next.

    tactorch live recording=session.h5
    tactorch live recording=FOLDER idle_seconds=60
    tactorch live recording=session.h5 run_dir=runs/session     again, to continue it
    tactorch live replay=FILE.h5                                no robot: replays a recording
    tactorch live presser=simulated stop.width_mm=1             a simulated robot presses by itself
    tactorch live presser=mylab.robot:MyRobot robot.mesh=body.vtu      your robot

Append presses with tactorch.recording.append_press. Open live.html in the run folder: it updates
itself. An element map is updated after each press. While no press waits, inclusions with sharp
boundaries are fitted to all presses (not with method=map). The folder also gets live.png,
reconstruction.h5, shapes.json and history.jsonl. With a robot the loop is
closed: it presses where the position of the lump becomes most certain, until that is known as well
as stop.width_mm states, or nothing was found.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from threading import Event, Thread
from typing import Any, Literal

from tactorch.cli.console import log, log_text
from tactorch.cli.live_view import Screen, finding_text
from tactorch.cli.outputs import score_table
from tactorch.cli.robot import RobotOptions, make_session
from tactorch.cli.settings import CommandOptions, UnitCheck, run_folder, select
from tactorch.config import option
from tactorch.errors import ConfigError, TactorchError
from tactorch.inverse import Settings, Start, homogeneous
from tactorch.inverse.fit.starts import START_MPA, Uniform
from tactorch.recording import Recording
from tactorch.report.live import PAGE
from tactorch.robot import PRESSERS, StopRule, press_until_known  # noqa: F401
from tactorch.robot.simulated import NoRobot
from tactorch.sampling import (
    LoopOptions,
    LoopResult,
    LumpPosition,
    RecordingSource,
    SamplingLoop,
    Suggester,
    SuggestOptions,
)
from tactorch.sampling.rules import Automatic
from tactorch.sampling.sources import replay


@dataclass(frozen=True, kw_only=True)
class LiveOptions(LoopOptions, Settings, UnitCheck, CommandOptions):
    """Settings of the command."""

    recording: Path | None = option(
        None, "File (.h5) that presses are appended to, or a folder of such files"
    )
    patience_seconds: float = option(
        5.0, "Time after which an unreadable file is reported", unit="s", ge=0
    )
    suggest: SuggestOptions = option(factory=SuggestOptions, help="Suggestion of the next press")
    replay: Path | None = option(
        None, "Whole recording to replay into `recording` press by press, to try without a robot"
    )
    pause_seconds: float = option(4.0, "Pause between replayed presses", unit="s", ge=0)
    presser: Any = option(
        factory=NoRobot, help="Robot that presses by itself, in a closed loop", section="presser"
    )
    robot: RobotOptions = option(factory=RobotOptions, help="Object and presses of the robot")
    stop: StopRule = option(factory=StopRule, help="When a robot has pressed enough")
    # The setting of initialization=uniform.
    start_mpa: float | Literal["homogeneous"] = field(
        default=START_MPA, metadata=fields(Uniform)[0].metadata
    )
    plots: bool = option(True, "Draw live.png")


def run(options: LiveOptions) -> LoopResult:
    """Follow a recording; Ctrl-C ends the run and keeps its results."""
    if not isinstance(options.presser, NoRobot):
        return _report(_run_robot(options))
    out, settings = run_folder(), select(options, Settings)
    replayed = None if options.replay is None else Recording.load(options.replay)
    path = options.recording or out / "recording.h5"
    if options.recording is None and options.replay is None:
        raise ConfigError(
            "'recording' is missing; give recording=FILE.h5 or a folder, or replay=FILE.h5 to "
            "replay a whole recording (see tactorch live --help)."
        )
    loop, whole = select(options, LoopOptions), 0
    if replayed is not None and loop.max_presses is None:
        whole = len(replayed.presses)
        loop = replace(loop, max_presses=whole)
    start: Start = homogeneous if isinstance(options.start_mpa, str) else options.start_mpa
    with (
        Screen(out, path, plots=options.plots, name=(options.replay or path).name) as screen,
        _replaying(replayed, path, options.pause_seconds, screen),
    ):
        source = RecordingSource(
            path,
            patience_seconds=options.patience_seconds,
            check_units=options.check_units,
            report=screen.show_message,
        )
        suggester = Suggester(settings, options.suggest)
        result = SamplingLoop(
            source, settings, out, screen, options=loop, suggester=suggester, start_mpa=start
        ).run()
        if whole and result.update and len(result.update.recording.presses) == whole:
            result = replace(
                result, reason=f"all {whole} presses of {options.replay} were replayed"
            )
        screen.ended(result)
    return _report(result)


def _run_robot(options: LiveOptions) -> LoopResult:
    """Press with a robot until the stop rule is met."""
    if options.recording is not None or options.replay is not None:
        raise ConfigError(
            "presser= makes its own recording in the run folder; leave out recording= and replay=, "
            "and give run_dir= to continue a run."
        )
    out, settings = run_folder(), select(options, Settings)
    suggest, path = options.suggest, out / "recording.h5"
    if isinstance(suggest.rule, Automatic):
        suggest = replace(suggest, rule=LumpPosition())
    with Screen(out, path, plots=options.plots) as screen:
        session, draft = make_session(options.presser, options.robot, options.stop, out, screen)
        settings, loop = replace(settings, method="inclusions"), select(options, LoopOptions)
        result = press_until_known(session, settings, options=loop, suggest=suggest, draft=draft)
        screen.ended(result)
    for place, reason in session.failed.items():
        log.info("failed: candidate %d (%s)", place, reason)
    return result


def _report(result: LoopResult) -> LoopResult:
    """Log the end, the finding and the scores."""
    log.info("The run ended: %s.", result.reason)
    update = result.update
    if update is not None:
        log.info("%s", finding_text(update))
        if update.recording.truth is not None:
            log_text(score_table(update.recording, update.result)[1])
    log.info("results: %s", run_folder() / PAGE)
    return result


@contextmanager
def _replaying(
    recording: Recording | None, path: Path, pause_seconds: float, screen: Screen
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
            replay(recording, path, pause_seconds, stop)
        except TactorchError as error:
            screen.show_message(f"the replay failed: {error}")

    thread = Thread(target=play, daemon=True)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()
