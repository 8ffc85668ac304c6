"""What beside the moduli decides the data, and may be known badly: nuisance parameters."""

from tactorch.inverse.nuisance.placed import Placed, Placing
from tactorch.inverse.nuisance.unknowns import Unknowns
from tactorch.inverse.nuisance.values import Nuisance

__all__ = ["Nuisance", "Placed", "Placing", "Unknowns"]
