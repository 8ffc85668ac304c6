"""Meshes for the presses of `true_objects.py`: they follow inclusions and are refined locally.

A mesh of `Phantom.mesh(conforming=True)` follows each inclusion within fTetWild's envelope, with
chords as long as its edges. Here its interface nodes are moved onto the analytic surface, and
elements are bisected (longest edge, with conforming closure; Rivara, 1984) down to a local edge
length, with new nodes of interfaces and of curved boundaries on the analytic surfaces too. At last
the interface of a curved inclusion is moved outwards by the volume that its chords leave out over
its area, of the order of one per cent of the volume: a tenth of the noise at 40 dB.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tactorch.mesh import Box, Shape, TetMesh
from tactorch.mesh.geometry import signed_volumes
from tactorch.mesh.refine import Sizing, bisect, edge_lengths
from tactorch.mesh.topology import match_faces
from tactorch.phantoms import Phantom

MIN_VOLUME_FRACTION = 0.2  # of an element after its nodes are moved onto a surface
MAX_MOVE = 0.3  # of a node onto a surface, in edge lengths
MIN_MISSING, MAX_MISSING = 1e-4, 0.05  # fractions of a volume that chords leave out
VOLUME_POINTS = 128  # along each axis
_MAX_PASSES = 60


@dataclass(frozen=True, eq=False)
class LabelledMesh:
    """A mesh whose elements are each within one part of a phantom.

    Attributes:
        mesh: Mesh of the phantom's body.
        labels: Part of each element: 0 for the background, k for inclusion k - 1.
    """

    mesh: TetMesh
    labels: np.ndarray

    def youngs(self, phantom: Phantom) -> np.ndarray:
        """Return Young's modulus of each element by its part, MPa; backgrounds at centroids."""
        background = Phantom(phantom.body, (), phantom.youngs_mpa)
        values = background.youngs_at(self.mesh.centroids)
        for k, (_, modulus) in enumerate(phantom.inclusions, start=1):
            values[self.labels == k] = modulus
        return values


def labels_at(phantom: Phantom, points: np.ndarray) -> np.ndarray:
    """Return the part of a phantom at points (mm): 0 for the background, k for inclusion k - 1."""
    labels = np.zeros(len(points), dtype=np.int64)
    for k, (shape, _) in enumerate(phantom.inclusions, start=1):
        labels[shape.contains(points)] = k
    return labels


def make_truth_mesh(phantom: Phantom, edge_mm: float, sizing: Sizing) -> LabelledMesh:
    """Mesh a phantom with faces on its interfaces, refined until no edge exceeds `sizing`.

    Args:
        phantom: Body and inclusions.
        edge_mm: Edge length of the initial mesh, mm.
        sizing: Maximum edge length of an element with its centroid at given points.
    """
    mesh = phantom.mesh(edge_mm, conforming=bool(phantom.inclusions))
    return refine(phantom, mesh, sizing)


def refine(phantom: Phantom, mesh: TetMesh, sizing: Sizing) -> LabelledMesh:
    """Refine a mesh with faces on the interfaces, whose nodes are moved onto the surfaces."""
    labels = labels_at(phantom, mesh.centroids)
    points, tets = mesh.points.copy(), mesh.tets
    points = _move(points, tets, *_on_surfaces(phantom, points, tets, labels))
    for _ in range(_MAX_PASSES):
        large = edge_lengths(points, tets).max(axis=1) > sizing(points[tets].mean(axis=1))
        if not large.any():
            break
        points, tets, (labels,) = _bisect(phantom, points, tets, (labels,), large)
    points = _with_volumes(phantom, points, tets, labels)
    return LabelledMesh(TetMesh.create(points, tets, repair=False), labels)


def refine_everywhere(phantom: Phantom, coarse: LabelledMesh) -> LabelledMesh:
    """Bisect until the longest edge of every element is shorter by a tenth or more."""
    points, tets, labels = coarse.mesh.points.copy(), coarse.mesh.tets, coarse.labels
    points = _move(points, tets, *_on_surfaces(phantom, points, tets, labels))
    limits = 0.9 * edge_lengths(points, tets).max(axis=1)
    for _ in range(_MAX_PASSES):
        large = edge_lengths(points, tets).max(axis=1) > limits
        if not large.any():
            break
        points, tets, (labels, limits) = _bisect(phantom, points, tets, (labels, limits), large)
    points = _with_volumes(phantom, points, tets, labels)
    return LabelledMesh(TetMesh.create(points, tets, repair=False), labels)


def volume(shape: Shape, inside: Callable[[np.ndarray], np.ndarray] | None = None) -> float:
    """Return the volume of a shape, or of a part of it, by points in its bounding box, mm^3."""
    low, high = shape.bounds()
    grid = (np.indices((VOLUME_POINTS,) * 3).reshape(3, -1).T + 0.5) / VOLUME_POINTS
    mask = (inside or shape.contains)(low + (high - low) * grid)
    return float(np.prod(high - low) * mask.mean())


