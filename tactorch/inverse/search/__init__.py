"""The search for inclusions: hypotheses, proposals, evidence and model criticism."""

from tactorch.inverse.search.physics_image import PhysicsImage
from tactorch.inverse.search.search import find_shapes, physics_image

__all__ = ["PhysicsImage", "find_shapes", "physics_image"]
