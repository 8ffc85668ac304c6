"""Priors on the map of Young's modulus, one a file."""

from tactorch.errors import ConfigError
from tactorch.inverse.regularization.base import NoPrior, Regularizer
from tactorch.inverse.regularization.smoothness import Smoothness
from tactorch.inverse.regularization.total_variation import TotalVariation
from tactorch.mesh import TetMesh

REGULARIZERS = ("none", "smoothness", "total_variation")


def make_regularizer(name: str, mesh: TetMesh, *, edge: float = 0.03) -> Regularizer:
    """Make a prior by name; `edge` is the jump at which total variation turns from smooth to sharp.

    Raises:
        ConfigError: the name is unknown.
    """
    if name == "none":
        return NoPrior(mesh)
    if name == "smoothness":
        return Smoothness(mesh)
    if name == "total_variation":
        return TotalVariation(mesh, edge)
    raise ConfigError(
        f"regularization '{name}' is unknown; choose one of {', '.join(REGULARIZERS)}."
    )


__all__ = [
    "REGULARIZERS",
    "NoPrior",
    "Regularizer",
    "Smoothness",
    "TotalVariation",
    "make_regularizer",
]
