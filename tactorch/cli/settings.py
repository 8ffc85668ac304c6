"""From Hydra's settings to the objects of the library."""

import logging
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from tactorch.errors import ConfigError
from tactorch.inverse import Bounds, NoiseModel, Settings, make_optimizer
from tactorch.phantoms import Phantom, make_phantom
from tactorch.recording import MaterialSpec
from tactorch.simulate import PressPlan

log = logging.getLogger("tactorch")


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
    settings = plain(cfg.phantom)
    return make_phantom(settings.pop("name"), **settings)


def plan_of(cfg: DictConfig) -> PressPlan:
    """Make the plan of presses."""
    settings = plain(cfg.press)
    return PressPlan.ramp(settings.pop("p_max_mpa"), settings.pop("steps"), **settings)


def material_of(cfg: DictConfig) -> MaterialSpec:
    """Make the material's description."""
    settings = plain(cfg.material)
    return MaterialSpec(settings["name"], settings["poisson"], settings["parameters"] or {})


def inversion_of(cfg: DictConfig) -> Settings:
    """Make the settings of an inversion."""
    optimizer, prior = plain(cfg.optimizer), plain(cfg.regularization)
    if not isinstance(cfg.bounds, DictConfig) or not isinstance(cfg.noise, DictConfig):
        raise ConfigError("bounds needs .lower and .upper, noise needs .relative and .mm.")
    return Settings(
        optimizer=make_optimizer(optimizer.pop("name"), **optimizer, weight=prior["weight"]),
        parameterization=cfg.parameterization.name,
        regularization=prior["name"],
        edge=prior["edge"],
        bounds=Bounds(**plain(cfg.bounds)),
        noise=NoiseModel(**plain(cfg.noise)),
        element=cfg.element,
        solver=cfg.solver.name,
        max_seconds=cfg.max_seconds,
    )
