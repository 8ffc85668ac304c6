"""Settings that commands share, and the objects of the library that they describe."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from hydra.core.hydra_config import HydraConfig

from tactorch.config import Options, option, settings_of, to_mapping
from tactorch.inverse import Settings, Start, homogeneous
from tactorch.inverse.fit.starts import Uniform
from tactorch.recording import MaterialSpec, Recording

T = TypeVar("T", bound=Options)


@dataclass(frozen=True, kw_only=True)
class CommandOptions(Options):
    """Settings of every command."""

    run_dir: str = option(
        "outputs/${hydra:job.name}/${now:%Y-%m-%d_%H-%M-%S}", "Folder of the results and the log"
    )
    overwrite: bool = option(False, "Replace results and files that exist")


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
