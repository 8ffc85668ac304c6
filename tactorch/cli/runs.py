"""Settings of runs of `tactorch invert` that other commands read."""

from dataclasses import replace

from tactorch.cli.compose import saved_options
from tactorch.cli.settings import inversion_settings, log, make_start
from tactorch.errors import TactorchError
from tactorch.inverse.settings import has_all_settings, stored_settings
from tactorch.report import Run


def with_settings(run: Run) -> Run:
    """Return a run with its settings; a prior about a surrogate's map is predicted again."""
    path = run.folder / ".hydra" / "config.yaml"
    if has_all_settings(run.result.config) or run.recording is None or not path.is_file():
        return run
    try:
        options = saved_options("invert", run.folder)
        settings = make_start(options, inversion_settings(options), run.recording)[1]
    except TactorchError as error:
        log.warning("%s: the settings in '%s' cannot be used (%s)", run.name, path, error)
        return run
    prior = stored_settings(settings)["regularization"]
    if prior != run.result.config["settings"]["regularization"]:
        log.warning("%s: the surrogate predicts another map than it did for this run", run.name)
        return run
    return replace(run, settings=settings)
