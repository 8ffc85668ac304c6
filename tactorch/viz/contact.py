"""Where an object is touched, and which way it is pushed, as seen in a plane slice."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from tactorch.errors import TactorchError
from tactorch.mesh import TetMesh, select_face
from tactorch.recording import Press
from tactorch.viz.sampling import IN_PLANE

# An arrow is drawn where at least this share of the force lies in the plane of the slice.
_IN_PLANE_SHARE = 0.3
# Patches below this share of the largest must be pushed inward to count as touched.
_CORNER_AREA = 0.15


@dataclass(frozen=True, eq=False)
class ContactPatch:
    """Touched triangles that face the same way.

    Attributes:
        triangles: Node indices of the touched surface triangles.
        direction: Unit vector of the push.
    """

    triangles: Int[np.ndarray, "k 3"]
    direction: Float[np.ndarray, "3"]


def contact_patches(
    mesh: TetMesh, pressed: Float[np.ndarray, "_ 3"] | Sequence[str]
) -> list[ContactPatch]:
    """Find the touched parts of the surface.

    Args:
        mesh: The body.
        pressed: External force on each node, N (n, 3), summed over presses; or names of faces,
            such as `["x-", "z+"]`, taken as pushed inwards.

    Returns:
        One patch for each of the six main directions in which touched triangles face.

    Raises:
        TactorchError: Forces of the wrong shape or not finite.
        ConfigError: An unknown face name.
        MeshError: The body is not flat on a named side.
    """
    if isinstance(pressed, np.ndarray):
        touched = _loaded_triangles(mesh, pressed)
        parts = _without_corners(mesh, _by_facing(mesh, touched), pressed)
        return [_patch_of_forces(mesh, part, pressed) for part in parts]
    patches = []
    for name in pressed:
        chosen = select_face(mesh, name)
        push = -mesh.surface.normals[chosen].mean(axis=0)
        patches.append(ContactPatch(mesh.surface.triangles[chosen], push / np.linalg.norm(push)))
    return patches


def pushed_nodes(presses: Sequence[Press]) -> Float[np.ndarray, "n 3"]:
    """Return the force on each node over all presses, N, for `contact_patches`.

    Where pushes of opposite direction cancel, their sizes are summed, without a direction.
    """
    total = np.sum([press.forces for press in presses], axis=0)
    sizes = np.sum([np.abs(press.forces) for press in presses], axis=0)
    return total if np.abs(total).sum() > 0.5 * sizes.sum() else sizes


def cut_triangles(
    points: Float[np.ndarray, "n 3"], triangles: Int[np.ndarray, "k 3"], axis: int, position: float
) -> Float[np.ndarray, "s 2 2"]:
    """Cut triangles by the plane where coordinate `axis` equals `position`.

    Returns:
        Per cut triangle the two ends of the cut, in the plane's two coordinates.
    """
    heights = points[:, axis] - position
    # A node in the plane counts as above: every cut triangle then has exactly two cut edges.
    above = (heights >= 0)[triangles]
    crossed = triangles[above.any(axis=1) & ~above.all(axis=1)]
    starts, ends = crossed, np.roll(crossed, -1, axis=1)
    cut = (heights >= 0)[starts] != (heights >= 0)[ends]
    a, b = starts[cut], ends[cut]
    share = (heights[a] / (heights[a] - heights[b]))[:, None]
    across = points[a] + share * (points[b] - points[a])
    return across[:, list(IN_PLANE[axis])].reshape(-1, 2, 2)


def arrow_places(
    segments: Float[np.ndarray, "s 2 2"], direction: Float[np.ndarray, "3"], axis: int, count: int
) -> tuple[Float[np.ndarray, "a 2"], Float[np.ndarray, "2"]]:
    """Choose where arrows of a push meet a cut contact patch, and their direction.

    Returns:
        The arrow tips (none where the push is mostly across the slice), the unit direction.
    """
    flat = direction[list(IN_PLANE[axis])]
    length = float(np.linalg.norm(flat))
    if len(segments) == 0 or length < _IN_PLANE_SHARE:
        return np.empty((0, 2)), np.zeros(2)
    flat = flat / length
    middles = segments.mean(axis=1)
    order = np.argsort(middles @ np.array([-flat[1], flat[0]]), kind="stable")
    run = np.cumsum(np.linalg.norm(segments[order, 1] - segments[order, 0], axis=1))
    wanted = (np.arange(count) + 0.5) / count * run[-1]
    chosen = np.minimum(np.searchsorted(run, wanted), len(order) - 1)
    return middles[order[chosen]], flat


def _loaded_triangles(mesh: TetMesh, forces: np.ndarray) -> np.ndarray:
    """Return indices of the surface triangles that carry force."""
    if forces.shape != mesh.points.shape:
        raise TactorchError(
            f"pressed: forces of shape {forces.shape} for a mesh of {mesh.n_points} nodes; "
            "give one force (N) per node, shape (n, 3), or names of faces."
        )
    if not np.isfinite(forces).all():
        raise TactorchError("pressed: some forces are not finite; leave out the faulty press.")
    size = np.linalg.norm(forces, axis=1)
    loaded = (size > 1e-6 * size.max())[mesh.surface.triangles]
    whole = np.flatnonzero(loaded.all(axis=1))
    # Forces on lone nodes load no triangle whole: mark those around them.
    return whole if len(whole) else np.flatnonzero(loaded.any(axis=1))


def _by_facing(mesh: TetMesh, touched: np.ndarray) -> list[np.ndarray]:
    """Split surface triangles by the main direction of their normals."""
    normals = mesh.surface.normals[touched]
    main = np.abs(normals).argmax(axis=1)
    negative = normals[np.arange(len(touched)), main] < 0
    facing = 2 * main + negative
    return [touched[facing == f] for f in np.unique(facing)]


def _without_corners(
    mesh: TetMesh, parts: list[np.ndarray], forces: np.ndarray
) -> list[np.ndarray]:
    """Drop the few triangles of untouched sides that only share their nodes with touched ones."""
    areas = [float(mesh.surface.areas[part].sum()) for part in parts]
    return [
        part
        for part, area in zip(parts, areas, strict=True)
        if area > _CORNER_AREA * max(areas) or _pushed_inward(mesh, part, forces)
    ]


def _pushed_inward(mesh: TetMesh, part: np.ndarray, forces: np.ndarray) -> bool:
    """Tell whether a good share of the force on some triangles is along their normals."""
    push = forces[np.unique(mesh.surface.triangles[part])].sum(axis=0)
    inward = -mesh.surface.normals[part].mean(axis=0)
    return float(push @ inward) > _IN_PLANE_SHARE * float(np.linalg.norm(push))


def _patch_of_forces(mesh: TetMesh, part: np.ndarray, forces: np.ndarray) -> ContactPatch:
    """Make a patch that is pushed as most of its nodes are."""
    triangles = mesh.surface.triangles[part]
    nodes = np.unique(triangles)
    # The median passes over nodes shared with a patch that is pushed another way.
    push = np.median(forces[nodes], axis=0)
    if not push.any():
        push = forces[nodes].sum(axis=0)
    length = np.linalg.norm(push)
    return ContactPatch(triangles, push / length if length > 0 else push)
