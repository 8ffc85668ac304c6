"""Settings of an inversion, and those that a stored result holds."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from tactorch.config import Options, option
from tactorch.errors import ConfigError
from tactorch.fem import NewtonOptions
from tactorch.inverse.data.misfit import Misfit, Squares
from tactorch.inverse.data.nuisance import NuisancePrior
from tactorch.inverse.data.observations import NoiseModel
from tactorch.inverse.errors.discretisation import RESIDUAL_MODEL_ERROR
from tactorch.inverse.fields.parameterization import Bounds, Log, Parameterization
from tactorch.inverse.fields.regularization.base import Prior
from tactorch.inverse.fields.regularization.sharp import TotalVariation
from tactorch.inverse.fit.optimizers.base import Optimizer
from tactorch.inverse.fit.optimizers.gauss_newton import GaussNewton
from tactorch.linalg.solver import AutoSolver, SolverOptions


@dataclass(frozen=True)
class Settings(Options):
    """Settings of an inversion: everything but the recording and the start.

    Components may be given as objects, by name ("tikhonov"), or as a table
    ({"name": "tikhonov", "level_mpa": 0.2}). By default the discretisation error of the mesh is
    corrected unless the presses were computed on the same mesh. The optimizer, the
    parameterization, the prior and nuisance parameters are those of the element map.
    """

    optimizer: Optimizer = option(
        factory=GaussNewton, help="Optimizer of the element map", section="optimizer"
    )
    parameterization: Parameterization = option(
        factory=Log, help="Variables of the optimization", section="parameterization"
    )
    regularization: Prior = option(
        factory=TotalVariation, help="Prior on the map", section="regularization"
    )
    bounds: Bounds = option(factory=Bounds, help="Limits of Young's modulus")
    noise: NoiseModel = option(factory=NoiseModel, help="Noise of presses that do not state it")
    misfit: Misfit = option(factory=Squares, help="Cost of the residuals", section="misfit")
    model_error: Literal["auto", "none", "discretisation"] = option(
        "auto", "Correction for the discretisation error of the mesh"
    )
    residual_model_error_fraction: float = option(
        RESIDUAL_MODEL_ERROR,
        "Fraction of the mesh's error that remains as uncertainty after the correction",
        ge=0, le=1,
    )  # fmt: skip
    element: Literal["tet4", "tet10"] = option("tet4", "Element type; tet10 is free of locking")
    solver: SolverOptions = option(factory=AutoSolver, help="Linear solver", section="solver")
    newton: NewtonOptions = option(factory=NewtonOptions, help="Equilibrium search")
    nuisance: NuisancePrior = option(
        factory=NuisancePrior, help="Nuisance parameters to be estimated", preset="none"
    )
    max_seconds: float | None = option(
        None, "Time limit of the search for inclusions, or of an element map", unit="s", gt=0
    )
    method: Literal["auto", "inclusions", "map"] = option(
        "auto",
        "Description of the field: inclusions in a background, a map with one modulus per element, "
        "or the one that the presses support",
    )


def has_all_settings(config: Mapping[str, Any]) -> bool:
    """Whether the `config` of a reconstruction determines its settings.

    It does not for a prior about a map, of which only the checksum is stored.
    """
    prior = config.get("settings", {}).get("regularization")
    return not (isinstance(prior, Mapping) and isinstance(prior.get("mean_mpa"), str))


def settings_from(config: Mapping[str, Any]) -> Settings:
    """Return the settings of a reconstruction from its `config`.

    Raises:
        ConfigError: the settings are incomplete, unknown, or depend on a map that is not stored.
    """
    if not has_all_settings(config):
        raise ConfigError("the mean of the prior is a map that the result does not store")
    try:
        return Settings.from_mapping(config["settings"])
    except (KeyError, TypeError, ConfigError) as error:
        raise ConfigError(f"the settings of the result cannot be read ({error})") from error
