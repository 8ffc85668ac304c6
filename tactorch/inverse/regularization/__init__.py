"""Priors on the map of Young's modulus, one a file."""

from collections.abc import Callable
from typing import TypeAlias

from tactorch.errors import ConfigError
from tactorch.inverse.regularization.base import NoPrior, Regularizer
from tactorch.inverse.regularization.binary_well import BinaryWell
from tactorch.inverse.regularization.composite import Composite
from tactorch.inverse.regularization.log_jumps import LogJumps
from tactorch.inverse.regularization.matern import Matern
from tactorch.inverse.regularization.options import PriorOptions
from tactorch.inverse.regularization.shifted import ShiftedPrior
from tactorch.inverse.regularization.smoothness import Smoothness
from tactorch.inverse.regularization.sparsity import Sparsity
from tactorch.inverse.regularization.tikhonov import Tikhonov
from tactorch.inverse.regularization.total_variation import TotalVariation
from tactorch.mesh import TetMesh

REGULARIZERS = (
    "none",
    "smoothness",
    "total_variation",
    "log_jumps",
    "tikhonov",
    "sparsity",
    "binary_well",
    "matern",
    "composite",
)


#: A prior by its name, or what makes one of a mesh: a class of yours, say.
Prior: TypeAlias = str | Callable[[TetMesh], Regularizer]


def make_regularizer(
    name: Prior, mesh: TetMesh, *, edge: float | None = None, options: PriorOptions | None = None
) -> Regularizer:
    """Make a prior by name.

    Args:
        name: One of `REGULARIZERS`, or a function of the mesh that makes a prior; `edge`, and all
            of `options` but the mean, are then its own affair.
        mesh: The object.
        edge: Where total variation, sparsity and the logarithm of jumps turn from smooth to sharp;
            None takes each one's own default.
        options: What else some priors need.

    Raises:
        ConfigError: the name is unknown, or a setting cannot be used.
    """
    options = options or PriorOptions()
    inner = name(mesh) if callable(name) else _about_nothing(name, mesh, edge, options)
    if options.mean_mpa is None or name == "none":
        return inner
    about = ShiftedPrior(inner, options.mean_mpa, options.mean_deviation, mesh.n_tets)
    share = options.mean_share
    return about if share == 1 else Composite([(1 - share, inner), (share, about)])


def _about_nothing(
    name: str, mesh: TetMesh, edge: float | None, options: PriorOptions
) -> Regularizer:
    turn = {} if edge is None else {"edge": edge}
    match name:
        case "none":
            return NoPrior(mesh)
        case "smoothness":
            return Smoothness(mesh)
        case "total_variation":
            return TotalVariation(mesh, **turn)
        case "log_jumps":
            return LogJumps(mesh, **turn)
        case "tikhonov":
            return Tikhonov(mesh, options.level_mpa)
        case "sparsity":
            return Sparsity(mesh, options.level_mpa, **turn)
        case "binary_well":
            return BinaryWell(mesh, options.levels_mpa)
        case "matern":
            return Matern(mesh, options.length_mm, options.deviation, options.level_mpa)
        case "composite":
            shares = options.parts.items()
            return Composite(
                [(share, _about_nothing(n, mesh, edge, options)) for n, share in shares]
            )
    raise ConfigError(
        f"regularization '{name}' is unknown; choose one of {', '.join(REGULARIZERS)}."
    )


__all__ = [
    "REGULARIZERS",
    "BinaryWell",
    "Composite",
    "LogJumps",
    "Matern",
    "NoPrior",
    "Prior",
    "PriorOptions",
    "Regularizer",
    "ShiftedPrior",
    "Smoothness",
    "Sparsity",
    "Tikhonov",
    "TotalVariation",
    "make_regularizer",
]
