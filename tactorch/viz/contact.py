"""Contact regions of an object and the direction of the force, in plane slices."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from tactorch.errors import TactorchError
from tactorch.mesh import TetMesh, select_face
from tactorch.recording import Press
from tactorch.viz.slicing import IN_PLANE

# Minimum in-plane fraction of a force for which an arrow is drawn.
_MIN_IN_PLANE = 0.3
# Patches below this fraction of the largest area are in contact only if pushed inward.
_CORNER_AREA = 0.15


@dataclass(frozen=True, eq=False)
class ContactPatch:
    """Surface triangles in contact that face the same direction.

    Attributes:
        triangles: Node indices of the triangles, (k, 3).
        direction: Unit vector of the force, (3,).
    """

    triangles: Int[np.ndarray, "k 3"]
    direction: Float[np.ndarray, "3"]


def contact_patches(
    mesh: TetMesh, pressed: Float[np.ndarray, "_ 3"] | Sequence[str]
) -> list[ContactPatch]:
    """Return the parts of the surface in contact.

    Args:
        mesh: Mesh of the body.
        pressed: External force on each node, N (n, 3), summed over presses; or names of faces
            that are pushed inward, such as `["x-", "z+"]`.

    Returns:
        One patch for each of the six axis directions that triangles in contact face.

    Raises:
        TactorchError: Forces have the wrong shape or are not finite.
        ConfigError: A face name is unknown.
        MeshError: A named side of the body is not flat.
    """
    if isinstance(pressed, np.ndarray):
        parts = _split_by_normal(mesh, _loaded_triangles(mesh, pressed))
        parts = _without_corners(mesh, parts, pressed)
        return [_patch_from_forces(mesh, part, pressed) for part in parts]
    patches = []
    for name in pressed:
        face = select_face(mesh, name)
        inward = -mesh.surface.normals[face].mean(axis=0)
        patches.append(ContactPatch(mesh.surface.triangles[face], inward / np.linalg.norm(inward)))
    return patches


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
    """Cut triangles by the plane where coordinate `axis` equals `position`.

    Returns:
        Ends of the segment of each triangle that is cut, in the two coordinates of the plane.
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


def arrow_positions(
    segments: Float[np.ndarray, "s 2 2"], direction: Float[np.ndarray, "3"], axis: int, count: int
) -> tuple[Float[np.ndarray, "a 2"], Float[np.ndarray, "2"]]:
    """Return where force arrows end on a cut contact patch, and their direction.

    Returns:
        Arrow tips (a, 2), empty if the force is mostly normal to the slice; unit direction (2,).
    """
    flat = direction[list(IN_PLANE[axis])]
    length = float(np.linalg.norm(flat))
    if len(segments) == 0 or length < _MIN_IN_PLANE:
        return np.empty((0, 2)), np.zeros(2)
    flat = flat / length
    midpoints = segments.mean(axis=1)
    order = np.argsort(midpoints @ np.array([-flat[1], flat[0]]), kind="stable")
    arc = np.cumsum(np.linalg.norm(segments[order, 1] - segments[order, 0], axis=1))
    targets = (np.arange(count) + 0.5) / count * arc[-1]
    tips = np.minimum(np.searchsorted(arc, targets), len(order) - 1)
    return midpoints[order[tips]], flat


def _loaded_triangles(mesh: TetMesh, forces: np.ndarray) -> np.ndarray:
    """Return the indices of the surface triangles under load."""
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


def _split_by_normal(mesh: TetMesh, triangles: np.ndarray) -> list[np.ndarray]:
    """Split surface triangles by the dominant axis of their normals."""
    normals = mesh.surface.normals[triangles]
    axis = np.abs(normals).argmax(axis=1)
    facing = 2 * axis + (normals[np.arange(len(triangles)), axis] < 0)
    return [triangles[facing == f] for f in np.unique(facing)]


def _without_corners(
    mesh: TetMesh, parts: list[np.ndarray], forces: np.ndarray
) -> list[np.ndarray]:
    """Drop small parts that only share their nodes with a side in contact."""
    areas = [float(mesh.surface.areas[part].sum()) for part in parts]
    return [
        part
        for part, area in zip(parts, areas, strict=True)
        if area > _CORNER_AREA * max(areas) or _pushed_inward(mesh, part, forces)
    ]


def _pushed_inward(mesh: TetMesh, part: np.ndarray, forces: np.ndarray) -> bool:
    """Return whether the force on some triangles points into the body."""
    push = forces[np.unique(mesh.surface.triangles[part])].sum(axis=0)
    inward = -mesh.surface.normals[part].mean(axis=0)
    return float(push @ inward) > _MIN_IN_PLANE * float(np.linalg.norm(push))


def _patch_from_forces(mesh: TetMesh, part: np.ndarray, forces: np.ndarray) -> ContactPatch:
    """Return a patch with the direction of the median force on its nodes."""
    triangles = mesh.surface.triangles[part]
    nodes = np.unique(triangles)
    # The median is robust to nodes shared with a patch that is pushed in another direction.
    push = np.median(forces[nodes], axis=0)
    if not push.any():
        push = forces[nodes].sum(axis=0)
    length = np.linalg.norm(push)
    return ContactPatch(triangles, push / length if length > 0 else push)
