"""Runs of `tactorch invert` as input of other commands, with all their settings."""

from dataclasses import replace

from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from tactorch.cli.settings import inversion_of, log, start_of
from tactorch.errors import TactorchError
from tactorch.inverse import has_all_settings
from tactorch.inverse.settings import stored_settings
from tactorch.report import Run


def with_settings(run: Run) -> Run:
    """Return a run with all settings, predicting the map of a surrogate prior again if needed."""
    path = run.folder / ".hydra" / "config.yaml"
    if has_all_settings(run.result.config) or run.recording is None or not path.is_file():
        return run
    try:
        cfg = OmegaConf.load(path)
        assert isinstance(cfg, DictConfig)
        settings = start_of(cfg, inversion_of(cfg), run.recording)[1]
    except (OmegaConfBaseException, TactorchError, YAMLError) as error:
        log.warning("%s: the settings in '%s' cannot be used (%s)", run.name, path, error)
        return run
    if (
        stored_settings(settings)["regularization"]
        != run.result.config["settings"]["regularization"]
    ):
        log.warning(
            "%s: the surrogate predicts a map that differs from the prior of this run", run.name
        )
        return run
    return replace(run, settings=settings)
