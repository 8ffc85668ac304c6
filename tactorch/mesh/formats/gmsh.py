"""Meshes of gmsh (.msh): formats 1, 2, 4.0 and 4.1, text and binary.

The sections of nodes, elements, entities and names of groups are read, and the field `region` of
elements that `write_mesh` writes. Others are skipped.
"""

import logging
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from tactorch.budget import read_content
from tactorch.errors import MeshError
from tactorch.mesh.formats.cells import SOLIDS, Cells, MeshFile
from tactorch.mesh.formats.groups import regions_of_groups
from tactorch.mesh.formats.numbers import parse_numbers, places

_log = logging.getLogger(__name__)
_SHAPES = {
    "vertex": (15,),
    "line": (1, 8, 26, 27, 28),
    "triangle": (2, 9, 20, 21, 22, 23, 24, 25),
    "quad": (3, 10, 16),
    "tetra": (4, 11, 29, 30, 31),
    "hexahedron": (5, 12, 17, 92, 93),
    "wedge": (6, 13, 18),
    "pyramid": (7, 14, 19),
}
_SHAPE = {number: shape for shape, numbers in _SHAPES.items() for number in numbers}
# Number of nodes of types 1 to 31.
_FIRST = (2, 3, 4, 4, 8, 6, 5, 3, 6, 9, 10, 27, 18, 14, 1, 8, 20, 15, 13, 9, 10, 12, 15, 15, 21)
_WIDTH = dict(enumerate((*_FIRST, 4, 5, 6, 20, 35, 56), start=1)) | {92: 64, 93: 125}
_SECTION = re.compile(rb"^\$([A-Za-z]\w*)[ \t]*\r?\n", re.MULTILINE)
_REGION = "region"
_MAX_BLOCKS = 200_000  # of nodes or elements, or entities of each dimension, which take 10 s
_MAX_TAGS = 100_000  # of an element; one for each part of a mesh that is divided
_EXPANSION = 8  # bytes of memory for each of the file


@dataclass(eq=False)
class _Block:
    """Elements of one type, in an entity or with the same number of tags."""

    kind: int
    numbers: Float[np.ndarray, " m"]
    nodes: Float[np.ndarray, "m w"]
    groups: Float[np.ndarray, " g"]  # of each element, in formats 1 and 2
    entity: tuple[int, int] = (0, 0)  # in format 4


@dataclass(eq=False)
class _Content:
    """What the sections of a file hold."""

    nodes: list[tuple[np.ndarray, np.ndarray]] = field(default_factory=list)  # numbers, points
    blocks: list[_Block] = field(default_factory=list)
    groups: dict[tuple[int, int], list[int]] = field(default_factory=dict)  # of entities
    names: dict[int, str] = field(default_factory=dict)
    region: np.ndarray | None = None  # number of the element, value


class _Numbers:
    """The numbers of a section, taken in their order."""

    def __init__(self, content: bytes, layout: str) -> None:
        """`layout` is the order of bytes of a binary file and its size of integers, or empty."""
        self._layout, self._start = layout, 0
        self._content: bytes | np.ndarray = content
        if not layout:
            self._content = parse_numbers(content)

    def take(self, kinds: str, rows: int = 1) -> Float[np.ndarray, "rows k"]:
        """Return rows of integers (i), sizes (n) and floating-point numbers (d)."""
        if not kinds:
            return np.zeros((rows, 0))
        if not self._layout:
            values = self._slice(rows * len(kinds), rows)
            return np.asarray(values, dtype=np.float64).reshape(rows, len(kinds))
        order, size = self._layout[0], self._layout[1]
        codes = {"i": "i4", "d": "f8", "n": f"u{size}"}
        kind = np.dtype([(f"f{i}", order + codes[k]) for i, k in enumerate(kinds)])
        table = np.frombuffer(self._slice(rows * kind.itemsize, rows), kind)
        return np.column_stack([table[name].astype(np.float64) for name in kind.names or ()])

    def _slice(self, length: int, rows: int) -> bytes | np.ndarray:
        left = self.left
        if not 0 <= length <= left:
            unit = "bytes" if self._layout else "numbers"
            raise ValueError(f"it states {rows} rows where {left} {unit} are left")
        self._start += length
        return self._content[self._start - length : self._start]

    def one(self, kind: str = "n") -> int:
        """Return one whole number."""
        return int(self.take(kind)[0, 0])

    def blocks(self) -> int:
        """Return how many blocks or entities follow, if these are not too many."""
        if (count := self.one()) > _MAX_BLOCKS:
            raise ValueError(f"it has {count} blocks or entities; write {_MAX_BLOCKS} or fewer")
        return count

    def list(self, kind: str = "i") -> list[int]:
        """Return integers whose number is stated before them."""
        count = self.one("n")
        return self.take(kind, count)[:, 0].astype(np.int64).tolist() if count else []

    @property
    def left(self) -> int:
        """How many bytes or numbers are left."""
        return len(self._content) - self._start


