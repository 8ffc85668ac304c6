"""`tactorch find`."""

from pathlib import Path

from omegaconf import DictConfig

from tactorch.cli.outputs import write_json
from tactorch.cli.runs import with_settings
from tactorch.cli.settings import log
from tactorch.errors import FileError
from tactorch.files import atomic_path
from tactorch.findings import Finding, build_finding
from tactorch.inverse import settings_from
from tactorch.recording import Recording
from tactorch.report import Run, load_run
from tactorch.uncertainty import GaussianPosterior, compute_posterior
from tactorch.uncertainty.select import UNCOMPUTABLE


def run(cfg: DictConfig) -> Finding:
    """Tell what a run's map shows: lumps, how deep, how sure, of which shape."""
    place = Path(str(cfg.run))
    found = load_run(place, name=place.name, recording=cfg.recording, check_units=cfg.check_units)
    if found.recording is None:
        raise FileError(
            f"{found.missing} Give recording=FILE.h5: depths are told from its presses."
        )
    youngs = found.result.youngs
    posterior = _posterior(found, found.recording) if cfg.uncertainty else None
    finding = build_finding(found.recording, youngs, posterior, max_lumps=cfg.max_lumps)
    values, text = finding.plain(), finding.text()
    if cfg.recognizer is not None:
        from tactorch.findings.recognition import load_recognizer, recognise

        chances = recognise(found.result.mesh, youngs, load_recognizer(str(cfg.recognizer)))
        values["shapes"] = chances
        named = ", ".join(f"{name} {chance:.0%}" for name, chance in chances.items())
        text += f"\nOf the shapes that the recognizer knows it looks like: {named}."
    out = place if cfg.out is None else Path(str(cfg.out))
    write_json(out / "finding.json", values)
    with atomic_path(out / "finding.txt") as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")
    log.info("%s", text)
    return finding


def _posterior(found: Run, recording: Recording) -> GaussianPosterior | None:
    """How far to trust the map; None, with the reason in the log, where that cannot be told."""
    complete = with_settings(found)
    try:
        settings = complete.settings or settings_from(complete.result.config)
        return compute_posterior(recording, complete.result, settings)
    except UNCOMPUTABLE as error:
        reason = str(error) or "the memory does not suffice"
        log.warning("how sure it is cannot be told: %s", reason)
        return None
