"""Nested local refinement of tetrahedral meshes by longest-edge bisection (Rivara, 1984).

An element is bisected at the mid-point of its longest edge together with all other elements of that
edge, so that the mesh stays conforming. Where the edge is not the longest of a neighbour, the
neighbour is bisected at its own longest edge first. Each fine element is within one coarse element.

Reference: M.-C. Rivara, "Algorithms for refining triangular grids suitable for adaptive and
multigrid techniques", Int. J. Numer. Meth. Engng 20 (1984), 745-756.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float, Int

from tactorch.errors import ConfigError
from tactorch.mesh.geometry import frozen
from tactorch.mesh.meshing import MAX_ELEMENTS
from tactorch.mesh.tetmesh import TetMesh
from tactorch.mesh.topology import LOCAL_EDGES, number_edges, row_keys
from tactorch.mesh.values import Points, Tets

#: Maximum edge length (mm) of an element with its centroid at each of k points (mm).
Sizing = Callable[[Float[np.ndarray, "k 3"]], Float[np.ndarray, " k"]]
# Fraction of the elements where paths start below which only elements around these are considered.
_FEW = 0.02
#: Lower bound of a sizing, as a fraction of the mesh's diagonal: without one, bisection towards a
#: point of zero edge length does not end.
MIN_RELATIVE_SIZE = 1e-4


@dataclass(frozen=True, eq=False)
class Refinement:
    """A mesh and its nested refinement; n coarse nodes, k new nodes, m coarse elements.

    Attributes:
        coarse: Mesh before refinement.
        mesh: Mesh after refinement. Its first n nodes are those of `coarse`, in order.
        parents: Coarse element that contains each fine element.
        ends: Nodes of `mesh` whose mid-point each new node is, (k, 2). Both have lower numbers than
            the new node; they may be new nodes too.
    """

    coarse: TetMesh
    mesh: TetMesh
    parents: Int[np.ndarray, " fine"]
    ends: Int[np.ndarray, "k 2"]

    @cached_property
    def prolongation(self) -> sp.csr_matrix:
        """Matrix of the linear interpolation from coarse to fine nodes, (n + k, n).

        Each row holds the barycentric coordinates of a fine node in a coarse element, face or edge
        that contains it. They are exact: multiples of powers of two, and entries are above 0.
        """
        n = self.coarse.n_points
        matrix = sp.identity(n, format="csr")
        highest = self.ends.max(axis=1, initial=-1)
        while (start := matrix.shape[0] - n) < len(self.ends):
            later = highest[start:] >= matrix.shape[0]
            stop = start + int(later.argmax()) if later.any() else len(self.ends)
            first, second = self.ends[start:stop].T
            matrix = sp.vstack((matrix, 0.5 * (matrix[first] + matrix[second])), format="csr")
        return matrix

    @cached_property
    def surface_parents(self) -> Int[np.ndarray, " s"]:
        """Coarse surface triangle that contains each fine one; indices into `Surface.triangles`."""
        fine, coarse = self.mesh.surface.triangles, self.coarse.surface.triangles
        # The three vertices together depend on the three vertices of the coarse triangle.
        union = sum(
            (self.prolongation[column] for column in fine.T[1:]), self.prolongation[fine[:, 0]]
        )
        union.sort_indices()
        corners = np.concatenate((np.sort(coarse, axis=1), union.indices.reshape(-1, 3)))
        keys = row_keys(corners.astype(np.int64), self.coarse.n_points)
        order = np.argsort(keys[: len(coarse)])
        found = np.searchsorted(keys[: len(coarse)], keys[len(coarse) :], sorter=order)
        return frozen(order[found])

    def interpolate(self, values: Float[np.ndarray, "n *c"]) -> Float[np.ndarray, "fine *c"]:
        """Interpolate a nodal field of the coarse mesh linearly to the fine nodes.

        Args:
            values: Value of each coarse node, in any unit. NaN values affect only the nodes that
                depend on them.

        Returns:
            Value of each fine node. The first n are `values`.

        Raises:
            ConfigError: `values` does not have one row per coarse node.
        """
        n = self.coarse.n_points
        if values.ndim == 0 or len(values) != n:
            raise ConfigError(
                f"values have shape {values.shape}; expected ({n}, ...), one row per node of the"
                " coarse mesh."
            )
        fine = self.prolongation @ values.reshape(n, -1)
        return fine.reshape(self.mesh.n_points, *values.shape[1:])


def refine(mesh: TetMesh, sizing: Sizing) -> Refinement:
    """Bisect elements until no edge of an element is longer than the sizing at its centroid.

    Neighbours of bisected elements are bisected too where the mesh would not be conforming
    otherwise. The mesh is returned as it is where no edge is too long.

    Args:
        mesh: Coarse mesh.
        sizing: Function from points (k, 3), mm, to the maximum edge length at each, (k,), mm.
            Infinite lengths leave elements unchanged.

    Raises:
        ConfigError: `sizing` returns another shape, NaN, or lengths below 1e-4 of the mesh's
            diagonal, or the mesh would have more elements than `tetrahedralize` permits.

    Example:
        >>> near = refine(mesh, lambda points: 0.5 + 0.3 * np.linalg.norm(points - contact, axis=1))
        >>> modulus = coarse_modulus[near.parents]
    """
    points, tets = mesh.points, mesh.tets
    parents, ends = np.arange(mesh.n_tets), [np.empty((0, 2), dtype=np.int64)]

    def is_large(tets: Tets) -> Bool[np.ndarray, " m"]:
        limits = _check_sizing(sizing(points[tets].mean(axis=1)), len(tets), mesh.diagonal)
        return np.asarray(edge_lengths(points, tets).max(axis=1) > limits)

    large = is_large(tets)
    while large.any():
        halved, tets, origins = bisect(points, tets, large)
        parents, large = parents[origins], large[origins]
        points = np.concatenate((points, points[halved].mean(axis=1)))
        ends.append(halved)
        is_half = np.bincount(origins)[origins] > 1
        large[is_half] = is_large(tets[is_half])
        if len(tets) > MAX_ELEMENTS:
            raise ConfigError(
                f"sizing takes more than {MAX_ELEMENTS:.0e} elements; return larger edge lengths,"
                " and check that they are in mm."
            )
    regions = None if mesh.regions is None else mesh.regions[parents]
    fine = mesh if len(ends) == 1 else TetMesh(points, tets, regions)
    return Refinement(mesh, fine, frozen(parents), frozen(np.concatenate(ends)))


def edge_lengths(points: Points, tets: Tets) -> Float[np.ndarray, "m 6"]:
    """Return the lengths of each element's edges 01, 02, 03, 12, 13, 23, mm."""
    ends = points[tets[:, LOCAL_EDGES]]
    return np.linalg.norm(ends[:, :, 0] - ends[:, :, 1], axis=2)


