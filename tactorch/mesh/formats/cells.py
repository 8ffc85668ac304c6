"""Elements of a mesh file, and their division into tetrahedra with corner nodes only."""

import logging
import re
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from tactorch.errors import MeshError
from tactorch.mesh.values import Points, Tets

_log = logging.getLogger(__name__)
#: Corner nodes of each solid element, and its faces, in the order of VTK, gmsh and Abaqus.
SOLIDS: dict[str, tuple[int, tuple[tuple[int, ...], ...]]] = {
    "tetra": (4, ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1))),
    "pyramid": (5, ((0, 3, 2, 1), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4))),
    "wedge": (6, ((0, 2, 1), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5))),
    "hexahedron": (
        8,
        ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)),
    ),
}
#: What to do with elements of other shapes.
AS_TETS = (
    "Divide them into tetrahedra: filter Tetrahedralize in ParaView, triangulate() in PyVista."
)
_REFUSED = {"polyhedron": "polyhedra", "penta": "pentagonal prisms", "hexa": "hexagonal prisms"}
_EDGES = [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)]  # of nodes 4 to 9 of a tetrahedron
_CURVED = 1e-3  # distance of a node from the middle of its edge that is reported, over the edge


@dataclass(frozen=True, eq=False)
class Cells:
    """Elements of one kind.

    Attributes:
        kind: Shape and number of nodes, such as `tetra10`; only those of `SOLIDS` are solid.
        nodes: Node indices, corners first.
    """

    kind: str
    nodes: Int[np.ndarray, "m w"]

    @property
    def shape(self) -> str:
        """The shape, without the number of nodes."""
        match = re.match("[a-z]*", self.kind)
        return match[0] if match else ""


@dataclass(frozen=True, eq=False)
class MeshFile:
    """Content of a mesh file.

    Attributes:
        points: Node positions in the unit of the file.
        cells: Elements of all kinds, in the order of the file.
        regions: Region number of each solid element; None where the file has none.
    """

    points: Float[np.ndarray, "n 3"]
    cells: list[Cells]
    regions: Int[np.ndarray, " e"] | None = None


def as_tets(file: MeshFile, source: object) -> tuple[Tets, Int[np.ndarray, " m"] | None]:
    """Return the solid elements as tetrahedra of their corner nodes, and their regions.

    Messages name the file `source`.

    Raises:
        MeshError: There is no solid element.
    """
    solids = [cells for cells in file.cells if cells.shape in SOLIDS and len(cells.nodes)]
    if refused := [_REFUSED[c.shape] for c in file.cells if c.shape in _REFUSED]:
        raise MeshError(f"it contains {refused[0]}. {AS_TETS}")
    if not solids:
        kinds = ", ".join(sorted({cells.kind for cells in file.cells})) or "no cells"
        raise MeshError(
            f"it contains no tetrahedra, only {kinds}. If it is a surface, mesh it with"
            " tetrahedralize, or `tactorch mesh`."
        )
    parts, parents, count = [], [], 0
    for cells in solids:
        tets, parent = split(cells.shape, cells.nodes[:, : SOLIDS[cells.shape][0]])
        parts.append(tets)
        parents.append(parent + count)
        count += len(cells.nodes)
    _report(file.points, solids, sum(map(len, parts)), source)
    regions = None if file.regions is None else file.regions[np.concatenate(parents)]
    return np.concatenate(parts), regions


def split(
    shape: str, corners: Int[np.ndarray, "m c"]
) -> tuple[Int[np.ndarray, "t 4"], Int[np.ndarray, " t"]]:
    """Divide elements into tetrahedra that fit together.

    Each is joined from its corner of the smallest index to the faces that do not have that corner,
    and each of these is halved from its corner of the smallest index: elements that share a face
    halve it alike (J. Dompierre et al., 8th International Meshing Roundtable, 1999, p. 195).

    Args:
        shape: One of `SOLIDS`.
        corners: Corner nodes of each element; coinciding ones, as of a collapsed hexahedron, are
            accepted.

    Returns:
        Tetrahedra in the order of the elements, of either orientation, and the element of each.
    """
    if shape == "tetra":
        return corners, np.arange(len(corners))
    parts, parents = [], []
    first = corners.argmin(axis=1)
    for apex in range(corners.shape[1]):
        rows = np.flatnonzero(first == apex)
        for face in SOLIDS[shape][1]:
            if apex not in face:
                for triangle in _halves(corners[rows][:, face]):
                    parts.append(np.column_stack((corners[rows, apex], triangle)))
                    parents.append(rows)
    tets, parent = np.concatenate(parts), np.concatenate(parents)
    order = np.argsort(parent, kind="stable")
    whole = (np.diff(np.sort(tets[order], axis=1), axis=1) > 0).all(axis=1)
    return tets[order][whole], parent[order][whole]


def _halves(faces: Int[np.ndarray, "m c"]) -> list[Int[np.ndarray, "m 3"]]:
    """Return triangles, or the halves of quadrangles."""
    if faces.shape[1] == 3:
        return [faces]
    even = (faces.argmin(axis=1) % 2 == 0)[:, None]
    return [
        np.where(even, faces[:, [0, 1, 2]], faces[:, [1, 2, 3]]),
        np.where(even, faces[:, [0, 2, 3]], faces[:, [1, 3, 0]]),
    ]


def _report(points: Points, solids: list[Cells], tets: int, source: object) -> None:
    """Say what was divided, and which nodes were not used."""
    counts: dict[str, int] = {}
    for cells in solids:
        counts[cells.shape] = counts.get(cells.shape, 0) + len(cells.nodes)
    names = {"hexahedron": "hexahedra", "tetra": "tetrahedra"}
    shown = ", ".join(f"{n} {names.get(shape, shape + 's')}" for shape, n in counts.items())
    if list(counts) != ["tetra"]:
        _log.warning("'%s': %s are divided into %d tetrahedra.", source, shown, tets)
    if any(cells.nodes.shape[1] > SOLIDS[cells.shape][0] for cells in solids):
        _log.warning(
            "'%s': elements of higher order are read with their corner nodes%s; element=tet10 adds "
            "nodes in the middle of edges.", source, _curvature(points, solids),
        )  # fmt: skip


def _curvature(points: Points, solids: list[Cells]) -> str:
    """Return in words how far edges of 10-node tetrahedra are from straight."""
    tets = [c.nodes for c in solids if c.kind == "tetra10" and c.nodes.max() < len(points)]
    largest, relative = 0.0, 0.0
    for nodes in tets:
        for place, (a, b) in enumerate(_EDGES, start=4):
            start, end = points[nodes[:, a]], points[nodes[:, b]]
            off = np.linalg.norm(points[nodes[:, place]] - (start + end) / 2.0, axis=1)
            length = np.maximum(np.linalg.norm(end - start, axis=1), 1e-300)
            largest = max(largest, float(off.max()))
            relative = max(relative, float((off / length).max()))
    if relative <= _CURVED:
        return ""
    return f", with straight edges ({largest:.2g} in the unit of the file from the curved ones)"
