"""Surrogate: network that predicts the map of an object from its presses, for initializations."""

from tactorch.learning.surrogate.predict import TRUSTED, Prediction, SurrogateStart

__all__ = ["TRUSTED", "Prediction", "SurrogateStart"]