def bisect(
    points: Points, tets: Tets, large: Bool[np.ndarray, " m"]
) -> tuple[Int[np.ndarray, "k 2"], Int[np.ndarray, "fine 4"], Int[np.ndarray, " fine"]]:
    """Bisect the terminal edges of the longest-edge paths that start at some elements.

    A path leads from an element to the other elements of its longest edge, and so on. A terminal
    edge is the longest of all its elements, so that bisecting it is conforming. Passes are repeated
    until the elements where paths start, of which there is at least one, are bisected.

    Returns:
        The nodes of the bisected edges, and elements and origins as of `halve`.
    """
    n, reached = len(points), large.copy()
    whole = np.full(n, large.mean() > _FEW)  # nodes of which all elements are considered
    while True:
        whole[tets[reached]] = True
        near = np.flatnonzero(whole[tets.T].any(axis=0))
        paths = _Paths.of(points, tets[near], reached[near])
        if whole[paths.edges[paths.chosen]].any(axis=1).all():
            break
        reached[near] = paths.reached
    own = np.full(len(tets), len(paths.edges))
    own[near] = paths.longest
    edges, terminal = np.append(paths.edges, [[0, 0]], axis=0), np.append(paths.terminal, False)
    return edges[terminal], *halve(tets, edges, own, terminal, n)


class _Paths(NamedTuple):
    """Longest-edge paths in some elements."""

    edges: Int[np.ndarray, "e 2"]
    longest: Int[np.ndarray, " m"]  # edge of each element
    chosen: Bool[np.ndarray, " e"]  # edges of the paths
    terminal: Bool[np.ndarray, " e"]  # those where paths end
    reached: Bool[np.ndarray, " m"]  # elements of the paths

    @staticmethod
    def of(points: Points, tets: Tets, reached: Bool[np.ndarray, " m"]) -> "_Paths":
        """Return the paths that start at some elements."""
        edges, tet_edges = number_edges(tets, len(points))
        lengths = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
        count, rank = len(edges), np.empty(len(edges), dtype=np.int64)
        # Rounding makes equal lengths equal; the node numbers then decide.
        rank[np.lexsort((edges[:, 1], edges[:, 0], np.round(lengths, 9)))] = np.arange(count)
        columns = np.ascontiguousarray(tet_edges.T)  # reductions over rows are several times faster
        longest = columns[rank[columns].argmax(axis=0), np.arange(len(tets))]
        chosen = np.zeros(count, dtype=bool)
        while True:
            chosen[longest[reached]] = True
            touched = np.asarray(chosen[columns].any(axis=0))
            if (touched == reached).all():
                break
            reached = touched
        elements_of = np.bincount(tet_edges.ravel(), minlength=count)
        terminal = chosen & (np.bincount(longest, minlength=count) == elements_of)
        return _Paths(edges, longest, chosen, terminal, reached)


def halve(
    tets: Tets,
    edges: Int[np.ndarray, "e 2"],
    own: Int[np.ndarray, " m"],
    chosen: Bool[np.ndarray, " e"],
    n_points: int,
) -> tuple[Int[np.ndarray, "fine 4"], Int[np.ndarray, " fine"]]:
    """Bisect the elements whose own edge is chosen; it is that of all elements of a chosen edge.

    Returns:
        The elements, oriented as before, and the element that each is, or is a half of. New nodes
        are numbered from `n_points`, in the order of the chosen edges.
    """
    cut = chosen[own]
    new_node = np.full(len(edges), -1)
    new_node[chosen] = n_points + np.arange(int(chosen.sum()))
    middle = new_node[own[cut]]
    halves = [
        np.where(tets[cut] == end[:, None], middle[:, None], tets[cut])
        for end in edges[own[cut]].T[::-1]
    ]
    origins = np.concatenate((np.flatnonzero(~cut), np.flatnonzero(cut), np.flatnonzero(cut)))
    return np.concatenate((tets[~cut], *halves)), origins


def _check_sizing(limits: np.ndarray, count: int, diagonal: float) -> Float[np.ndarray, " m"]:
    """Return the edge lengths that a sizing gave, or raise `ConfigError`."""
    array = np.asarray(limits, dtype=np.float64)
    if array.shape != (count,):
        raise ConfigError(
            f"sizing returned shape {array.shape} for {count} points; return one edge length (mm)"
            " per point."
        )
    lowest = MIN_RELATIVE_SIZE * diagonal
    if not (array >= lowest).all():
        raise ConfigError(
            f"sizing returned {array.min():.3g} mm; return edge lengths of at least {lowest:.3g} mm"
            f" ({MIN_RELATIVE_SIZE:g} of the mesh's diagonal)."
        )
    return array