def read_gmsh(path: Path) -> MeshFile:
    """Read a file; regions are the physical groups of its solid elements.

    Raises:
        MeshError: It is of an unknown version.
        ValueError: It is damaged.
    """
    content, version, layout = _Content(), 1.0, ""
    for name, data in _sections(read_content(path, _EXPANSION)):
        if name == "MeshFormat":
            version, layout = _format(data)
        elif name == "PhysicalNames":
            _read_names(data, content)
        elif name == "ElementData":
            _read_data(data, layout, content)
        elif name in ("Entities", "PartitionedEntities") and version >= 4.0:
            _read_entities(_Numbers(data, layout), name != "Entities", version, content)
        elif name in ("Nodes", "NOD", "ParametricNodes"):
            if version >= 4.0:
                _read_nodes_4(_Numbers(data, layout), version, content)
            else:
                _read_nodes_2(data, layout, name != "Nodes", content)
        elif name in ("Elements", "ELM"):
            if version >= 4.0:
                _read_elements_4(_Numbers(data, layout), version, content)
            else:
                _read_elements_2(data, layout, version, content)
    return _assembled(content, path)


def _sections(data: bytes) -> Iterator[tuple[str, bytes]]:
    place = 0
    while match := _SECTION.search(data, place):
        name = match[1].decode()
        end = re.compile(rb"\$(End|END)" + match[1]).search(data, match.end())
        if end is None:
            raise ValueError(f"the section ${name} has no end")
        yield name, data[match.end() : end.start()]
        place = end.end()


def _format(data: bytes) -> tuple[float, str]:
    """Return the version, and the layout of binary numbers."""
    line, _, rest = data.partition(b"\n")
    number, binary, size = line.split()[:3]
    version = float(number)
    if not (1.0 <= version < 3.0 or 4.0 <= version < 4.2):
        raise MeshError(f"format {version:g} of gmsh is not read; save it in format 4.1 or 2.2.")
    if not int(binary):
        return version, ""
    order = next((o for o in "<>" if np.frombuffer(rest[:4], f"{o}i4")[0] == 1), None)
    if order is None or int(size) not in (4, 8):
        raise ValueError("the header of the binary file is damaged")
    return version, f"{order}{int(size)}"


def _read_names(data: bytes, content: _Content) -> None:
    """Read the names of the groups of volumes."""
    text = data.decode("utf-8", errors="replace")
    for number, name in re.findall(r'^\s*3\s+(-?\d+)\s+"(.*)"\s*$', text, re.MULTILINE):
        content.names[int(number)] = name


def _read_data(data: bytes, layout: str, content: _Content) -> None:
    """Read the field of regions."""
    words = data.split(b"\n", 2)
    if words[1].strip().strip(b'"') != _REGION.encode() or int(words[0]) != 1:
        return
    lines = words[2].split(b"\n")
    place = 1 + int(lines[0])  # after the real numbers
    integers = int(lines[place])
    rows = int(lines[place + 3])
    values = b"\n".join(lines[place + 1 + integers :])
    content.region = _Numbers(values, layout).take("id", rows)


def _read_entities(numbers: _Numbers, parts: bool, version: float, content: _Content) -> None:
    """Read which physical groups an entity is in."""
    if parts:
        numbers.one()
        numbers.take("ii", numbers.one())
    counts = [numbers.blocks() for _ in range(4)]
    for dimension, count in enumerate(counts):
        for _ in range(count):
            tag = numbers.one("i")
            if parts:
                numbers.take("ii")  # the entity that is divided
                numbers.list()
            numbers.take("d" * (3 if dimension == 0 and version > 4.0 else 6))
            groups = numbers.list()
            if dimension:
                numbers.list()
            if groups:
                content.groups[dimension, tag] = [abs(group) for group in groups]


