"""Finite elements on straight-sided tetrahedra, and the discretisation of a mesh by them.

- `tet4` is the linear tetrahedron of the paper. It locks as Poisson's ratio approaches 0.5.
- `tet10` is quadratic, with the volumetric part of the energy averaged over each element (Simo,
  Taylor and Pister, 1985). It is free of locking up to 0.499 and has about eight times the
  unknowns. On the same mesh its displacement error is a few times smaller; both errors decrease
  with the square of the edge length. Materials without a separate volumetric energy (linear,
  Saint Venant-Kirchhoff) are integrated without averaging.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import no_type_check

import numba
import numpy as np
import scipy.sparse as sp
import torch
from jaxtyping import Float, Int
from torch import Tensor

from tactorch.config import Registry
from tactorch.linalg import SymmetricPattern
from tactorch.mesh import TetMesh
from tactorch.mesh.topology import LOCAL_EDGES
from tactorch.mesh.tractions import LoadedSurface

Nodes = Int[np.ndarray, " k"]


@dataclass(frozen=True, eq=False)
class Element:
    """An element type.

    Attributes:
        table: Derivatives d N_k / d L_c of the shape functions by the barycentric coordinates L
            at each quadrature point, (points, nodes, 4).
        points: Barycentric coordinates of the quadrature points, (points, 4).
        rule: Volume fraction of each quadrature point, (points,).
        surface_rule: Area fraction of each vertex and of each midside node of a face.
        volume_rule: Volume fraction of each vertex and of each midside node.
        mean_dilatation: Whether the volumetric energy is averaged over the element.
    """

    table: Float[np.ndarray, "points nodes 4"]
    points: Float[np.ndarray, "points 4"]
    rule: Float[np.ndarray, " points"]
    surface_rule: tuple[float, float]
    volume_rule: tuple[float, float]
    mean_dilatation: bool

    @property
    def quadratic(self) -> bool:
        """Whether edges carry midside nodes."""
        return self.table.shape[1] == 10


def _quadratic() -> Element:
    near, far = 0.5854101966249685, 0.1381966011250105
    points = np.full((4, 4), far) + (near - far) * np.eye(4)
    table = np.zeros((4, 10, 4))
    for q, L in enumerate(points):
        for a in range(4):
            table[q, a, a] = 4.0 * L[a] - 1.0
        for k, (a, b) in enumerate(LOCAL_EDGES):
            table[q, 4 + k, a], table[q, 4 + k, b] = 4.0 * L[b], 4.0 * L[a]
    return Element(
        table, points, np.full(4, 0.25), (0.0, 1.0 / 3.0), (-0.05, 0.2), mean_dilatation=True
    )


TET4 = Element(
    np.eye(4)[None], np.full((1, 4), 0.25), np.ones(1), (1.0 / 3.0, 0.0), (0.25, 0.0),
    mean_dilatation=False,
)  # fmt: skip
TET10 = _quadratic()
#: Element types by name.
ELEMENTS = Registry(
    "element", {"tet4": "tactorch.fem.elements:TET4", "tet10": "tactorch.fem.elements:TET10"}
)


@dataclass(frozen=True, eq=False)
class Discretisation:
    """Nodes, sparsity and geometry of a mesh discretised by an element type.

    The first `mesh.n_points` nodes are the points of the mesh; midside nodes follow.
    """

    mesh: TetMesh
    element: Element

    @property
    def edges(self) -> Int[np.ndarray, "edges 2"]:
        """End points of the edges that carry midside nodes; none for linear elements."""
        return self.mesh.edges if self.element.quadratic else np.empty((0, 2), dtype=np.int64)

    @property
    def n_nodes(self) -> int:
        """Number of nodes, midsides included."""
        return self.mesh.n_points + len(self.edges)

    @cached_property
    def nodes(self) -> Int[np.ndarray, "m k"]:
        """Nodes of each element: vertices, then midsides."""
        mesh = self.mesh
        midsides = [mesh.n_points + mesh.tet_edges] if self.element.quadratic else []
        return np.hstack([mesh.tets, *midsides])

    @property
    def positions(self) -> Float[np.ndarray, "nodes 3"]:
        """Rest position of every node, mm."""
        return self.extend(self.mesh.points)

    def extend(self, values: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "nodes 3"]:
        """Return a vertex field extended to the midside nodes by the mean of the end points."""
        return np.concatenate([values, values[self.edges].mean(axis=1)])

    def consistent_loads(self, forces: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "nodes 3"]:
        """Return consistent loads at all nodes (N) from the nodal forces of linear elements.

        On quadratic elements they are those of the traction that the forces stand for; see
        `tactorch.mesh.tractions`. Values at all nodes are returned as they are.
        """
        if len(forces) == self.n_nodes:
            return forces
        return ConsistentLoads.of(self, forces).apply(forces)

    def distributed(self, values: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "nodes 3"]:
        """Return springs or loads at all nodes from those at the vertices, without negative ones.

        See `distribution_matrix`. Values at all nodes are returned as they are.
        """
        if len(values) == self.n_nodes:
            return values
        return self.distribution_matrix(values) @ values

    def distribution_matrix(self, values: Float[np.ndarray, "k 3"]) -> sp.csr_matrix:
        """Return the matrix of `distributed` for these loaded vertices, (nodes, k).

        The value of each vertex on a loaded surface triangle is divided between the two adjacent
        midside nodes. This is exact for a uniform pressure, and preserves totals and signs.
        Vertices without a loaded triangle keep their values.
        """
        n = self.mesh.n_points
        if not self.element.quadratic:
            return sp.identity(n, format="csr")
        loaded = LoadedSurface.of(self.mesh.surface, values)
        triangles, areas, around = loaded.triangles, loaded.areas, loaded.areas_around
        unchanged = np.flatnonzero(around == 0)
        rows, cols, fractions = [unchanged], [unchanged], [np.ones(len(unchanged))]
        for corner, other in ((0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1)):
            vertex = triangles[:, corner]
            rows.append(self.midside(vertex, triangles[:, other]))
            cols.append(vertex)
            fractions.append(0.5 * areas / around[vertex])
        entries = (np.concatenate(fractions), (np.concatenate(rows), np.concatenate(cols)))
        return sp.csr_matrix(entries, shape=(self.n_nodes, n))

    def midside(self, first: Nodes, second: Nodes) -> Nodes:
        """Return the midside node of each edge, given by its end points."""
        n = self.mesh.n_points
        low, high = np.minimum(first, second), np.maximum(first, second)
        return n + np.searchsorted(self.edges[:, 0] * n + self.edges[:, 1], low * n + high)

    def surface_nodes(self, triangles: Int[np.ndarray, "t 3"]) -> Int[np.ndarray, "t k"]:
        """Return the nodes of surface triangles: vertices, then midsides of their edges."""
        if not self.element.quadratic:
            return triangles
        midsides = [self.midside(triangles[:, a], triangles[:, (a + 1) % 3]) for a in range(3)]
        return np.column_stack([triangles, *midsides])

    def surface_values(self, barycentric: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, "p k"]:
        """Return the shape functions at points of a triangle, in the order of `surface_nodes`."""
        if not self.element.quadratic:
            return barycentric
        mixed = [4.0 * barycentric[:, a] * barycentric[:, (a + 1) % 3] for a in range(3)]
        return np.column_stack([barycentric * (2.0 * barycentric - 1.0), *mixed])

    @cached_property
    def entry_rows_cols(self) -> tuple[Int[np.ndarray, " entries"], Int[np.ndarray, " entries"]]:
        """Row and column in the element matrix of each stored entry, in the kernels' order."""
        k = self.element.table.shape[1]
        pairs = [
            (3 * a + i, 3 * b + j)
            for a in range(k)
            for b in range(a, k)
            for i in range(3)
            for j in range(i if a == b else 0, 3)
        ]
        return tuple(np.array(pairs).T)

    @cached_property
    def unknowns(self) -> Int[np.ndarray, "m k3"]:
        """Unknowns of each element, node by node."""
        return (3 * self.nodes[:, :, None] + np.arange(3)).reshape(len(self.nodes), -1)

    @cached_property
    def _node_pattern(self) -> SymmetricPattern:
        """Sparsity of the tangent by nodes."""
        first, second = np.triu_indices(self.nodes.shape[1])
        return SymmetricPattern.from_pairs(
            self.n_nodes, self.nodes[:, first], self.nodes[:, second]
        )

    @cached_property
    def pattern(self) -> SymmetricPattern:
        """Sparsity of the tangent."""
        return self._node_pattern.blocks(3)

    @cached_property
    def slots(self) -> Int[np.ndarray, "m entries"]:
        """Stored entry of the pattern for each element entry."""
        nodes, pattern = self.nodes.astype(np.int32), self._node_pattern
        out = np.empty((len(nodes), len(self.entry_rows_cols[0])), dtype=np.int32)
        _fill_slots(nodes, pattern.indptr, pattern.indices, self.pattern.indptr, out)
        return out

    @cached_property
    def from_linear(self) -> sp.csr_matrix | None:
        """Interpolation from the unknowns of linear elements; None on these."""
        if not self.element.quadratic:
            return None
        n, ends = self.mesh.n_points, self.edges
        rows, halves = np.repeat(np.arange(len(ends)), 2), np.full(ends.size, 0.5)
        midsides = sp.csr_matrix((halves, (rows, ends.ravel())), shape=(len(ends), n))
        nodes = sp.vstack([sp.identity(n), midsides])
        return sp.csr_matrix(sp.kron(nodes, sp.identity(3)))

    @cached_property
    def rigid_modes(self) -> Float[np.ndarray, "unknowns 6"]:
        """Three translations and three rotations about the centre, scaled to unit size."""
        x, y, z = ((self.positions - self.positions.mean(0)) / self.mesh.diagonal).T
        modes = np.zeros((self.n_nodes, 3, 6))
        modes[:, np.arange(3), np.arange(3)] = 1.0
        modes[:, 1, 3], modes[:, 2, 3] = -z, y
        modes[:, 2, 4], modes[:, 0, 4] = -x, z
        modes[:, 0, 5], modes[:, 1, 5] = -y, x
        return modes.reshape(-1, 6)

    def geometry(
        self, points: Float[Tensor, "n 3"]
    ) -> tuple[Float[Tensor, "m q k 3"], Float[Tensor, "m q"]]:
        """Return shape gradients (1/mm) and quadrature volumes (mm^3) for rest positions (mm)."""
        corners = points[torch.tensor(self.mesh.tets)]
        sides = corners[:, 1:] - corners[:, :1]
        inverse = torch.linalg.inv(sides).mT
        barycentric = torch.cat([-inverse.sum(1, keepdim=True), inverse], dim=1)
        table = torch.from_numpy(self.element.table).to(points)
        gradients = torch.einsum("qkc,mcd->mqkd", table, barycentric)
        # The triple product: det's second derivative is not finite on regular shapes.
        volumes = (sides[:, 0] * torch.linalg.cross(sides[:, 1], sides[:, 2])).sum(-1) / 6.0
        return gradients, volumes[:, None] * torch.from_numpy(self.element.rule).to(points)


