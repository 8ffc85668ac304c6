"""Surrogate: network that predicts the map of an object from its presses, for initializations."""

from tactorch.learning.surrogate.predict import MAX_TRUSTED_CHI2, Prediction, SurrogateStart

__all__ = ["MAX_TRUSTED_CHI2", "Prediction", "SurrogateStart"]