def _with_volumes(
    phantom: Phantom, points: np.ndarray, tets: np.ndarray, labels: np.ndarray
) -> np.ndarray:
    """Move the interface of each curved inclusion along its normal to the inclusion's volume.

    An inclusion is the part of its shape without later inclusions and within the body. Those whose
    volume differs otherwise than by chords, by more than 5 %, and boxes remain as they are.
    """
    match = match_faces(tets, len(points))
    first, second = match.pairs.T
    outer = _face_nodes(tets, match.boundary)
    for k, (shape, _) in enumerate(phantom.inclusions, start=1):
        mine = (labels[first // 4] == k) != (labels[second // 4] == k)
        faces = _face_nodes(tets, first[mine])
        exact = volume(
            shape, lambda p, k=k: phantom.body.contains(p) & (labels_at(phantom, p) == k)
        )
        missing = exact - signed_volumes(points, tets[labels == k]).sum()
        if isinstance(shape, Box) or not MIN_MISSING < abs(missing) / exact < MAX_MISSING:
            continue
        corners = points[faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area = 0.5 * np.linalg.norm(normals, axis=1).sum()
        nodes = np.setdiff1d(np.unique(faces), outer)
        distances = [
            np.abs(other.signed_distance(points[nodes])) for other, _ in phantom.inclusions
        ]
        nodes = nodes[np.argmin(distances, axis=0) == k - 1]
        outward = _gradients(shape, points[nodes])
        outward /= np.linalg.norm(outward, axis=1, keepdims=True)
        points = _move(points, tets, nodes, points[nodes] + missing / area * outward)
    return points


def _is_part(phantom: Phantom, label: int, points: np.ndarray) -> np.ndarray:
    return np.asarray(phantom.body.contains(points) & (labels_at(phantom, points) == label))


def _bisect(
    phantom: Phantom,
    points: np.ndarray,
    tets: np.ndarray,
    values: tuple[np.ndarray, ...],
    large: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
    """Bisect edges of large elements, or of their neighbours, and move new nodes onto surfaces.

    Halves inherit the `values` of their element, of which the first are its labels.
    """
    ends, halves, origins = bisect(points, tets, large)
    all_values = [own[origins] for own in values]
    all_points = np.concatenate((points, points[ends].mean(axis=1)))
    nodes, targets = _on_surfaces(phantom, all_points, halves, all_values[0])
    new = nodes >= len(points)
    moved = _move(all_points, halves, nodes[new], targets[new])
    return moved, halves, all_values


def _on_surfaces(
    phantom: Phantom, points: np.ndarray, tets: np.ndarray, labels: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Nodes on interfaces and curved boundaries, and their nearest points on the surfaces."""
    match = match_faces(tets, len(points))
    first, second = match.pairs.T
    interface = first[labels[first // 4] != labels[second // 4]]
    outer = np.unique(_face_nodes(tets, match.boundary))
    inner = np.setdiff1d(np.unique(_face_nodes(tets, interface)), outer)
    shapes = [shape for shape, _ in phantom.inclusions]
    nodes, targets = [inner], [_nearest(shapes, points[inner])]
    if not isinstance(phantom.body, Box):
        nodes.append(outer)
        targets.append(_nearest([phantom.body], points[outer]))
    return np.concatenate(nodes), np.concatenate(targets)


def _face_nodes(tets: np.ndarray, faces: np.ndarray) -> np.ndarray:
    opposite = faces % 4
    return np.stack([tets[faces // 4, (opposite + k) % 4] for k in (1, 2, 3)], axis=1)


def _nearest(shapes: list[Shape], points: np.ndarray) -> np.ndarray:
    """Project points onto the nearest surface by one Newton step of its signed distance."""
    if not len(points) or not shapes:
        return points
    distances = np.stack([shape.signed_distance(points) for shape in shapes])
    nearest = np.abs(distances).argmin(axis=0)
    out = points.copy()
    for k, shape in enumerate(shapes):
        rows = np.flatnonzero(nearest == k)
        if not len(rows):
            continue
        gradient = _gradients(shape, points[rows])
        square = np.maximum((gradient**2).sum(axis=1), 0.25)
        out[rows] -= (distances[k, rows] / square)[:, None] * gradient
    return out


def _gradients(shape: Shape, points: np.ndarray, step: float = 1e-5) -> np.ndarray:
    """Gradients of a shape's signed distance, (n, 3)."""
    moves = step * np.eye(3)
    ends = [(shape.signed_distance(points + e), shape.signed_distance(points - e)) for e in moves]
    return np.stack([a - b for a, b in ends], axis=1) / (2.0 * step)


def _move(
    points: np.ndarray, tets: np.ndarray, nodes: np.ndarray, targets: np.ndarray
) -> np.ndarray:
    """Move nodes to their targets, except where an element would become too flat."""
    edge = np.full(len(points), np.inf)
    np.minimum.at(edge, tets.ravel(), np.repeat(edge_lengths(points, tets).min(axis=1), 4))
    shift = np.zeros_like(points)
    shift[nodes] = targets - points[nodes]
    shift[np.linalg.norm(shift, axis=1) > MAX_MOVE * edge] = 0.0
    before = signed_volumes(points, tets)
    for _ in range(20):
        flat = signed_volumes(points + shift, tets) < MIN_VOLUME_FRACTION * before
        if not flat.any():
            return points + shift
        shift[np.unique(tets[flat])] *= 0.5
    shift[np.unique(tets[flat])] = 0.0
    return points + shift
