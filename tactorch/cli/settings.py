"""Settings that commands share, and the objects of the library that they describe."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from hydra.core.hydra_config import HydraConfig

from tactorch.cli.console import log
from tactorch.cli.resume import saved_options
from tactorch.config import Options, option, settings_of, to_mapping
from tactorch.errors import TactorchError
from tactorch.inverse import Settings, Start, homogeneous
from tactorch.inverse.settings import has_all_settings, stored_settings
from tactorch.inverse.starts import Uniform
from tactorch.recording import MaterialSpec, Recording
from tactorch.report import Run

T = TypeVar("T", bound=Options)


@dataclass(frozen=True, kw_only=True)
class CommandOptions(Options):
    """Settings of every command."""

    run_dir: str = option(
        "outputs/${hydra:job.name}/${now:%Y-%m-%d_%H-%M-%S}", "Folder of the results and the log"
    )


@dataclass(frozen=True, kw_only=True)
class UnitCheck(Options):
    """Setting of the commands that read files with numbers."""

    check_units: bool = option(True, "Refuse numbers that look like another unit")


def run_folder() -> Path:
    """Return the folder of this run."""
    return Path(HydraConfig.get().runtime.output_dir)


def select(options: Any, kind: type[T], **changes: Any) -> T:
    """Return the settings of a kind among those of a command, with changes."""
    names = (s.name for s in settings_of(kind) if hasattr(options, s.name))
    return kind(**{name: getattr(options, name) for name in names} | changes)


def material_spec(material: Any) -> MaterialSpec:
    """Return the description of a material that a recording stores."""
    from tactorch.fem import MATERIALS

    parameters = to_mapping(material)
    poisson = parameters.pop("poisson")
    return MaterialSpec(MATERIALS.name_of(type(material)), poisson, parameters)


def make_start(options: Any, recording: Recording) -> tuple[Start, Settings]:
    """Return the start of an inversion, and its settings.

    The map of a surrogate may be the mean of the prior.
    """
    start, settings = options.initialization, select(options, Settings)
    if isinstance(start, Uniform):
        return homogeneous if isinstance(start.start_mpa, str) else start.start_mpa, settings
    if not hasattr(start, "with_prior_mean"):
        return start, settings
    if options.resume is None:
        start.network  # noqa: B018  (weights that cannot be used are reported at once)
    return start, start.with_prior_mean(settings, recording)


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
    prior = stored_settings(settings)["regularization"]
    if prior != run.result.config["settings"]["regularization"]:
        log.warning("%s: the surrogate predicts another map than it did for this run", run.name)
        return run
    return replace(run, settings=settings)
