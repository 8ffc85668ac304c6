"""Optimizers, one a file; all of them start from x, report to a monitor, and say why they stop."""

from typing import Any

from tactorch.errors import ConfigError
from tactorch.inverse.optimizers.base import Optimizer
from tactorch.inverse.optimizers.gauss_newton import GaussNewton
from tactorch.inverse.optimizers.lbfgs import LBFGS
from tactorch.inverse.optimizers.newton_cg import NewtonCG
from tactorch.inverse.optimizers.tnc import TNC

OPTIMIZERS: dict[str, type] = {
    "gauss_newton": GaussNewton,
    "newton_cg": NewtonCG,
    "tnc": TNC,
    "lbfgs": LBFGS,
}


def make_optimizer(name: str, **settings: Any) -> Optimizer:
    """Make an optimizer by name.

    Raises:
        ConfigError: the name or a setting is unknown, or a value is out of range.
    """
    if name not in OPTIMIZERS:
        raise ConfigError(f"optimizer '{name}' is unknown; choose one of {', '.join(OPTIMIZERS)}.")
    try:
        optimizer: Optimizer = OPTIMIZERS[name](**settings)
    except TypeError as error:
        raise ConfigError(f"optimizer '{name}' does not take these settings: {error}.") from error
    return optimizer


__all__ = ["LBFGS", "OPTIMIZERS", "TNC", "GaussNewton", "NewtonCG", "Optimizer", "make_optimizer"]
