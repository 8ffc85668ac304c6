"""`tactorch find`: inclusions under the presses of an earlier run, and what shape they have.

    tactorch find runs/gauss_newton
    tactorch find run=runs/gauss_newton max_lumps=2
    tactorch find runs/gauss_newton recognizer=runs/recognizer

Inclusions are fitted to the presses of a run, as by `tactorch invert method=inclusions`, and become
the result of the run, whose element map is kept beside them. A run that has inclusions keeps them.
With a recognizer the shapes that it knows are named, in finding.txt and finding.json too.
"""

from dataclasses import dataclass, replace
from pathlib import Path

from tactorch.cli.console import log
from tactorch.cli.outputs import remove_derived, write_outputs
from tactorch.cli.report import with_settings
from tactorch.cli.settings import CommandOptions, UnitCheck
from tactorch.config import option
from tactorch.errors import FileError
from tactorch.files import write_file, write_json
from tactorch.inverse import Reconstruction, invert, settings_from
from tactorch.inverse.result.text import describe
from tactorch.report import Run, load_run


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
    max_lumps: int = option(4, "Largest number of inclusions", ge=1)
    plots: bool = option(True, "Draw slices.png")


def run(options: FindOptions) -> Reconstruction:
    """Find the inclusions of a run."""
    found = load_run(options.run, recording=options.recording, check_units=options.check_units)
    if found.recording is None:
        raise FileError(
            f"{found.missing} Give recording=FILE.h5: inclusions are fitted to its presses."
        )
    network = None if options.recognizer is None else _load(options.recognizer)
    result = found.result
    if result.shapes is None:
        result = _search(with_settings(found), options.max_lumps)
        source = str(options.recording or found.summary["recording"])
        remove_derived(options.run)
        write_outputs(options.run, found.recording, result, source=source, plots=options.plots)
    else:
        log.info("The result has inclusions already: %s", describe(result))
    if network is not None:
        _recognise(network, result, options.run)
    return result


def _search(run: Run, max_lumps: int) -> Reconstruction:
    """Return the inclusions of a run, with its element map."""
    assert run.recording is not None
    log.info("Fitting inclusions to the presses ...")
    settings = run.settings or settings_from(run.result.config)
    settings = replace(settings, method="inclusions")
    found = invert(run.recording, settings, max_shapes=max_lumps)
    return replace(found, other=run.result)


def _load(path: Path) -> object:
    from tactorch.learning.recognizer import load_recognizer

    return load_recognizer(str(path))


def _recognise(network: object, result: Reconstruction, out: Path) -> None:
    """Add the probabilities of the shapes that a recognizer knows to the finding."""
    from tactorch.learning.recognizer import recognise

    shares = recognise(result.mesh, result.youngs, network)  # type: ignore[arg-type]
    text = ", ".join(f"{name} {share:.0%}" for name, share in shares.items())
    text = f"Of the shapes that the recognizer knows it looks like: {text}."
    write_json(out / "finding.json", {**result.plain(), "shapes": shares})
    write_file(out / "finding.txt", f"{describe(result)}\n{text}\n")
    log.info("%s", text)
