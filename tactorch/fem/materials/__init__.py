"""Materials, by class and by name."""

from typing import Any

from tactorch.config import Registry
from tactorch.fem.materials.base import EnergyDerivatives, IsotropicMaterial, Material, bulk, lame

_ISOTROPIC = "tactorch.fem.materials.isotropic"
#: Materials by name. Installed packages add theirs by entry points of the group
#: `tactorch.material`, scripts by `MATERIALS.register`.
MATERIALS = Registry(
    "material",
    {
        "neo_hookean": f"{_ISOTROPIC}:NeoHookean",
        "linear": f"{_ISOTROPIC}:LinearElastic",
        "st_venant_kirchhoff": f"{_ISOTROPIC}:StVenantKirchhoff",
        "isochoric_neo_hookean": f"{_ISOTROPIC}:IsochoricNeoHookean",
        "mooney_rivlin": f"{_ISOTROPIC}:MooneyRivlin",
    },
)


def make_material(name: str, poisson: float, **parameters: Any) -> Material:
    """Return a material by its name.

    Args:
        name: One of `MATERIALS.names()`.
        poisson: Poisson's ratio.
        **parameters: Further parameters of the material, such as `lame_factor`.
    """
    return MATERIALS.build({"name": name, "poisson": poisson, **parameters})


__all__ = [
    "MATERIALS",
    "EnergyDerivatives",
    "IsotropicMaterial",
    "Material",
    "bulk",
    "lame",
    "make_material",
]
