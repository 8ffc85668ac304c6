"""Depth of a region below the pressed surface."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from tactorch.errors import ConfigError
from tactorch.mesh import TetMesh
from tactorch.recording import Press

_MIN_AXIS_COSINE = 0.95  # between push and axis, for a press on a named side
_MIN_NET_FORCE = 0.1  # net force over the sum of nodal forces; below, a press grips
_AXES = "xyz"


@dataclass(frozen=True, eq=False)
class Depth:
    """Depth of a region along the push of a press.

    Attributes:
        center_mm: Depth of the region's centre, mm.
        cover_mm: Depth of its nearest element's centroid, mm.
        inward: Unit vector of the push, (3,).
        above_mm: Point of the contact above the centre, (3,), mm.
    """

    center_mm: float
    cover_mm: float
    inward: Float[np.ndarray, "3"]
    above_mm: Float[np.ndarray, "3"]

    @property
    def face(self) -> str:
        """Pressed side, such as "z+"; empty if the push is along no axis."""
        axis = int(np.abs(self.inward).argmax())
        if abs(self.inward[axis]) < _MIN_AXIS_COSINE:
            return ""
        return f"{_AXES[axis]}{'+' if self.inward[axis] < 0 else '-'}"


def measure_depth(
    mesh: TetMesh,
    presses: Sequence[Press],
    center_mm: Float[np.ndarray, "3"],
    elements: Bool[np.ndarray, " m"],
) -> Depth | None:
    """Return the depth of a region below the press that is nearest to it.

    The surface of a press is that of the nodes it loads; above the region it is taken at the node
    nearest to the line through the centre along the push.

    Args:
        mesh: The body, m elements.
        presses: Presses on it.
        center_mm: Centre of the region, (3,), mm.
        elements: Elements of the region, (m,).

    Returns:
        The smallest depth; None if no press pushes. Gripping, with forces that cancel, is no push.

    Raises:
        ConfigError: The region is empty.
    """
    if not elements.any():
        raise ConfigError("the region has no element; give one with at least one.")
    depths = [_depth_below(mesh, press, center_mm, elements) for press in presses]
    inside = [depth for depth in depths if depth is not None and depth.center_mm > 0]
    return min(inside, key=lambda depth: depth.center_mm, default=None)


def _depth_below(
    mesh: TetMesh,
    press: Press,
    center_mm: Float[np.ndarray, "3"],
    elements: Bool[np.ndarray, " m"],
) -> Depth | None:
    total = press.forces.sum(axis=0)
    length = float(np.linalg.norm(total))
    loaded = mesh.points[np.any(press.forces != 0, axis=1)]
    if not length > _MIN_NET_FORCE * np.linalg.norm(press.forces, axis=1).sum():
        return None
    inward = total / length
    across = loaded - center_mm
    across = across - (across @ inward)[:, None] * inward
    above = loaded[np.argmin(np.linalg.norm(across, axis=1))]
    depths = (mesh.centroids[elements] - above) @ inward
    center = float((center_mm - above) @ inward)
    return Depth(center, float(depths.min()), inward, center_mm - center * inward)
