"""Materials, by class and by name."""

from dataclasses import fields

from tactorch.errors import ConfigError
from tactorch.fem.materials.base import (
    Dilatation,
    InvariantDerivatives,
    IsotropicMaterial,
    Material,
)
from tactorch.fem.materials.isochoric import IsochoricNeoHookean
from tactorch.fem.materials.linear import LinearElastic
from tactorch.fem.materials.mooney_rivlin import MooneyRivlin
from tactorch.fem.materials.neo_hookean import NeoHookean
from tactorch.fem.materials.st_venant_kirchhoff import StVenantKirchhoff

MATERIALS: dict[str, type[Material]] = {
    "neo_hookean": NeoHookean,
    "linear": LinearElastic,
    "st_venant_kirchhoff": StVenantKirchhoff,
    "isochoric_neo_hookean": IsochoricNeoHookean,
    "mooney_rivlin": MooneyRivlin,
}


def make_material(name: str, poisson: float, **parameters: float) -> Material:
    """Make a material by its name.

    Args:
        name: A key of `MATERIALS`; add yours to that dictionary to use it by name.
        poisson: Poisson's ratio.
        parameters: The material's own parameters, such as `lame_factor`.

    Raises:
        ConfigError: the name or a parameter is unknown, or a value is out of range.
    """
    if name not in MATERIALS:
        raise ConfigError(f"material '{name}' is unknown; choose one of {', '.join(MATERIALS)}.")
    kind = MATERIALS[name]
    known = [field.name for field in fields(kind) if field.name != "poisson"]
    for given in parameters:
        if given not in known:
            raise ConfigError(
                f"material '{name}' has no parameter '{given}'; it takes poisson"
                f"{''.join(f', {other}' for other in known)}."
            )
    return kind(poisson=poisson, **parameters)


__all__ = [
    "MATERIALS",
    "Dilatation",
    "InvariantDerivatives",
    "IsochoricNeoHookean",
    "IsotropicMaterial",
    "LinearElastic",
    "Material",
    "MooneyRivlin",
    "NeoHookean",
    "StVenantKirchhoff",
    "make_material",
]
