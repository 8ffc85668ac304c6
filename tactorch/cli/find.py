"""`tactorch find`: lumps under the presses of a run: depth, size, modulus and probability.

    tactorch find runs/gauss_newton
    tactorch find run=runs/gauss_newton shapes=false uncertainty=false
    tactorch find runs/gauss_newton recognizer=runs/recognizer

Inclusions with sharp boundaries are fitted to the presses, as many as their evidence supports. With
shapes=false the lumps are regions of the run's map. The text is printed, and written with its
numbers to finding.txt and finding.json in the run's folder; the shapes are written to shapes.json,
which `tactorch report` reads, and drawn in shapes.png beside the map.
"""

from dataclasses import dataclass
from pathlib import Path

from tactorch.cli.console import log
from tactorch.cli.report import with_settings
from tactorch.cli.settings import CommandOptions, UnitCheck
from tactorch.config import option
from tactorch.errors import ConfigError, ConvergenceError, FileError
from tactorch.files import write_file, write_json
from tactorch.findings import Finding, build_finding, build_shape_finding
from tactorch.inverse import find_shapes, settings_from
from tactorch.recording import Recording
from tactorch.report import SHAPES, Run, load_run
from tactorch.uncertainty import GaussianPosterior, compute_posterior
from tactorch.uncertainty.select import UNCOMPUTABLE


@dataclass(frozen=True, kw_only=True)
class FindOptions(UnitCheck, CommandOptions):
    """Settings of the command."""

    run: Path = option(help="Folder of an inversion")
    recording: Path | None = option(
        None, "Recording that was inverted, where it is not the file that the run names"
    )
    recognizer: Path | None = option(
        None, "Run of tactorch train experiment=recognizer, to name the shape"
    )
    shapes: bool = option(
        True, "Fit inclusions with sharp boundaries; false: lumps are regions of the map"
    )
    uncertainty: bool = option(
        True, "Compute the confidence in regions of the map: solves the presses again"
    )
    max_lumps: int = option(5, "Largest number of lumps", ge=1)
    plots: bool = option(True, "Draw shapes.png")
    out: Path | None = option(None, "Folder of finding.txt and finding.json; null: the run's")


def run(options: FindOptions) -> Finding:
    """Describe the lumps in a run's map."""
    folder = options.run
    inverted = load_run(
        folder, recording=options.recording, check_units=options.check_units, shapes=False
    )
    if inverted.recording is None:
        raise FileError(
            f"{inverted.missing} Give recording=FILE.h5: depths are measured from its presses."
        )
    out, youngs = options.out or folder, inverted.result.youngs
    for name in (SHAPES, "shapes.png"):  # of an earlier search: the report would show it
        (out / name).unlink(missing_ok=True)
    finding = _find_shapes(inverted, inverted.recording, options, out) if options.shapes else None
    if finding is None:
        finding = _find_regions(inverted, inverted.recording, options)
    values, text = finding.plain(), finding.text()
    if options.recognizer is not None:
        from tactorch.findings.recognition import load_recognizer, recognise

        network = load_recognizer(str(options.recognizer))
        probabilities = recognise(inverted.result.mesh, youngs, network)
        values["shapes"] = probabilities
        shapes = ", ".join(f"{name} {share:.0%}" for name, share in probabilities.items())
        text += f"\nOf the shapes that the recognizer knows it looks like: {shapes}."
    write_json(out / "finding.json", values)
    write_file(out / "finding.txt", f"{text}\n")
    log.info("%s", text)
    return finding


def _find_shapes(run: Run, recording: Recording, options: FindOptions, out: Path) -> Finding | None:
    """Fit shapes to the presses; None, with the reason in the log, where this fails."""
    log.info("Fitting inclusions to the presses ...")
    try:
        settings = with_settings(run).settings or settings_from(run.result.config)
        shapes = find_shapes(recording, settings, max_shapes=options.max_lumps)
    except (ConfigError, ConvergenceError) as error:
        log.warning("no shapes can be fitted, lumps are regions of the map: %s", error)
        return None
    write_json(out / SHAPES, shapes.plain())
    if options.plots:
        from tactorch.viz import save_figure, shape_figure

        figure = shape_figure(
            recording.mesh, shapes, youngs=run.result.youngs, truth=recording.truth
        )
        log.info("picture: %s", save_figure(figure, out / "shapes.png"))
    return build_shape_finding(recording, shapes)


def _find_regions(run: Run, recording: Recording, options: FindOptions) -> Finding:
    posterior = _posterior(run, recording) if options.uncertainty else None
    return build_finding(
        recording, run.result.youngs, posterior,
        max_lumps=options.max_lumps, reasons=run.result.warnings,
    )  # fmt: skip


def _posterior(run: Run, recording: Recording) -> GaussianPosterior | None:
    """Return the posterior of the map; None, with the reason in the log, where it has none."""
    try:
        settings = with_settings(run).settings or settings_from(run.result.config)
        return compute_posterior(recording, run.result, settings)
    except UNCOMPUTABLE as error:
        reason = str(error) or "not enough memory"
        log.warning("the confidence cannot be computed: %s", reason)
        return None
