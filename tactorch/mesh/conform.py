"""Local changes of a mesh after which its faces follow closed surfaces inside it.

Nodes near a surface are moved onto it, and edges that still cross it are bisected there, so that
no element is on both sides (as by F. Labelle and J. R. Shewchuk, "Isosurface stuffing: fast
tetrahedral meshes with good dihedral angles", ACM Trans. Graph. 26 (2007), 57, for a regular
lattice). Nodes and edges of the mesh's own boundary remain as they are.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from tactorch.mesh.geometry import area_vectors, signed_volumes, unit_rows
from tactorch.mesh.refine import Refinement, halve
from tactorch.mesh.tetmesh import TetMesh
from tactorch.mesh.topology import flat_faces, match_faces, number_edges, row_keys, triangle_edges
from tactorch.mesh.values import Points, Tets

_MAX_MOVE = 0.35  # of a node along an edge, in lengths of the edge
_MIN_POSITION = 0.1  # of a new node from the ends of its edge, likewise
_MIN_VOLUME = 0.2  # of an element after nodes are moved, over that before
_HALVINGS = 30  # of an interval that contains a crossing, and of moves that are too large


@dataclass(frozen=True, eq=False)
class ClosedSurface:
    """A closed surface."""

    #: Function of points, mm: zero on the surface, negative inside.
    level: Callable[[Float[np.ndarray, "k 3"]], Float[np.ndarray, " k"]]
    #: Volume inside, to which the faces are moved; None for nodes on the surface.
    volume_mm3: float | None


@dataclass(frozen=True, eq=False)
class Conforming:
    """A mesh whose faces follow closed surfaces."""

    refinement: Refinement  # bisections of a mesh, with new nodes at mid-points
    mesh: TetMesh  # that of the refinement, with interior nodes moved
    #: Side of each surface on which each element is: -1 inside, 1 outside, and 0 where the surface
    #: crosses the element.
    sides: Int[np.ndarray, "surfaces m"]


def conform(refinement: Refinement, surfaces: Sequence[ClosedSurface]) -> Conforming:
    """Move and bisect until the faces of a refined mesh follow surfaces that do not touch.

    The polyhedron of each surface has the surface's volume. Where a surface meets the mesh's own
    boundary, or another surface, elements that it crosses remain. The coarse mesh remains too.
    """
    state = _State.of(refinement)
    for surface in surfaces:
        state = state.warped(surface)
        while (split := state.split(surface)) is not None:
            state = split
        state = state.with_volume(surface)
    return state.result(surfaces)


@dataclass(frozen=True, eq=False)
class _State:
    """A mesh with nodes on some surfaces."""

    start: Refinement
    nested: Points  # nodes without moves
    points: Points
    tets: Tets
    parents: Int[np.ndarray, " m"]
    ends: tuple[Int[np.ndarray, "_ 2"], ...]
    outer: Bool[np.ndarray, " n"]  # nodes of the mesh's boundary
    values: tuple[Float[np.ndarray, " n"], ...]  # levels of the nodes; zero on the surface

    @staticmethod
    def of(start: Refinement) -> "_State":
        mesh = start.mesh
        outer = np.zeros(mesh.n_points, dtype=bool)
        outer[mesh.surface.triangles] = True
        ends = (start.ends,)
        return _State(start, mesh.points, mesh.points, mesh.tets, start.parents, ends, outer, ())

    @property
    def _fixed(self) -> Bool[np.ndarray, " n"]:
        return np.any([self.outer, *(values == 0 for values in self.values)], axis=0)

    def warped(self, surface: ClosedSurface) -> "_State":
        """Move nodes onto a surface that crosses an edge near them."""
        values = np.asarray(surface.level(self.points))
        edges, _ = number_edges(self.tets, len(self.points))
        crossed = edges[np.prod(np.sign(values[edges]), axis=1) < 0]
        both = np.concatenate((crossed, crossed[:, ::-1]))
        position = self._crossings(surface, both)
        targets = self.points[both[:, 0]] + position[:, None] * (
            self.points[both[:, 1]] - self.points[both[:, 0]]
        )
        near = (position < _MAX_MOVE) & ~self._fixed[both[:, 0]]
        order = np.argsort(-position[near], kind="stable")  # the nearest crossing remains
        shift = np.zeros_like(self.points)
        nodes = both[near, 0][order]
        shift[nodes] = targets[near][order] - self.points[nodes]
        points, moved = _moved(self.points, self.tets, shift, whole=True)
        values = np.where(moved, 0.0, values)
        return replace(self, points=points, values=(*self.values, values))

    def split(self, surface: ClosedSurface) -> "_State | None":
        """Bisect edges that cross the last surface where it does; None where there are none.

        The longest of these edges is always bisected, and no new edge crosses the surface, so that
        a number of calls leaves none.
        """
        values, n = self.values[-1], len(self.points)
        edges, tet_edges = number_edges(self.tets, n)
        crossed = (np.prod(np.sign(values[edges]), axis=1) < 0) & ~self._on_boundary(edges)
        if not crossed.any():
            return None
        lengths = np.linalg.norm(np.diff(self.points[edges], axis=1)[:, 0], axis=1)
        rank = np.where(crossed, 1 + np.argsort(np.argsort(lengths, kind="stable")), 0)
        own = np.take_along_axis(tet_edges, rank[tet_edges].argmax(axis=1)[:, None], 1)[:, 0]
        uses = np.bincount(tet_edges.ravel(), minlength=len(edges))
        chosen = crossed & (np.bincount(own, minlength=len(edges)) == uses)
        tets, origins = halve(self.tets, edges, own, chosen, n)
        ends = edges[chosen]
        position = np.clip(self._crossings(surface, ends), _MIN_POSITION, 1.0 - _MIN_POSITION)
        first, second = self.points[ends[:, 0]], self.points[ends[:, 1]]
        new = first + position[:, None] * (second - first)
        levels = [np.concatenate((v, v[ends].mean(axis=1))) for v in self.values[:-1]]
        return replace(
            self,
            nested=np.concatenate((self.nested, self.nested[ends].mean(axis=1))),
            points=np.concatenate((self.points, new)),
            tets=tets,
            parents=self.parents[origins],
            ends=(*self.ends, ends),
            outer=np.concatenate((self.outer, np.zeros(len(ends), dtype=bool))),
            values=(*levels, np.concatenate((values, np.zeros(len(ends))))),
        )

    def with_volume(self, surface: ClosedSurface) -> "_State":
        """Move the last surface along its normals to its volume, where no element crosses it."""
        side = _side(surface, self.values[-1], self.points, self.tets)
        if surface.volume_mm3 is None or not (side < 0).any() or (side == 0).any():
            return self
        match = match_faces(self.tets, len(self.points))
        first, second = match.pairs.T
        mine = side[first // 4] != side[second // 4]
        inside = np.where(side[first // 4] < 0, first, second)[mine]
        faces = flat_faces(self.tets, inside)
        vectors = area_vectors(self.points, faces)
        normals = np.zeros_like(self.points)
        for corner in faces.T:
            np.add.at(normals, corner, vectors)
        missing = surface.volume_mm3 - signed_volumes(self.points, self.tets[side < 0]).sum()
        shift = missing / np.linalg.norm(vectors, axis=1).sum() * unit_rows(normals)
        shift[self.outer] = 0.0
        return replace(self, points=_moved(self.points, self.tets, shift)[0])

    def result(self, surfaces: Sequence[ClosedSurface]) -> Conforming:
        """Return the meshes."""
        ends = np.concatenate(self.ends)
        coarse = self.start.coarse.regions
        regions = None if coarse is None else coarse[self.parents]
        fine = TetMesh(self.nested, self.tets, regions)
        refinement = Refinement(self.start.coarse, fine, self.parents, ends)
        pairs = zip(surfaces, self.values, strict=True)
        sides = [_side(surface, values, self.points, self.tets) for surface, values in pairs]
        shape = len(sides), len(self.tets)
        mesh = TetMesh(self.points, self.tets, regions)
        return Conforming(refinement, mesh, np.array(sides, dtype=int).reshape(shape))

    def _crossings(
        self, surface: ClosedSurface, edges: Int[np.ndarray, "k 2"]
    ) -> Float[np.ndarray, " k"]:
        """Return where edges cross a surface, from 0 to 1, by bisection of the interval."""
        first, second = self.points[edges[:, 0]], self.points[edges[:, 1]]
        low, high = np.zeros(len(edges)), np.ones(len(edges))
        sign = np.sign(surface.level(first))
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            at = surface.level(first + middle[:, None] * (second - first))
            same = np.sign(at) == sign
            low, high = np.where(same, middle, low), np.where(same, high, middle)
        return low

    def _on_boundary(self, edges: Int[np.ndarray, "e 2"]) -> Bool[np.ndarray, " e"]:
        sides, n = triangle_edges(self.start.mesh.surface.triangles), len(self.points)
        return np.isin(row_keys(edges, n), row_keys(sides, n))


def _side(
    surface: ClosedSurface, values: Float[np.ndarray, " n"], points: Points, tets: Tets
) -> Int[np.ndarray, " m"]:
    """Return -1 for elements inside, 1 for those outside, and 0 for those on both sides."""
    inside, outside = (values[tets] < 0).any(axis=1), (values[tets] > 0).any(axis=1)
    side = np.where(inside & outside, 0, np.where(inside, -1, 1))
    flat = ~inside & ~outside  # all nodes are on the surface
    side[flat] = np.where(surface.level(points[tets[flat]].mean(axis=1)) < 0, -1, 1)
    return side


def _moved(
    points: Points, tets: Tets, shift: Float[np.ndarray, "n 3"], *, whole: bool = False
) -> tuple[Points, Bool[np.ndarray, " n"]]:
    """Return points with shifts, shorter ones where an element becomes flat, and which have one.

    With `whole`, such points have none instead.
    """
    before = signed_volumes(points, tets)
    for _ in range(_HALVINGS):
        flat = signed_volumes(points + shift, tets) < _MIN_VOLUME * before
        if not flat.any():
            break
        shift[np.unique(tets[flat])] *= 0.0 if whole else 0.5
    else:
        shift = np.zeros_like(points)
    return points + shift, (shift != 0).any(axis=1)
