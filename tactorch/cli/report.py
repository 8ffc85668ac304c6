"""`tactorch report`."""

from pathlib import Path

from omegaconf import DictConfig

from tactorch.cli.progress import progress
from tactorch.cli.runs import with_settings
from tactorch.cli.settings import log, plain
from tactorch.errors import ConfigError
from tactorch.report import load_run, run_names, write_report


def run(cfg: DictConfig) -> Path:
    """Write the report of one run, or of several side by side."""
    folders = [Path(str(folder)) for folder in (cfg.run, *plain(cfg.compare))]
    if len({folder.resolve() for folder in folders}) < len(folders):
        raise ConfigError("compare: a run is named twice; give each run once.")
    runs = [
        load_run(
            folder,
            name=name,
            recording=cfg.recording if folder is folders[0] else None,
            check_units=cfg.check_units,
        )
        for folder, name in zip(folders, run_names(folders), strict=True)
    ]
    for one in runs:
        if one.missing:
            log.warning(
                "%s: the report omits truth, presses and uncertainty: %s Give recording=FILE.h5 if"
                " the recording was moved.",
                one.name,
                one.missing,
            )
    runs = [with_settings(one) for one in runs]
    solved = [one for one in runs if one.recording is not None]
    if cfg.uncertainty and solved:
        log.info(
            "Solving the presses again for the uncertainty of the map (%s elements); "
            "uncertainty=false skips this step.",
            " and ".join(f"{one.result.mesh.n_tets:,}" for one in solved),
        )
    out = folders[0] / "report.html" if cfg.out is None else Path(str(cfg.out))
    with progress("uncertainty", "steps") as update:
        done = -1

        def advance(what: str, step: int, steps: int) -> None:
            nonlocal done
            done += step == 0
            update(done * steps + step, len(solved) * steps, f", {what}")

        write_report(
            runs, out, uncertainty=cfg.uncertainty, colours=str(cfg.colours), progress=advance
        )
    log.info("report: %s (%.1f MB)", out, out.stat().st_size / 1e6)
    return out
