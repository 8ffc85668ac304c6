"""Shapes made of others: all that is in any of several, and a shape that is turned."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from tactorch.errors import ConfigError
from tactorch.mesh.shapes import Shape, store
from tactorch.mesh.values import Vector, vector


@dataclass(frozen=True)
class Union:
    """All that is in any of the `parts`.

    Its distance is exact outside; inside it is that to the surface of the part a point is deepest
    in, which may lie within the union: no more than the true one.
    """

    parts: Sequence[Any]  # shapes: a wrong one is told apart from the rest by its index

    def __post_init__(self) -> None:
        parts = tuple(self.parts)
        if not parts:
            raise ConfigError("parts is empty; give at least one shape.")
        for i, part in enumerate(parts):
            _check_shape(f"parts[{i}]", part)
        store(self, parts=parts)

    def signed_distance(self, points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        """Return the distance of each point to the surface, mm, negative inside."""
        return np.min([part.signed_distance(points) for part in self.parts], axis=0)

    def contains(self, points: Float[np.ndarray, "k 3"]) -> Bool[np.ndarray, " k"]:
        """Return whether each point is inside or on the surface."""
        return np.any([part.contains(points) for part in self.parts], axis=0)

    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Return the lowest and the highest corner of the bounding box, mm."""
        boxes = np.array([part.bounds() for part in self.parts])
        return np.stack((boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)))


@dataclass(frozen=True)
class Rotated:
    """A shape turned about the middle of its bounding box.

    Attributes:
        of: The shape.
        turn_deg: Rotation vector: its direction is the axis, its length the angle in degrees.
    """

    of: Shape
    turn_deg: Vector = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        _check_shape("of", self.of)
        store(self, turn_deg=vector("turn_deg", self.turn_deg))

    @property
    def rotation(self) -> Float[np.ndarray, "3 3"]:
        """The rotation as a matrix that turns columns."""
        return Rotation.from_rotvec(np.array(self.turn_deg), degrees=True).as_matrix()

    def turned(self, points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "k 3"]:
        """Return points of the shape as they lie once turned, mm."""
        middle = self.of.bounds().mean(axis=0)
        return (points - middle) @ self.rotation.T + middle

    def signed_distance(self, points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        """Return the distance of each point to the surface, mm, negative inside."""
        return self.of.signed_distance(self._back(points))

    def contains(self, points: Float[np.ndarray, "k 3"]) -> Bool[np.ndarray, " k"]:
        """Return whether each point is inside or on the surface."""
        return self.of.contains(self._back(points))

    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Return a box along the axes that holds the turned bounding box, mm."""
        low, high = self.of.bounds()
        half = np.abs(self.rotation) @ (high - low) / 2
        return np.stack(((low + high) / 2 - half, (low + high) / 2 + half))

    def _back(self, points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "k 3"]:
        middle = self.of.bounds().mean(axis=0)
        return (points - middle) @ self.rotation + middle


def _check_shape(name: str, shape: object) -> None:
    if not isinstance(shape, Shape):
        raise ConfigError(f"{name}={shape!r} is no shape; give one of tactorch.mesh.")
