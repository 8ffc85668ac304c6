"""What beside the moduli decides the data, and may be known badly: nuisance parameters."""

from tactorch.inverse.nuisance.press_model import PressModel, PressModelFactory
from tactorch.inverse.nuisance.prior import NuisancePrior
from tactorch.inverse.nuisance.values import Nuisance

__all__ = ["Nuisance", "NuisancePrior", "PressModel", "PressModelFactory"]