@dataclass(frozen=True, eq=False)
class ConsistentLoads:
    """Map from nodal forces of linear elements to the loads of quadratic ones."""

    surface: LoadedSurface  # where forces act
    loads: sp.csr_matrix  # of all nodes by the traction at the vertices, (nodes, n), mm^2

    @staticmethod
    def of(discretisation: "Discretisation", forces: Float[np.ndarray, "n 3"]) -> "ConsistentLoads":
        """Return the map for the triangles on which these forces act."""
        surface = LoadedSurface.of(discretisation.mesh.surface, forces)
        corners = surface.triangles.T
        rows, cols, integrals = [], [], []
        # Integrals over a triangle of unit area: L_a (2 L_a - 1) L_b, and 4 L_a L_c L_b.
        for a, b in np.ndindex(3, 3):
            c = (a + 1) % 3
            rows += [corners[a], discretisation.midside(corners[a], corners[c])]
            cols += [corners[b], corners[b]]
            integrals += [1 / 30 if a == b else -1 / 60, 2 / 15 if b in (a, c) else 1 / 15]
        values = np.concatenate([integral * surface.areas for integral in integrals])
        entries = (values, (np.concatenate(rows), np.concatenate(cols)))
        shape = (discretisation.n_nodes, surface.n_points)
        return ConsistentLoads(surface, sp.csr_matrix(entries, shape=shape))

    @cached_property
    def _others(self) -> Nodes:
        return np.setdiff1d(np.arange(self.surface.n_points), self.surface.nodes)

    def apply(self, forces: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "nodes 3"]:
        """Return the loads; nodes without a loaded triangle keep their force."""
        out: np.ndarray = self.loads @ self.surface.tractions(forces)
        out[self._others] += forces[self._others]
        return out

    def transpose(self, loads: Float[np.ndarray, "nodes 3"]) -> Float[np.ndarray, "n 3"]:
        """Return the product of the transposed map with values at all nodes."""
        out = self.surface.tractions(self.loads.T @ loads)
        out[self._others] = loads[self._others]
        return out


@no_type_check
@numba.njit(nogil=True, cache=True)
def _fill_slots(nodes, indptr, indices, begins, out):
    """Fill `Discretisation.slots` from the pattern of nodes and the first entries of unknowns."""
    for e in range(nodes.shape[0]):
        k = 0
        for a in range(nodes.shape[1]):
            for b in range(a, nodes.shape[1]):
                low, high = min(nodes[e, a], nodes[e, b]), max(nodes[e, a], nodes[e, b])
                row = indices[indptr[low] : indptr[low + 1]]
                place = 3 * np.searchsorted(row, high)
                for i in range(3):
                    for j in range(i if a == b else 0, 3):
                        r, c = (i, j) if nodes[e, a] == low else (j, i)
                        out[e, k] = begins[3 * low + r] + place + c - r
                        k += 1
