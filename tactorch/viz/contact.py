"""Contact regions of an object and the direction of the force, in plane slices."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection

from tactorch.errors import TactorchError
from tactorch.mesh import TetMesh, select_face
from tactorch.recording import Press
from tactorch.viz.figure import CONTACT
from tactorch.viz.slicing import IN_PLANE, Plane

CONTACT_LINE: dict[str, Any] = {"colors": CONTACT, "linewidths": 2.5}
_ARROWS = 3  # on each patch
# Minimum in-plane fraction of a force for which an arrow is drawn.
_MIN_IN_PLANE = 0.3
# Patches below this fraction of the largest area are in contact only if pushed inward.
_CORNER_AREA = 0.15


class ContactPatch(NamedTuple):
    """Node indices of surface triangles in contact, and unit vector of the force on them."""

    triangles: Int[np.ndarray, "k 3"]
    direction: Float[np.ndarray, "3"]


def contact_patches(
    mesh: TetMesh, pressed: Float[np.ndarray, "_ 3"] | Sequence[str]
) -> list[ContactPatch]:
    """Return the parts of the surface in contact, one for each axis direction that they face.

    `pressed` is the external force on each node, N, summed over presses; or names of faces that
    are pushed inward, such as `["x-", "z+"]`.
    """
    surface = mesh.surface
    if isinstance(pressed, np.ndarray):
        loaded = _loaded_triangles(mesh, pressed)
        axis = np.abs(surface.normals[loaded]).argmax(axis=1)
        facing = 2 * axis + (surface.normals[loaded, axis] < 0)
        parts = [loaded[facing == f] for f in np.unique(facing)]
        largest = max((surface.areas[part].sum() for part in parts), default=0.0)
        # Small parts may only share their nodes with a side in contact.
        return [
            ContactPatch(surface.triangles[part], _median_direction(mesh, part, pressed))
            for part in parts
            if surface.areas[part].sum() > _CORNER_AREA * largest
            or _pushed_inward(mesh, part, pressed)
        ]
    faces = [select_face(mesh, name) for name in pressed]
    inward = [-surface.normals[face].mean(axis=0) for face in faces]
    return [
        ContactPatch(surface.triangles[face], push / np.linalg.norm(push))
        for face, push in zip(faces, inward, strict=True)
    ]


def total_forces(presses: Sequence[Press]) -> Float[np.ndarray, "n 3"]:
    """Return the force on each node summed over presses, N (n, 3), for `contact_patches`.

    If opposite forces cancel, their absolute values are summed instead.
    """
    total = np.sum([press.forces for press in presses], axis=0)
    sizes = np.sum([np.abs(press.forces) for press in presses], axis=0)
    return total if np.abs(total).sum() > 0.5 * sizes.sum() else sizes


def cut_triangles(
    points: Float[np.ndarray, "n 3"], triangles: Int[np.ndarray, "k 3"], axis: int, position: float
) -> Float[np.ndarray, "s 2 2"]:
    """Return the segments where triangles cross the plane at a position along an axis.

    Segments are given by their ends in the two coordinates of the plane.
    """
    heights = points[:, axis] - position
    # A node in the plane counts as above, so that every cut triangle has two cut edges.
    above = (heights >= 0)[triangles]
    crossed = triangles[above.any(axis=1) & ~above.all(axis=1)]
    starts, ends = crossed, np.roll(crossed, -1, axis=1)
    cut = (heights >= 0)[starts] != (heights >= 0)[ends]
    a, b = starts[cut], ends[cut]
    fraction = (heights[a] / (heights[a] - heights[b]))[:, None]
    crossings = points[a] + fraction * (points[b] - points[a])
    return crossings[:, list(IN_PLANE[axis])].reshape(-1, 2, 2)


def draw_cut(
    axes: Axes,
    piece: Plane,
    points: Float[np.ndarray, "n 3"],
    triangles: Int[np.ndarray, "k 3"],
    **style: Any,
) -> Float[np.ndarray, "s 2 2"]:
    """Draw the segments where triangles cross a slice, and return them."""
    segments = cut_triangles(points, triangles, piece.axis, piece.position_mm)
    axes.add_collection(LineCollection(list(segments), **style))
    return segments


def arrow_positions(
    segments: Float[np.ndarray, "s 2 2"], direction: Float[np.ndarray, "3"], axis: int
) -> tuple[Float[np.ndarray, "a 2"], Float[np.ndarray, "2"]]:
    """Return the tips of force arrows on a cut contact patch, and their unit direction.

    There are no tips if the force is mostly normal to the slice.
    """
    flat = direction[list(IN_PLANE[axis])]
    length = float(np.linalg.norm(flat))
    if len(segments) == 0 or length < _MIN_IN_PLANE:
        return np.empty((0, 2)), np.zeros(2)
    flat = flat / length
    midpoints = segments.mean(axis=1)
    order = np.argsort(midpoints @ np.array([-flat[1], flat[0]]), kind="stable")
    arc = np.cumsum(np.linalg.norm(segments[order, 1] - segments[order, 0], axis=1))
    targets = (np.arange(_ARROWS) + 0.5) / _ARROWS * arc[-1]
    tips = np.minimum(np.searchsorted(arc, targets), len(order) - 1)
    return midpoints[order[tips]], flat


def _loaded_triangles(mesh: TetMesh, forces: np.ndarray) -> np.ndarray:
    if forces.shape != mesh.points.shape:
        raise TactorchError(
            f"pressed: forces of shape {forces.shape} for a mesh of {mesh.n_points} nodes; "
            "give one force (N) per node, shape (n, 3), or names of faces."
        )
    if not np.isfinite(forces).all():
        raise TactorchError("pressed: some forces are not finite; leave out the faulty press.")
    size = np.linalg.norm(forces, axis=1)
    loaded = (size > 1e-6 * size.max())[mesh.surface.triangles]
    fully_loaded = np.flatnonzero(loaded.all(axis=1))
    # Forces on isolated nodes load no complete triangle: return the adjacent ones.
    return fully_loaded if len(fully_loaded) else np.flatnonzero(loaded.any(axis=1))


def _pushed_inward(mesh: TetMesh, part: np.ndarray, forces: np.ndarray) -> bool:
    push = forces[np.unique(mesh.surface.triangles[part])].sum(axis=0)
    inward = -mesh.surface.normals[part].mean(axis=0)
    return float(push @ inward) > _MIN_IN_PLANE * float(np.linalg.norm(push))


def _median_direction(mesh: TetMesh, part: np.ndarray, forces: np.ndarray) -> np.ndarray:
    nodes = np.unique(mesh.surface.triangles[part])
    # The median is robust to nodes shared with a patch that is pushed in another direction.
    push = np.median(forces[nodes], axis=0)
    if not push.any():
        push = forces[nodes].sum(axis=0)
    length = np.linalg.norm(push)
    return push / length if length > 0 else push
