"""Finite elements on straight-sided tetrahedra, and what they need of a mesh.

An element is a table: the derivatives of its shape functions with respect to the barycentric
coordinates at its quadrature points. Everything else follows from the vertices.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
import scipy.sparse as sp
import torch
from jaxtyping import Float, Int
from torch import Tensor

from tactorch.errors import ConfigError
from tactorch.linalg import SymmetricPattern
from tactorch.mesh import TetMesh

_EDGES = tuple(combinations(range(4), 2))


@dataclass(frozen=True, eq=False)
class Element:
    """Shape-function table of an element type.

    Attributes:
        name: How users call it.
        table: d N_k / d L_c at each point, (points, nodes, 4), L barycentric.
        rule: Share of the volume of each point, (points,).
        surface_rule: Share of a face's area of its (3 vertices, 3 midsides).
        volume_rule: Share of the volume of its nodes.
        mean_dilatation: Whether the dilatation is averaged over the element.
    """

    name: str
    table: Float[np.ndarray, "points nodes 4"]
    rule: Float[np.ndarray, " points"]
    surface_rule: tuple[float, float]
    volume_rule: tuple[float, float]
    mean_dilatation: bool

    @property
    def quadratic(self) -> bool:
        """Whether edges carry midside nodes."""
        return self.table.shape[1] == 10


def _linear() -> Element:
    return Element(
        "tet4", np.eye(4)[None], np.ones(1), (1.0 / 3.0, 0.0), (0.25, 0.0), mean_dilatation=False
    )


def _quadratic() -> Element:
    near, far = 0.5854101966249685, 0.1381966011250105
    points = np.full((4, 4), far) + (near - far) * np.eye(4)
    table = np.zeros((4, 10, 4))
    for q, L in enumerate(points):
        for a in range(4):
            table[q, a, a] = 4.0 * L[a] - 1.0
        for k, (a, b) in enumerate(_EDGES):
            table[q, 4 + k, a], table[q, 4 + k, b] = 4.0 * L[b], 4.0 * L[a]
    return Element(
        "tet10", table, np.full(4, 0.25), (0.0, 1.0 / 3.0), (-0.05, 0.2), mean_dilatation=True
    )


ELEMENTS = {"tet4": _linear(), "tet10": _quadratic()}


def make_element(name: str) -> Element:
    """Return an element by name.

    `tet4` is the plain linear tetrahedron of the paper; it locks as Poisson's ratio nears 0.5.
    `tet10` is quadratic with the dilatation averaged over each element (Simo, Taylor and Pister,
    1985), free of locking up to 0.499; it has about eight times the unknowns. Its error in
    displacement falls with the square of the edge, as that of tet4, but is a few times smaller on
    the same mesh and does not grow as Poisson's ratio nears 0.5. Materials that do not
    give their `dilatation` apart (linear, Saint Venant-Kirchhoff) are integrated as they are.

    Raises:
        ConfigError: the name is unknown.
    """
    if name not in ELEMENTS:
        raise ConfigError(f"element '{name}' is unknown; choose one of {', '.join(ELEMENTS)}.")
    return ELEMENTS[name]


@dataclass(frozen=True, eq=False)
class Discretisation:
    """A mesh seen through an element: nodes, couplings, geometry.

    The first `mesh.n_points` nodes are the mesh's own; midside nodes follow.
    """

    mesh: TetMesh
    element: Element

    @cached_property
    def edges(self) -> Int[np.ndarray, "edges 2"]:
        """End points of the edges that carry midside nodes; none for linear elements."""
        return self._edge_table[0]

    @cached_property
    def _edge_table(self) -> tuple[np.ndarray, np.ndarray]:
        """Unique edges, and the edge of each local edge of each tetrahedron."""
        if not self.element.quadratic:
            return np.empty((0, 2), dtype=np.int64), np.empty((self.mesh.n_tets, 0), np.int64)
        ends = np.sort(self.mesh.tets[:, np.array(_EDGES)], axis=2).reshape(-1, 2)
        unique, inverse = np.unique(ends, axis=0, return_inverse=True)
        return unique, inverse.reshape(-1, len(_EDGES))

    @property
    def n_nodes(self) -> int:
        """Number of nodes, midsides included."""
        return self.mesh.n_points + len(self.edges)

    @cached_property
    def nodes(self) -> Int[np.ndarray, "m k"]:
        """Nodes of each element: vertices, then midsides."""
        midsides = self.mesh.n_points + self._edge_table[1]
        return np.ascontiguousarray(np.concatenate([self.mesh.tets, midsides], axis=1))

    @cached_property
    def positions(self) -> Float[np.ndarray, "nodes 3"]:
        """Rest position of every node, mm."""
        points = self.mesh.points
        return np.concatenate([points, points[self.edges].mean(axis=1)])

    def extend(self, values: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "nodes 3"]:
        """Continue a vertex field to the midsides by averaging the ends."""
        return np.concatenate([values, values[self.edges].mean(axis=1)])

    def consistent_loads(
        self, values: Float[np.ndarray, "given 3"]
    ) -> Float[np.ndarray, "nodes 3"]:
        """Carry nodal loads or springs of a surface from vertices to the element's own nodes.

        Linear elements keep them. On quadratic ones a uniform traction acts on the midsides: each
        vertex hands its share of every loaded surface triangle to the two midsides beside it,
        which is exact for uniform pressure and keeps totals. Vertices without a loaded triangle
        (point loads, interior nodes) keep theirs, as does input over all nodes. Which triangles
        count as loaded depends on which vertices have a load that is not zero.

        Raises:
            ConfigError: the field is neither over the mesh nodes nor over all nodes.
        """
        return self.consistent_load_matrix(values) @ values

    def consistent_load_matrix(self, values: Float[np.ndarray, "given 3"]) -> sp.csr_matrix:
        """Return the matrix of `consistent_loads` for the loaded vertices, (nodes, given)."""
        n = self.mesh.n_points
        if values.shape == (self.n_nodes, 3):  # always so on linear elements
            return sp.identity(self.n_nodes, format="csr")
        if values.shape != (n, 3):
            raise ConfigError(
                f"a nodal field has shape {tuple(values.shape)}; expected ({n}, 3), one row per "
                f"mesh node (or all {self.n_nodes} element nodes)."
            )
        surface = self.mesh.surface
        loaded = (values != 0).any(axis=1)[surface.triangles].all(axis=1)
        triangles, areas = surface.triangles[loaded], surface.areas[loaded]
        around = np.bincount(triangles.ravel(), np.repeat(areas, 3), minlength=n)
        stays = np.flatnonzero(around == 0)
        rows, cols, shares = [stays], [stays], [np.ones(len(stays))]
        for corner, other in ((0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1)):
            vertex = triangles[:, corner]
            rows.append(self.midside(vertex, triangles[:, other]))
            cols.append(vertex)
            shares.append(0.5 * areas / around[vertex])
        entries = (np.concatenate(shares), (np.concatenate(rows), np.concatenate(cols)))
        return sp.csr_matrix(entries, shape=(self.n_nodes, n))

    def midside(
        self, first: Int[np.ndarray, " k"], second: Int[np.ndarray, " k"]
    ) -> Int[np.ndarray, " k"]:
        """Midside node of each edge given by its end points."""
        n = self.mesh.n_points
        low, high = np.minimum(first, second), np.maximum(first, second)
        return n + np.searchsorted(self.edges[:, 0] * n + self.edges[:, 1], low * n + high)

    @cached_property
    def _entry_pairs(self) -> Int[np.ndarray, "entries 2"]:
        """Local unknowns (row, column) of each stored entry, in the order of the kernels."""
        k = self.element.table.shape[1]
        pairs = [
            (3 * a + i, 3 * b + j)
            for a in range(k)
            for b in range(a, k)
            for i in range(3)
            for j in range(i if a == b else 0, 3)
        ]
        return np.array(pairs)

    @cached_property
    def unknowns(self) -> Int[np.ndarray, "m k3"]:
        """Unknowns of each element, node by node."""
        return (3 * self.nodes[:, :, None] + np.arange(3)).reshape(len(self.nodes), -1)

    @cached_property
    def pattern(self) -> SymmetricPattern:
        """Sparsity of the tangent."""
        # Node pairs first: nine times fewer keys to sort than unknowns.
        k = self.nodes.shape[1]
        first, second = np.triu_indices(k)
        n = self.n_nodes
        low = np.minimum(self.nodes[:, first], self.nodes[:, second]).ravel()
        high = np.maximum(self.nodes[:, first], self.nodes[:, second]).ravel()
        keys = np.unique(low * np.int64(n) + high)
        offsets = np.arange(3)
        rows = (3 * (keys // n))[:, None, None] + offsets[:, None] + 0 * offsets
        cols = (3 * (keys % n))[:, None, None] + offsets + 0 * offsets[:, None]
        return SymmetricPattern.from_pairs(3 * n, rows, cols)

    @cached_property
    def slots(self) -> Int[np.ndarray, "m entries"]:
        """Stored entry of the pattern for each element entry."""
        pairs = self._entry_pairs
        return self.pattern.slots(self.unknowns[:, pairs[:, 0]], self.unknowns[:, pairs[:, 1]])

    @property
    def entry_rows_cols(self) -> tuple[Int[np.ndarray, " entries"], Int[np.ndarray, " entries"]]:
        """Rows and columns, within an element matrix, of each stored entry."""
        return self._entry_pairs[:, 0], self._entry_pairs[:, 1]

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
        """Shape gradients (1/mm) and point volumes (mm^3), differentiable in the rest points."""
        corners = points[torch.tensor(self.mesh.tets)]
        sides = corners[:, 1:] - corners[:, :1]
        inverse = torch.linalg.inv(sides).mT
        barycentric = torch.cat([-inverse.sum(1, keepdim=True), inverse], dim=1)
        table = torch.from_numpy(self.element.table).to(points)
        gradients = torch.einsum("qkc,mcd->mqkd", table, barycentric)
        # The triple product: det's second derivative is not finite on regular shapes.
        volumes = (sides[:, 0] * torch.linalg.cross(sides[:, 1], sides[:, 2])).sum(-1) / 6.0
        return gradients, volumes[:, None] * torch.from_numpy(self.element.rule).to(points)
