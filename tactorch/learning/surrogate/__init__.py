"""The surrogate: what the presses on an object foretell of its map, to start inversions from."""

from tactorch.learning.surrogate.predict import TRUSTED, Prediction, SurrogateStart

__all__ = ["TRUSTED", "Prediction", "SurrogateStart"]
