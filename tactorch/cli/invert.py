"""`tactorch invert`: reconstruct Young's modulus inside an object, and the lumps in it.

    tactorch invert recording=FILE.h5
    tactorch invert recording=FILE.h5 method=map
    tactorch invert recording=FILE.h5 method=map optimizer=tnc run_dir=runs/tnc
    tactorch invert recording=FILE.h5 method=map compare=[runs/tnc] run_dir=runs/gauss_newton
    tactorch invert recording=FILE.h5 method=map initialization=surrogate
    tactorch invert recording=FILE.h5 experiment=paper max_seconds=600
    tactorch invert recording=FILE.h5 method=map nuisance.poisson=0.02 nuisance.rest_scale=0.1
    tactorch invert resume=runs/tnc
    tactorch invert -m recording=FILE.h5 method=map regularization=total_variation,smoothness

The field is described by inclusions in a background, or by one modulus per element (method=map),
as the presses support. The run folder gets reconstruction.h5 and .vtu, slices.png, summary.json and
.txt, finding.json and .txt, and of an element map convergence.png. Ctrl-C keeps the inclusions
accepted so far, or the best element map.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tactorch.cli.outputs import (
    read_histories,
    remove_results,
    with_uncertainty,
    write_outputs,
)
from tactorch.cli.resume import CHECKPOINT
from tactorch.cli.settings import CommandOptions, UnitCheck, make_start, run_folder
from tactorch.config import option
from tactorch.inverse import OPTIMIZERS, Reconstruction, Settings, StopReason, invert
from tactorch.recording import Recording


@dataclass(frozen=True, kw_only=True)
class InversionOptions(Settings):
    """Settings of an inversion, its start and its outputs."""

    initialization: Any = option("uniform", "Start of the element map", section="initialization")
    resume: Path | None = option(None, "Run folder to continue")
    compare: tuple[Path, ...] = option((), "Run folders whose convergence is drawn with this one's")
    max_lumps: int = option(4, "Largest number of inclusions", ge=1)
    uncertainty: bool = option(
        True, "Compute intervals of the lumps of an element map: solves the presses again"
    )
    plots: bool = option(True, "Draw slices.png and convergence.png")


@dataclass(frozen=True, kw_only=True)
class InvertOptions(InversionOptions, UnitCheck, CommandOptions):
    """Settings of the command."""

    recording: Path = option(help="Recording (.h5)")


def run(options: InvertOptions) -> Reconstruction:
    """Invert a recording, and write the result to the run's folder."""
    out, path = run_folder(), options.recording
    recording = Recording.load(path, check_units=options.check_units)
    others = read_histories(options.compare, OPTIMIZERS.name_of(type(options.optimizer)))
    start, settings = make_start(options, recording)
    resume = None if options.resume is None else options.resume / CHECKPOINT
    remove_results(out, resume)
    result = invert(
        recording, settings, start_mpa=start, checkpoint=out / CHECKPOINT, resume=resume,
        max_shapes=options.max_lumps,
    )  # fmt: skip
    is_interrupted = result.stop_reason == StopReason.INTERRUPTED
    if options.uncertainty and not is_interrupted:
        result = with_uncertainty(result, recording, settings)
    source = str(path.resolve())
    write_outputs(out, recording, result, source=source, others=others, plots=options.plots)
    if is_interrupted:
        raise KeyboardInterrupt  # the results of the best map are written
    return result
