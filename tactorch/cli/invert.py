"""`tactorch invert`: reconstruct the map of Young's modulus from a recording.

    tactorch invert recording=FILE.h5
    tactorch invert recording=FILE.h5 optimizer=tnc run_dir=runs/tnc
    tactorch invert recording=FILE.h5 compare=[runs/tnc] run_dir=runs/gauss_newton
    tactorch invert recording=FILE.h5 initialization=surrogate
    tactorch invert recording=FILE.h5 experiment=paper max_seconds=600
    tactorch invert recording=FILE.h5 nuisance.poisson=0.02 nuisance.rest_scale=0.1
    tactorch invert resume=runs/tnc
    tactorch invert -m recording=FILE.h5 regularization=total_variation,smoothness

Ctrl-C keeps the best map so far. The run folder gets reconstruction.h5 and .vtu, slices.png,
convergence.png, summary.json and summary.txt.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tactorch.cli.options import CommandOptions, UnitCheck
from tactorch.cli.outputs import DERIVED_RESULTS, RESULTS, read_histories, write_outputs
from tactorch.cli.resume import CHECKPOINT, checkpoint_of
from tactorch.cli.settings import inversion_settings, make_start, run_folder
from tactorch.config import option
from tactorch.inverse import OPTIMIZERS, Reconstruction, Settings, StopReason, invert
from tactorch.recording import Recording


@dataclass(frozen=True, kw_only=True)
class InversionOptions(Settings):
    """Settings of an inversion, its start and its outputs."""

    initialization: Any = option("uniform", "Start of the inversion", section="initialization")
    resume: Path | None = option(None, "Run folder to continue")
    compare: tuple[Path, ...] = option((), "Run folders whose convergence is drawn with this one's")
    plots: bool = option(True, "Draw slices.png and convergence.png")


@dataclass(frozen=True, kw_only=True)
class InvertOptions(InversionOptions, UnitCheck, CommandOptions):
    """Settings of the command."""

    recording: Path = option(help="Recording (.h5)")


def run(options: InvertOptions) -> Reconstruction:
    """Invert a recording and write its results."""
    recording = Recording.load(options.recording, check_units=options.check_units)
    return invert_recording(options, recording, options.recording)


def invert_recording(
    options: InversionOptions, recording: Recording, source: Path
) -> Reconstruction:
    """Invert a recording; results go to the run's folder.

    Args:
        options: Settings of the inversion.
        recording: The recording.
        source: File of the recording, for the summary.

    Raises:
        KeyboardInterrupt: Ctrl-C ended the inversion; the results of its best map are written.
    """
    out, settings = run_folder(), inversion_settings(options)
    others = read_histories(options.compare, OPTIMIZERS.name_of(type(settings.optimizer)))
    start, settings = make_start(options, settings, recording)
    resume = None if options.resume is None else checkpoint_of(options.resume)
    _remove_results(out, resume)
    reconstruction = invert(
        recording, settings, start_mpa=start, checkpoint=out / CHECKPOINT, resume=resume
    )
    path = str(source.resolve())
    write_outputs(out, recording, reconstruction, source=path, others=others, plots=options.plots)
    if reconstruction.stop_reason == StopReason.INTERRUPTED:
        raise KeyboardInterrupt
    return reconstruction


def _remove_results(out: Path, resume: Path | None) -> None:
    """Remove the results of an earlier run: a killed run must not seem to have them."""
    for name in (*RESULTS, *DERIVED_RESULTS, CHECKPOINT):
        stale = out / name
        if resume is None or resume.resolve() != stale.resolve():
            stale.unlink(missing_ok=True)
