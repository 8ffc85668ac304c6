"""From the options of a command to the objects of the library."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydra.core.hydra_config import HydraConfig

from tactorch.cli.logs import log as log
from tactorch.config import settings_of, to_mapping
from tactorch.inverse import Settings, Start, homogeneous
from tactorch.inverse.starts import Uniform
from tactorch.recording import MaterialSpec, Recording

if TYPE_CHECKING:
    from tactorch.cli.invert import InversionOptions


def run_folder() -> Path:
    """Return the folder of this run."""
    return Path(HydraConfig.get().runtime.output_dir)


def material_spec(material: Any) -> MaterialSpec:
    """Return the description of a material that a recording stores."""
    from tactorch.fem import MATERIALS

    parameters = to_mapping(material)
    poisson = parameters.pop("poisson")
    return MaterialSpec(MATERIALS.name_of(type(material)), poisson, parameters)


def inversion_settings(options: Settings) -> Settings:
    """Return the settings of an inversion among those of a command."""
    return Settings(**{s.name: getattr(options, s.name) for s in settings_of(Settings)})


def make_start(
    options: "InversionOptions", settings: Settings, recording: Recording
) -> tuple[Start, Settings]:
    """Return the start of an inversion, and its settings.

    The map of a surrogate may be the mean of the prior.
    """
    start = options.initialization
    if isinstance(start, Uniform):
        return homogeneous if isinstance(start.start_mpa, str) else start.start_mpa, settings
    if not hasattr(start, "with_prior_mean"):
        return start, settings
    if options.resume is None:
        start.network  # noqa: B018  (weights that cannot be used are reported at once)
    return start, start.with_prior_mean(settings, recording)
