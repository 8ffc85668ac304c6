"""From Hydra's settings to the objects of the library."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from tactorch.cli.kinds import HOMOGENEOUS
from tactorch.cli.logs import log as log
from tactorch.errors import ConfigError
from tactorch.inverse import (
    OPTIMIZERS,
    PRIORS,
    Bounds,
    NoiseModel,
    NuisancePrior,
    Settings,
    Start,
    homogeneous,
)
from tactorch.phantoms import Phantom, make_phantom
from tactorch.recording import MaterialSpec, Recording
from tactorch.simulation import PressPlan

_T = TypeVar("_T")


def plain(node: Any) -> Any:
    """Return a part of the settings as plain Python values.

    Raises:
        ConfigError: a value is missing or an interpolation cannot be resolved.
    """
    try:
        return OmegaConf.to_container(node, resolve=True, throw_on_missing=True)
    except OmegaConfBaseException as error:
        raise ConfigError(f"settings: {error}") from error


def folder() -> Path:
    """Return the folder of this run."""
    return Path(HydraConfig.get().runtime.output_dir)


def phantom_of(cfg: DictConfig) -> Phantom:
    """Make the phantom."""
    return build("phantom", make_phantom, plain(cfg.phantom))


def plan_of(cfg: DictConfig) -> PressPlan:
    """Make the plan of presses."""
    return build("press", PressPlan, plain(cfg.press))


def material_of(cfg: DictConfig) -> MaterialSpec:
    """Make the material's description."""
    settings = plain(cfg.material)
    settings["parameters"] = settings["parameters"] or {}
    return build("material", MaterialSpec, settings)


def inversion_of(cfg: DictConfig) -> Settings:
    """Make the settings of an inversion."""
    return Settings(
        optimizer=OPTIMIZERS.build(plain(cfg.optimizer)),
        parameterization=cfg.parameterization.name,
        regularization=PRIORS.build(plain(cfg.regularization)),
        bounds=build("bounds", Bounds, plain(cfg.bounds)),
        noise=build("noise", NoiseModel, plain(cfg.noise)),
        misfit=cfg.misfit,
        model_error=cfg.model_error,
        residual_model_error_fraction=cfg.residual_model_error_fraction,
        nuisance=build("nuisance", NuisancePrior, plain(cfg.nuisance)),
        element=cfg.element,
        solver=cfg.solver.name,
        max_seconds=cfg.max_seconds,
    )


def start_of(cfg: DictConfig, settings: Settings, recording: Recording) -> tuple[Start, Settings]:
    """Make the start of an inversion: a modulus, the best uniform one, or a surrogate's map.

    Returned are the settings too, whose prior a surrogate's map may be the mean of.
    """
    kind = cfg.initialization.name
    if kind == "surrogate":
        from tactorch.learning.surrogate import TRUSTED, SurrogateStart

        start = SurrogateStart(cfg.initialization.weights)
        if cfg.resume is None:
            start.network  # noqa: B018  (wrong weights are told before anything is made)
        trusted = {"auto": TRUSTED, True: float("inf")}.get(cfg.initialization.prior_mean)
        if trusted is not None:
            settings = start.as_prior_mean(
                settings, recording, most_chi2=trusted, share=cfg.initialization.prior_share
            )
        return start, settings
    if kind != "uniform":
        raise ConfigError(f"initialization '{kind}' is unknown; choose uniform or surrogate.")
    return homogeneous if cfg.start_mpa == HOMOGENEOUS else float(cfg.start_mpa), settings


def build(what: str, make: Callable[..., _T], settings: dict[str, Any]) -> _T:
    """Call `make` with the settings of a group; its complaints then name the group.

    Raises:
        ConfigError: a setting is unknown or has a value that cannot be used.
    """
    try:
        return make(**settings)
    except ConfigError as error:
        message = str(error)
        named = message.startswith((what, "material"))
        raise ConfigError(message if named else f"{what}: {message}") from error
    except TypeError as error:
        raise ConfigError(f"{what} does not take these settings: {error}.") from error
