"""`tactorch invert`: reconstruct the map of Young's modulus, and find inclusions.

    tactorch invert recording=FILE.h5
    tactorch invert recording=FILE.h5 optimizer=tnc run_dir=runs/tnc
    tactorch invert recording=FILE.h5 compare=[runs/tnc] run_dir=runs/gauss_newton
    tactorch invert recording=FILE.h5 initialization=surrogate find=false
    tactorch invert recording=FILE.h5 experiment=paper max_seconds=600
    tactorch invert recording=FILE.h5 nuisance.poisson=0.02 nuisance.rest_scale=0.1
    tactorch invert resume=runs/tnc
    tactorch invert -m recording=FILE.h5 regularization=total_variation,smoothness

Ctrl-C keeps the best map so far. The run folder gets reconstruction.h5 and .vtu, slices.png,
convergence.png, summary.json and summary.txt, and with find=true the files of `tactorch find`.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tactorch.cli.console import log
from tactorch.cli.find import find_and_write
from tactorch.cli.outputs import read_histories, remove_results, write_outputs, write_summary
from tactorch.cli.resume import CHECKPOINT
from tactorch.cli.settings import CommandOptions, UnitCheck, make_start, run_folder
from tactorch.config import option
from tactorch.findings import Finding
from tactorch.inverse import OPTIMIZERS, Reconstruction, Settings, StopReason, invert
from tactorch.recording import Recording


@dataclass(frozen=True, kw_only=True)
class InversionOptions(Settings):
    """Settings of an inversion, its start and its outputs."""

    initialization: Any = option("uniform", "Start of the inversion", section="initialization")
    resume: Path | None = option(None, "Run folder to continue")
    compare: tuple[Path, ...] = option((), "Run folders whose convergence is drawn with this one's")
    find: bool = option(
        True, "Fit inclusions to the presses after the inversion, as tactorch find does"
    )
    plots: bool = option(True, "Draw slices.png, convergence.png and shapes.png")


@dataclass(frozen=True, kw_only=True)
class InvertOptions(InversionOptions, UnitCheck, CommandOptions):
    """Settings of the command."""

    recording: Path = option(help="Recording (.h5)")


def run(options: InvertOptions) -> Reconstruction:
    """Invert a recording, find inclusions, and write the results to the run's folder."""
    out, path = run_folder(), options.recording
    recording = Recording.load(path, check_units=options.check_units)
    others = read_histories(options.compare, OPTIMIZERS.name_of(type(options.optimizer)))
    start, settings = make_start(options, recording)
    resume = None if options.resume is None else options.resume / CHECKPOINT
    remove_results(out, resume)
    checkpoint = out / CHECKPOINT
    result = invert(recording, settings, start_mpa=start, checkpoint=checkpoint, resume=resume)
    source = str(path.resolve())
    write_outputs(out, recording, result, source=source, others=others, plots=options.plots)
    if result.stop_reason == StopReason.INTERRUPTED:
        raise KeyboardInterrupt  # the results of the best map are written
    if options.find:
        finding = _find(recording, result, settings, out, plots=options.plots)
        write_summary(out, recording, result, source=source, finding=finding)
    return result


def _find(
    recording: Recording, result: Reconstruction, settings: Settings, out: Path, *, plots: bool
) -> Finding:
    """Find inclusions, see `find_and_write`; the map is complete before."""
    log.info("")
    try:
        return find_and_write(recording, result, settings, out, plots=plots)
    except KeyboardInterrupt:
        log.warning("The map is complete; tactorch find '%s' repeats the search.", out)
        raise
