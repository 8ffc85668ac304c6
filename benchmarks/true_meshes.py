"""Meshes for the presses of `true_objects.py`: they follow inclusions and are refined locally.

A mesh of `Phantom.mesh(conforming=True)` follows each inclusion within fTetWild's envelope, with
chords as long as its edges. Here its interface nodes are moved onto the analytic surface, and
elements are bisected (longest edge, with conforming closure; Rivara, 1984) down to a local edge
length, with new nodes of interfaces and of curved boundaries on the analytic surfaces too.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tactorch.mesh import Box, Shape, TetMesh
from tactorch.mesh.geometry import signed_volumes
from tactorch.mesh.topology import LOCAL_EDGES, match_faces
from tactorch.phantoms import Phantom

Sizing = Callable[[np.ndarray], np.ndarray]  # points (k, 3), mm -> edge lengths (k,), mm
MIN_VOLUME_FRACTION = 0.2  # of an element after its nodes are moved onto a surface
MAX_MOVE = 0.3  # of a node onto a surface, in edge lengths
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
        large = _edge_lengths(points, tets).max(axis=1) > sizing(points[tets].mean(axis=1))
        if not large.any():
            break
        points, tets, (labels,) = _bisect(phantom, points, tets, (labels,), large)
    return LabelledMesh(TetMesh.create(points, tets, repair=False), labels)


def refine_everywhere(phantom: Phantom, coarse: LabelledMesh) -> LabelledMesh:
    """Bisect until the longest edge of every element is shorter by a tenth or more."""
    points, tets, labels = coarse.mesh.points, coarse.mesh.tets, coarse.labels
    limits = 0.9 * _edge_lengths(points, tets).max(axis=1)
    for _ in range(_MAX_PASSES):
        large = _edge_lengths(points, tets).max(axis=1) > limits
        if not large.any():
            break
        points, tets, (labels, limits) = _bisect(phantom, points, tets, (labels, limits), large)
    return LabelledMesh(TetMesh.create(points, tets, repair=False), labels)


def _edge_lengths(points: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """Lengths of the edges of each element, (m, 6)."""
    ends = points[tets[:, LOCAL_EDGES]]
    return np.linalg.norm(ends[:, :, 0] - ends[:, :, 1], axis=2)


def _bisect(
    phantom: Phantom,
    points: np.ndarray,
    tets: np.ndarray,
    values: tuple[np.ndarray, ...],
    large: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
    """Bisect the terminal edges of the paths that start at the large elements.

    A terminal edge is the longest of all its elements, so that its bisection is conforming. Halves
    inherit the `values` of their element, of which the first are its labels.
    """
    pairs = np.sort(tets[:, LOCAL_EDGES], axis=2)
    keys, inverse = np.unique(pairs[..., 0] * len(points) + pairs[..., 1], return_inverse=True)
    edges = np.column_stack(np.divmod(keys, len(points)))
    tet_edges = inverse.reshape(-1, 6)
    lengths = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
    rank = np.empty(len(edges), dtype=np.int64)
    # Rounding makes equal lengths equal; the node numbers then decide.
    rank[np.lexsort((edges[:, 1], edges[:, 0], np.round(lengths, 9)))] = np.arange(len(edges))
    longest = np.take_along_axis(tet_edges, rank[tet_edges].argmax(axis=1)[:, None], 1)[:, 0]
    chosen = np.zeros(len(edges), dtype=bool)
    reached = large
    while True:
        chosen[longest[reached]] = True
        touched = np.asarray(chosen[tet_edges].any(axis=1))
        if (touched == reached).all():
            break
        reached = touched
    n_edges = len(edges)
    elements_of = np.bincount(tet_edges.ravel(), minlength=n_edges)
    terminal = chosen & (np.bincount(longest, minlength=n_edges) == elements_of)
    cut = np.flatnonzero(terminal[longest])
    new_node = np.full(n_edges, -1)
    new_node[terminal] = len(points) + np.arange(int(terminal.sum()))
    middle = new_node[longest[cut]]
    first, second = edges[longest[cut]].T
    halves = [np.where(tets[cut] == end[:, None], middle[:, None], tets[cut])
              for end in (second, first)]  # fmt: skip
    keep = np.ones(len(tets), dtype=bool)
    keep[cut] = False
    all_tets = np.concatenate((tets[keep], *halves))
    all_values = [np.concatenate((own[keep], own[cut], own[cut])) for own in values]
    middles = points[edges[terminal]].mean(axis=1)
    all_points = np.concatenate((points, middles))
    nodes, targets = _on_surfaces(phantom, all_points, all_tets, all_values[0])
    new = nodes >= len(points)
    return _move(all_points, all_tets, nodes[new], targets[new]), all_tets, all_values


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
    out, step = points.copy(), 1e-5
    for k, shape in enumerate(shapes):
        rows = np.flatnonzero(nearest == k)
        if not len(rows):
            continue
        own = points[rows]
        gradient = np.stack(
            [shape.signed_distance(own + step * e) - shape.signed_distance(own - step * e)
             for e in np.eye(3)], axis=1,
        ) / (2.0 * step)  # fmt: skip
        square = np.maximum((gradient**2).sum(axis=1), 0.25)
        out[rows] -= (distances[k, rows] / square)[:, None] * gradient
    return out


def _move(
    points: np.ndarray, tets: np.ndarray, nodes: np.ndarray, targets: np.ndarray
) -> np.ndarray:
    """Move nodes to their targets, except where an element would become too flat."""
    edge = np.full(len(points), np.inf)
    np.minimum.at(edge, tets.ravel(), np.repeat(_edge_lengths(points, tets).min(axis=1), 4))
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
