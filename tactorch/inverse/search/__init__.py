"""The search for inclusions: hypotheses, proposals, evidence and model criticism."""

from tactorch.inverse.search.search import find_shapes

__all__ = ["find_shapes"]
