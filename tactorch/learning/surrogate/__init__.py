"""The surrogate: what the presses on an object foretell of its map, to start inversions from."""

from tactorch.learning.surrogate.foretell import TRUSTED, Foretold, SurrogateStart

__all__ = ["TRUSTED", "Foretold", "SurrogateStart"]
