"""`tactorch find`: lumps under the presses of a run: depth, size, modulus and probability.

    tactorch find runs/gauss_newton
    tactorch find run=runs/gauss_newton shapes=false uncertainty=false
    tactorch find runs/gauss_newton recognizer=runs/recognizer

Inclusions with sharp boundaries are fitted to the presses, as many as their evidence supports, as
by `tactorch invert` after the inversion. With shapes=false the lumps are regions of the run's map.
The text is printed, and written with its numbers to finding.txt and finding.json in the run's
folder, whose summary is updated; the shapes are written to shapes.json, which `tactorch report`
reads, and drawn beside the map in shapes.png.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tactorch.cli.console import log
from tactorch.cli.outputs import write_summary
from tactorch.cli.report import with_settings
from tactorch.cli.settings import CommandOptions, UnitCheck
from tactorch.config import option
from tactorch.errors import FileError
from tactorch.files import write_file, write_json
from tactorch.findings import SHAPES, Finding, find
from tactorch.inverse import Reconstruction, Settings, ShapeReconstruction
from tactorch.recording import Recording
from tactorch.report import load_run

PICTURE = "shapes.png"


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
    finding = find_and_write(
        inverted.recording,
        inverted.result,
        with_settings(inverted).settings,
        options.out or folder,
        recognizer=options.recognizer,
        shapes=options.shapes,
        uncertainty=options.uncertainty,
        max_lumps=options.max_lumps,
        plots=options.plots,
    )
    if options.out is None and "recording" in inverted.summary:
        source = inverted.summary["recording"]
        write_summary(folder, inverted.recording, inverted.result, source=source, finding=finding)
    return finding


def find_and_write(
    recording: Recording,
    reconstruction: Reconstruction,
    settings: Settings | None,
    out: Path,
    *,
    recognizer: Path | None = None,
    plots: bool = True,
    **search: Any,
) -> Finding:
    """Find the lumps under the presses of an inversion, write and print them.

    Args:
        recording: The presses.
        reconstruction: Their map.
        settings: Settings of the inversion; None for those of the reconstruction.
        out: Folder of the files.
        recognizer: Run or checkpoint of a recognizer, to name the shape.
        plots: Whether shapes.png is drawn.
        search: Arguments of `tactorch.find`.
    """
    for name in (SHAPES, PICTURE):  # of an earlier search: the report would show it
        (out / name).unlink(missing_ok=True)
    if search.get("shapes", True):
        log.info("Fitting inclusions to the presses ...")
    finding = find(recording, reconstruction, settings, **search)
    if finding.shapes is not None:
        write_json(out / SHAPES, finding.shapes.plain())
        if plots:
            _draw(recording, reconstruction, finding.shapes, out / PICTURE)
    values, text = finding.plain(), finding.text()
    if recognizer is not None:
        values["shapes"], sentence = _recognise(recognizer, reconstruction)
        text += f"\n{sentence}"
    write_json(out / "finding.json", values)
    write_file(out / "finding.txt", f"{text}\n")
    log.info("%s", text)
    return finding


def _draw(
    recording: Recording, reconstruction: Reconstruction, shapes: ShapeReconstruction, path: Path
) -> None:
    from tactorch.viz import save_figure, shape_figure

    figure = shape_figure(
        recording.mesh, shapes, youngs=reconstruction.youngs, truth=recording.truth
    )
    log.info("picture: %s", save_figure(figure, path))


def _recognise(recognizer: Path, result: Reconstruction) -> tuple[dict[str, float], str]:
    """Return the probabilities of the shapes that a recognizer knows, also as a sentence."""
    from tactorch.findings.recognition import load_recognizer, recognise

    probabilities = recognise(result.mesh, result.youngs, load_recognizer(str(recognizer)))
    shares = ", ".join(f"{name} {share:.0%}" for name, share in probabilities.items())
    return probabilities, f"Of the shapes that the recognizer knows it looks like: {shares}."
