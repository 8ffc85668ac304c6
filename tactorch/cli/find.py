"""`tactorch find`: lumps in a map: depth, size, confidence and shape.

    tactorch find runs/gauss_newton
    tactorch find run=runs/gauss_newton uncertainty=false
    tactorch find runs/gauss_newton recognizer=runs/recognizer

The text is printed, and written with its numbers to finding.txt and finding.json in the run's
folder.
"""

from dataclasses import dataclass
from pathlib import Path

from tactorch.cli.options import CommandOptions, UnitCheck
from tactorch.cli.outputs import write_json
from tactorch.cli.runs import with_settings
from tactorch.cli.settings import log
from tactorch.config import option
from tactorch.errors import FileError
from tactorch.files import atomic_path
from tactorch.findings import Finding, build_finding
from tactorch.inverse import settings_from
from tactorch.recording import Recording
from tactorch.report import Run, load_run
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
    uncertainty: bool = option(True, "Compute the confidence in lumps: solves the presses again")
    max_lumps: int = option(5, "Largest number of lumps", ge=1)
    out: Path | None = option(None, "Folder of finding.txt and finding.json; null: the run's")


def run(options: FindOptions) -> Finding:
    """Describe the lumps in a run's map."""
    place = options.run
    found = load_run(
        place, name=place.name, recording=options.recording, check_units=options.check_units
    )
    if found.recording is None:
        raise FileError(
            f"{found.missing} Give recording=FILE.h5: depths are measured from its presses."
        )
    youngs = found.result.youngs
    posterior = _posterior(found, found.recording) if options.uncertainty else None
    finding = build_finding(found.recording, youngs, posterior, max_lumps=options.max_lumps)
    values, text = finding.plain(), finding.text()
    if options.recognizer is not None:
        from tactorch.findings.recognition import load_recognizer, recognise

        network = load_recognizer(str(options.recognizer))
        probabilities = recognise(found.result.mesh, youngs, network)
        values["shapes"] = probabilities
        named = ", ".join(f"{name} {share:.0%}" for name, share in probabilities.items())
        text += f"\nOf the shapes that the recognizer knows it looks like: {named}."
    out = options.out or place
    write_json(out / "finding.json", values)
    with atomic_path(out / "finding.txt") as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")
    log.info("%s", text)
    return finding


def _posterior(found: Run, recording: Recording) -> GaussianPosterior | None:
    """Return the posterior of the map; None, with the reason in the log, where it has none."""
    complete = with_settings(found)
    try:
        settings = complete.settings or settings_from(complete.result.config)
        return compute_posterior(recording, complete.result, settings)
    except UNCOMPUTABLE as error:
        reason = str(error) or "not enough memory"
        log.warning("the confidence cannot be computed: %s", reason)
        return None
