"""Depth of a region below the pressed surface."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from tactorch.errors import ConfigError
from tactorch.mesh import TetMesh
from tactorch.recording import Press

_NAMED = 0.95  # cosine of the angle up to which a direction is called by its side
_CANCELLED = 0.1  # share of the forces that is left of their sum, below which nothing is pushed
_AXES = "xyz"


@dataclass(frozen=True, eq=False)
class Depth:
    """Position of a region below a pressed location.

    Attributes:
        center_mm: Of its centre under the surface, along the push, mm.
        cover_mm: Of its nearest element's centre, mm.
        inward: Unit vector of the push, (3,).
        above_mm: The point of the contact above it, (3,), mm.
    """

    center_mm: float
    cover_mm: float
    inward: Float[np.ndarray, "3"]
    above_mm: Float[np.ndarray, "3"]

    @property
    def face(self) -> str:
        """The side that was pressed, as "z+"; empty where the push is along no axis."""
        axis = int(np.abs(self.inward).argmax())
        if abs(self.inward[axis]) < _NAMED:
            return ""
        return f"{_AXES[axis]}{'+' if self.inward[axis] < 0 else '-'}"


def lay_under(
    mesh: TetMesh,
    presses: Sequence[Press],
    center_mm: Float[np.ndarray, "3"],
    elements: Bool[np.ndarray, " m"],
) -> Depth | None:
    """Tell how deep a region lies, under the press that it is least deep under.

    A press's surface is that of the nodes that it pushes; above the region it is taken at the
    node nearest to the line through the centre along the push.

    Args:
        mesh: The body, m elements.
        presses: What was pressed.
        center_mm: The region's centre, (3,), mm.
        elements: Its elements, (m,).

    Returns:
        None where no press pushes; one that grips, so that its forces cancel, does not.

    Raises:
        ConfigError: The region is empty.
    """
    if not elements.any():
        raise ConfigError("the region has no element, so it lies nowhere.")
    found = [_under(mesh, press, center_mm, elements) for press in presses]
    there = [depth for depth in found if depth is not None and depth.center_mm > 0]
    return min(there, key=lambda depth: depth.center_mm, default=None)


def _under(
    mesh: TetMesh,
    press: Press,
    center_mm: Float[np.ndarray, "3"],
    elements: Bool[np.ndarray, " m"],
) -> Depth | None:
    total = press.forces.sum(axis=0)
    length = float(np.linalg.norm(total))
    touched = mesh.points[np.any(press.forces != 0, axis=1)]
    if not length > _CANCELLED * np.linalg.norm(press.forces, axis=1).sum():
        return None  # nothing is pushed, or it is gripped from opposite sides
    inward = total / length
    across = touched - center_mm
    across = across - (across @ inward)[:, None] * inward
    above = touched[np.argmin(np.linalg.norm(across, axis=1))]
    depths = (mesh.centroids[elements] - above) @ inward
    center = float((center_mm - above) @ inward)
    return Depth(center, float(depths.min()), inward, center_mm - center * inward)