def _read_nodes_4(numbers: _Numbers, version: float, content: _Content) -> None:
    blocks, _ = numbers.blocks(), numbers.take("n" * (3 if version > 4.0 else 1))
    for _ in range(blocks):
        first, second, parametric = numbers.take("iii")[0].astype(int)
        dimension = int(first if version > 4.0 else second)
        count, width = numbers.one(), 3 + (dimension if parametric else 0)
        if version > 4.0:
            tags = numbers.take("n", count)[:, 0]
            content.nodes.append((tags, numbers.take("d" * width, count)[:, :3]))
        else:
            rows = numbers.take("i" + "d" * width, count)
            content.nodes.append((rows[:, 0], rows[:, 1:4]))


def _read_nodes_2(data: bytes, layout: str, parametric: bool, content: _Content) -> None:
    """Read nodes of formats 1 and 2: their number is text, and rows with parameters differ."""
    head, _, rest = data.lstrip().partition(b"\n")
    count = int(head)
    if not parametric:
        table = _Numbers(rest, layout).take("iddd", count)
    elif layout:
        numbers, rows = _Numbers(rest, layout), list[list[float]]()
        while len(rows) < count:
            *row, dimension, _ = numbers.take("idddii")[0].tolist()
            numbers.take("d" * int(dimension) if dimension in (1.0, 2.0) else "")  # parameters
            rows.append(row)
        table = np.array(rows)
    else:
        words = (line.split()[:4] for line in rest.split(b"\n"))
        table = _Numbers(b" ".join(b" ".join(row) for row in words), "").take("iddd", count)
    content.nodes.append((table[:, 0], table[:, 1:]))


def _read_elements_2(data: bytes, layout: str, version: float, content: _Content) -> None:
    """Read elements of formats 1 and 2: their number is text, and their rows differ in length."""
    head, _, rest = data.lstrip().partition(b"\n")
    count, numbers = int(head), _Numbers(rest, layout)
    if not layout:
        values = numbers.take("i" * numbers.left)[0] if numbers.left else np.zeros(0)
        for kind, start, rows, width in _runs(values, count, version):
            table = values[start : start + rows * width].reshape(rows, width)
            before, group = width - _width(kind), 2 if version < 2.0 else 3
            groups = table[:, group] if before > group else np.zeros(rows)
            content.blocks.append(_Block(kind, table[:, 0], table[:, before:], groups))
    while layout and count > 0:
        kind, rows, tags = (int(x) for x in numbers.take("iii")[0])
        count -= max(rows, 1)
        table = numbers.take("i" * (1 + _checked(tags) + _width(kind)), rows)
        groups = table[:, 1] if tags > 0 else np.zeros(rows)
        content.blocks.append(_Block(kind, table[:, 0], table[:, 1 + tags :], groups))


def _runs(
    values: Float[np.ndarray, " v"], count: int, version: float
) -> list[tuple[int, int, int, int]]:
    """Return type, start, number and width of following rows of the same type and width."""
    runs: list[tuple[int, int, int, int]] = []
    place = 0
    for _ in range(count):
        kind = int(values[place + 1])
        tags = 2 if version < 2.0 else _checked(int(values[place + 2]))
        width = 3 + tags + _width(kind)
        if runs and (runs[-1][0], runs[-1][3]) == (kind, width):
            runs[-1] = (kind, runs[-1][1], runs[-1][2] + 1, width)
        else:
            runs.append((kind, place, 1, width))
        place += width
    return runs


def _read_elements_4(numbers: _Numbers, version: float, content: _Content) -> None:
    blocks, _ = numbers.blocks(), numbers.take("n" * (3 if version > 4.0 else 1))
    integer = "n" if version > 4.0 else "i"
    for _ in range(blocks):
        first, second, kind = (int(x) for x in numbers.take("iii")[0])
        rows = numbers.take(integer * (1 + _width(kind)), numbers.one())
        entity = (first, second) if version > 4.0 else (second, first)
        content.blocks.append(_Block(kind, rows[:, 0], rows[:, 1:], np.zeros(0), entity))


def _checked(tags: int) -> int:
    if not 0 <= tags <= _MAX_TAGS:
        raise ValueError(f"an element states {tags} tags")
    return tags


def _width(kind: int) -> int:
    """Return the number of nodes of gmsh's type of elements."""
    if kind not in _WIDTH:
        raise ValueError(f"elements of gmsh's type {kind} are not known")
    return _WIDTH[kind]


