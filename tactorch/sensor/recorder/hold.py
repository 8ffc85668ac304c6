"""What holds the object while the sensor presses it."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from tactorch.errors import ConfigError
from tactorch.mesh import FACE_NAMES, TetMesh, face_nodes
from tactorch.mesh.values import Real, positive

OPPOSITE = "opposite"
_KINDS = ("fixed", "springs")
_FACING = np.sqrt(0.5)  # cosine up to which a triangle belongs to a side
_FLAT = 2e-3  # of the object's diagonal, by which nodes of a side may lie off its plane


@dataclass(frozen=True)
class Fixture:
    """What holds the object.

    Attributes:
        side: "x-" to "z+", a flat side of the object (it lies on a table, say), or "opposite":
            that away from each press, as in the paper.
        kind: "fixed", or "springs" on each of the side's nodes.
        spring_n_per_mm: Stiffness of each spring.

    Raises:
        ConfigError: A value cannot be used.
    """

    side: str = OPPOSITE
    kind: str = "fixed"
    spring_n_per_mm: Real = 1.0

    def __post_init__(self) -> None:
        if self.side not in (OPPOSITE, *FACE_NAMES):
            raise ConfigError(
                f"hold side={self.side!r}: choose {OPPOSITE} or one of {', '.join(FACE_NAMES)}."
            )
        if self.kind not in _KINDS:
            raise ConfigError(f"hold kind={self.kind!r}: choose one of {', '.join(_KINDS)}.")
        positive("spring_n_per_mm", self.spring_n_per_mm)

    def on(self, mesh: TetMesh, push: Float[np.ndarray, "3"]) -> dict[str, Any]:
        """Return the fields of a `Press` that say what holds the object.

        Args:
            mesh: The object at rest.
            push: Unit vector along which the sensor presses, in the object's frame.

        Raises:
            ConfigError: The object has no flat side there.
            MeshError: It is not flat on the side that is named.
        """
        nodes = far_nodes(mesh, push) if self.side == OPPOSITE else face_nodes(mesh, self.side)
        if self.kind == "fixed":
            fixed = np.zeros(mesh.points.shape, dtype=bool)
            fixed[nodes] = True
            return {"fixed": fixed}
        springs = np.zeros(mesh.points.shape)
        springs[nodes] = float(self.spring_n_per_mm)
        return {"springs": springs}


def far_nodes(mesh: TetMesh, push: Float[np.ndarray, "3"]) -> Int[np.ndarray, " k"]:
    """Return the nodes of the object's far side, seen along a direction.

    Raises:
        ConfigError: The object is not flat there.
    """
    surface, along = mesh.surface, mesh.points @ push
    depth = (along.max() - along[surface.triangles]).max(axis=1)
    there = np.asarray(surface.normals @ push > _FACING) & (depth <= _FLAT * mesh.diagonal)
    if not there.any():
        raise ConfigError(
            f"the object has no flat side opposite to a press along {np.round(push, 3).tolist()};"
            f" name the side that is held: hold side={', '.join(FACE_NAMES)}."
        )
    return np.unique(surface.triangles[there])
