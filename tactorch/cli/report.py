"""`tactorch report`: one HTML file with the results of a run, or of several side by side.

    tactorch report runs/gauss_newton
    tactorch report runs/gauss_newton runs/tnc            side by side
    tactorch report sweep                                  all inversions in a folder
    tactorch report run=runs/gauss_newton uncertainty=false out=quick.html
    tactorch report run=RUN recording=FILE.h5             where the recording was moved

The file needs no server and no network: slices to scrub through, a 3-D view that turns, credibility
and uncertainty, observed and predicted presses, settings. It can be printed.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from tactorch.cli.console import log, progress
from tactorch.cli.existing import check_file
from tactorch.cli.resume import saved_options
from tactorch.cli.settings import CommandOptions, UnitCheck, make_start, run_folder
from tactorch.config import option, to_mapping
from tactorch.errors import ConfigError, TactorchError
from tactorch.inverse.fit.settings import has_all_settings
from tactorch.report import Run, load_run, run_names, runs_in, write_report
from tactorch.report.assessment import is_solved_again


@dataclass(frozen=True, kw_only=True)
class ReportOptions(UnitCheck, CommandOptions):
    """Settings of the command."""

    run: Path = option(help="Folder of an inversion, or of several, as of a sweep")
    compare: tuple[Path, ...] = option((), "Folders of other inversions, shown side by side")
    recording: Path | None = option(
        None, "Recording that `run` inverted, where it is not the file that the run names"
    )
    out: Path | None = option(
        None,
        "File to write; null: report.html in the folder `run`, or with `compare` comparison.html in"
        " run_dir",
    )
    uncertainty: bool = option(True, "Credibility and posterior: solves the presses again")
    colours: Literal["viridis", "cividis", "ultrasound"] = option(
        "viridis", "Colour map; ultrasound is grey, and the page can switch"
    )


def run(options: ReportOptions) -> Path:
    """Write the report of a run, or of several side by side."""
    folders = [run for folder in (options.run, *options.compare) for run in runs_in(folder)]
    if len({folder.resolve() for folder in folders}) < len(folders):
        raise ConfigError("compare: a run is named twice; give each run once.")
    default = run_folder() / "comparison.html" if options.compare else options.run / "report.html"
    out = options.out or default
    runs = []
    for folder, name in zip(folders, run_names(folders), strict=True):
        moved = options.recording if folder is folders[0] else None
        run = load_run(folder, name=name, recording=moved, check_units=options.check_units)
        if run.missing:
            lacks = "the report lacks truth, presses and uncertainty"
            log.warning(
                "%s: %s: %s Give recording=FILE.h5 if it was moved.", run.name, lacks, run.missing
            )
        runs.append(run)
    if options.out is None:
        check_file(out, options.overwrite)
    runs = [with_settings(run) for run in runs]
    complete = [run for run in runs if is_solved_again(run)]
    if options.uncertainty and complete:
        log.info(
            "Solving the presses again for the uncertainty of the map (%s elements); "
            "uncertainty=false leaves it out.",
            " and ".join(f"{run.result.mesh.n_tets:,}" for run in complete),
        )
    with progress("uncertainty", "steps") as update:
        done = -1

        def on_step(name: str, step: int, steps: int) -> None:
            nonlocal done
            done += step == 0
            update(done * steps + step, len(complete) * steps, f", {name}")

        write_report(
            runs, out, uncertainty=options.uncertainty, colours=options.colours, progress=on_step
        )
    log.info("report: %s (%.1f MB)", out, out.stat().st_size / 1e6)
    return out


def with_settings(run: Run) -> Run:
    """Return a run with its settings; a prior about a surrogate's map is predicted again."""
    path = run.folder / ".hydra" / "config.yaml"
    if has_all_settings(run.result.config) or run.recording is None or not path.is_file():
        return run
    try:
        settings = make_start(saved_options("invert", run.folder), run.recording)[1]
    except TactorchError as error:
        log.warning("%s: the settings in '%s' cannot be used (%s)", run.name, path, error)
        return run
    prior = to_mapping(settings)["regularization"]
    if prior != run.result.config["settings"]["regularization"]:
        log.warning("%s: the surrogate predicts another map than it did for this run", run.name)
        return run
    return replace(run, settings=settings)