def _assembled(content: _Content, path: Path) -> MeshFile:
    """Number the nodes and give the elements their regions."""
    if not content.nodes:
        raise ValueError("it has no section $Nodes")
    tags, points = (np.concatenate(parts) for parts in zip(*content.nodes, strict=True))
    order = np.argsort(tags, kind="stable")
    known = tags[order]
    if (known[1:] == known[:-1]).any():
        raise ValueError(f"node {known[1:][known[1:] == known[:-1]][0]:.0f} is defined twice")
    solids = [block for block in content.blocks if _SHAPE.get(block.kind) in SOLIDS]
    others = {_SHAPE.get(block.kind, "vertex") for block in content.blocks} - set(SOLIDS)
    by_entity = any(block.entity[0] for block in solids)
    find = _regions_of_entities if by_entity else _merge_repeated
    regions = find(solids, content, path) if solids else None
    if regions is None and content.names:
        _log.warning(
            "'%s' names groups of volumes (%s), but no volume is in one: it has no regions. Save "
            "it with Mesh.SaveAll=0.", path, ", ".join(list(content.names.values())[:6]),
        )  # fmt: skip
    cells = [_cells(block.kind, order[places(known, block.nodes, "node")]) for block in solids]
    if content.region is not None and solids:
        numbers = np.concatenate([block.numbers for block in solids])
        rows = content.region[np.argsort(content.region[:, 0])]
        regions = rows[places(rows[:, 0], numbers, "region of element"), 1].astype(np.int64)
    empty = np.zeros((0, 1), dtype=np.int64)
    return MeshFile(points, cells + [Cells(name, empty) for name in sorted(others)], regions)


def _cells(kind: int, nodes: Int[np.ndarray, "m w"]) -> Cells:
    """Return elements in the order of nodes of VTK, as far as it matters."""
    if kind == 11:  # the last two nodes
        nodes = nodes[:, [0, 1, 2, 3, 4, 5, 6, 7, 9, 8]]
    return Cells(_SHAPE[kind] + ("" if kind < 8 else str(_WIDTH[kind])), nodes)


def _regions_of_entities(
    blocks: list[_Block], content: _Content, path: Path
) -> Int[np.ndarray, " e"] | None:
    """Return the group of each element, from those of its entity."""
    index = {e: i for i, e in enumerate(dict.fromkeys(block.entity for block in blocks))}
    of_block = np.array([index[block.entity] for block in blocks])
    rows = np.array([len(block.nodes) for block in blocks])
    pairs = [(i, group) for e, i in index.items() for group in content.groups.get(e, ())]
    entities, groups = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    sizes = np.bincount(of_block, rows)
    regions = regions_of_groups(_by_group(groups, entities), sizes, content.names, path)
    return None if regions is None else np.repeat(regions[of_block], rows)


def _merge_repeated(
    blocks: list[_Block], content: _Content, path: Path
) -> Int[np.ndarray, " e"] | None:
    """Remove repeated elements from blocks, and return the group of each element.

    Formats 1 and 2 repeat an element for each of its groups.
    """
    groups = np.abs(np.concatenate([block.groups for block in blocks])).astype(np.int64)
    first = same = np.arange(len(groups))
    ends = np.cumsum([len(block.nodes) for block in blocks])[:-1]
    if len(np.unique(groups)) > 1:
        corners = np.full((len(groups), 8), -1.0)
        for block, part in zip(blocks, np.split(corners, ends), strict=True):
            nodes = np.sort(block.nodes[:, : SOLIDS[_SHAPE[block.kind]][0]], axis=1)
            part[:, : nodes.shape[1]] = nodes
        _, first, same = np.unique(corners, axis=0, return_index=True, return_inverse=True)
        same = same.reshape(-1)
    tagged = groups != 0
    members = _by_group(groups[tagged], same[tagged])
    regions = regions_of_groups(members, np.ones(len(first)), content.names, path)
    kept = np.zeros(len(groups), dtype=bool)
    kept[first] = True
    for block, rows in zip(blocks, np.split(kept, ends), strict=True):
        block.numbers, block.nodes = block.numbers[rows], block.nodes[rows]
    return None if regions is None else regions[same[kept]]


def _by_group(
    groups: Int[np.ndarray, " p"], members: Int[np.ndarray, " p"]
) -> dict[int, Int[np.ndarray, " k"]]:
    """Return the members of each group."""
    if not len(groups):
        return {}
    order = np.argsort(groups, kind="stable")
    numbers, starts = np.unique(groups[order], return_index=True)
    return dict(zip(numbers.tolist(), np.split(members[order], starts[1:]), strict=True))
