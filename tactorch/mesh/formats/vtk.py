"""XML files of VTK: grids (.vtu) and surfaces (.vtp), in each of their encodings.

What is compressed is unpacked as far as it may be in memory. The library meshio takes the wrong
arrays of some files with raw data, and the last piece of several.
"""

import lzma
import re
import zlib
from base64 import b64decode
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from jaxtyping import Float, Int

from tactorch.budget import Unpacking, read_content
from tactorch.errors import FileError
from tactorch.mesh.formats.cells import SOLIDS, Cells
from tactorch.mesh.formats.numbers import parse_numbers

_EXPANSION, _COPIES = 6, 3  # bytes of memory for each of a file, and of unpacked content
_UNPACKERS: dict[str, Callable[[], Any]] = {
    "vtkZLibDataCompressor": zlib.decompressobj, "vtkLZMADataCompressor": lzma.LZMADecompressor,
}  # fmt: skip
_KINDS = {"Float": "f", "UInt": "u", "Int": "i"}
_KIND = re.compile(r"(Float|UInt|Int)(8|16|32|64)")
#: Shapes of VTK's types of cells; other numbers than those of corners are added to the name.
_SHAPES = {
    "vertex": (1,), "line": (3, 21, 35, 68), "triangle": (5, 22, 34, 69), "polygon": (7,),
    "quad": (9, 23, 28, 30, 70), "tetra": (10, 24, 71, 78), "hexahedron": (12, 25, 29, 33, 72, 79),
    "wedge": (13, 26, 31, 32, 73, 80), "pyramid": (14, 27, 37, 74, 81), "penta": (15,),
    "hexa": (16,), "polyhedron": (42,),
}  # fmt: skip
_SHAPE = {kind: shape for shape, kinds in _SHAPES.items() for kind in kinds}
_CORNERS = {"line": 2, "triangle": 3, "quad": 4, **{name: n for name, (n, _) in SOLIDS.items()}}
_VOXEL, _AS_HEXAHEDRON = 11, [0, 1, 3, 2, 4, 5, 7, 6]


@dataclass(frozen=True, eq=False)
class VtkXml:
    """Content of a file.

    Attributes:
        points: In the unit of the file.
        cells: Cells of one kind that follow each other, in the order of the file.
        fields: Values at the points.
        cell_fields: Values of the cells.
    """

    points: Float[np.ndarray, "n 3"]
    cells: list[Cells]
    fields: dict[str, np.ndarray]
    cell_fields: dict[str, np.ndarray]


def read_xml(path: Path) -> VtkXml:
    """Read a file; several pieces are joined at equal points.

    Raises:
        FileError: It is too large, or compressed in a way that is not read.
        Exception: It is damaged.
    """
    arrays = _Arrays(path)
    pieces = [arrays.of(piece) for piece in arrays.root.iter("Piece")]
    parts = [next(iter(p["Points"].values()), np.zeros(0)).reshape(-1, 3) for p in pieces]
    points, firsts = np.concatenate([np.zeros((0, 3)), *parts]), np.cumsum([0, *map(len, parts)])
    same = np.arange(len(points))
    if len(parts) > 1:
        _, first, inverse = np.unique(points, axis=0, return_index=True, return_inverse=True)
        same = first[inverse.ravel()]
    cells: list[Cells] = []
    for piece, start, end in zip(pieces, firsts[:-1], firsts[1:], strict=True):
        cells += _cells(piece, same[start:end])
    fields, cell_fields = (
        {
            name: np.concatenate([piece[section][name] for piece in pieces])
            for name in pieces[0][section]
            if all(name in piece[section] for piece in pieces)
        }
        for section in ("PointData", "CellData")
    )
    return VtkXml(points, cells, fields, cell_fields)


def _cells(
    piece: dict[str, dict[str, np.ndarray]], numbers: Int[np.ndarray, " n"]
) -> Iterator[Cells]:
    """Yield the cells of a piece, whose points have these numbers."""
    section = "Polys" if piece["Polys"] else "Cells"
    arrays = {name: values.ravel() for name, values in piece[section].items()}
    ends = arrays.get("offsets", np.zeros(0)).astype(np.int64)
    if not len(ends):
        return
    nodes = arrays["connectivity"].astype(np.int64)
    widths = np.diff(ends, prepend=0)
    if widths.min() < 0 or ends[-1] > len(nodes):
        raise ValueError("its cells have more nodes than it has")
    if len(nodes) and not 0 <= nodes.min() <= nodes.max() < len(numbers):
        raise ValueError("its cells have points that do not exist")
    nodes = numbers[nodes]
    kinds = arrays["types"] if section == "Cells" else np.full(len(ends), _SHAPES["polygon"][0])
    if len(kinds) != len(ends):
        raise ValueError("its cells and their types differ in number")
    change = (np.diff(kinds) != 0) | (np.diff(widths) != 0)
    starts = np.flatnonzero(np.concatenate([[True], change]))
    for start, end in zip(starts, [*starts[1:], len(ends)], strict=True):
        width = int(widths[start])
        rows = nodes[ends[start] - width : ends[end - 1]].reshape(end - start, width)
        yield _named(int(kinds[start]), rows)


def _named(kind: int, nodes: Int[np.ndarray, "m w"]) -> Cells:
    if kind == _VOXEL:
        return Cells("hexahedron", nodes[:, _AS_HEXAHEDRON])
    shape, width = _SHAPE.get(kind, f"cells of type {kind}"), nodes.shape[1]
    if shape == "polygon":
        shape = {3: "triangle", 4: "quad"}.get(width, shape)
    if width < _CORNERS.get(shape, 0):
        raise ValueError(f"its cells of type {kind} have {width} points")
    return Cells(shape if width == _CORNERS.get(shape, width) else f"{shape}{width}", nodes)


class _Arrays:
    """The arrays of a file."""

    def __init__(self, path: Path) -> None:
        head, _, appended = read_content(path, _EXPANSION).partition(b"<AppendedData")
        self.root = ElementTree.fromstring(head + b"</VTKFile>" if appended else head)
        tag, _, content = appended.partition(b"_")
        self._appended, self._encoded = memoryview(content), b"raw" not in tag
        self._order = ">" if self.root.get("byte_order") == "BigEndian" else "<"
        self._header = self._kind(self.root.get("header_type", "UInt32"))
        name = self.root.get("compressor")
        if name and name not in _UNPACKERS:
            raise FileError(
                f"'{path}' is compressed by {name}; save it with zlib, or uncompressed."
            )
        self._parts = Unpacking(path, _COPIES)
        self._unpack = partial(self._parts.part, _UNPACKERS[name]) if name else None

    def of(self, piece: ElementTree.Element) -> dict[str, dict[str, np.ndarray]]:
        """Return the arrays of numbers of a piece, by section and name.

        Raises:
            ValueError: Their lengths differ from the numbers of points or cells that it states.
        """
        names = ("Points", "Cells", "Polys", "PointData", "CellData")
        found = {
            name: {a.get("Name", ""): self._values(a) for a in piece.iterfind(f"{name}/DataArray")}
            for name in names
        }
        arrays = {s: {n: v for n, v in part.items() if v is not None} for s, part in found.items()}
        for kind, name in (("Points", ""), ("Cells", "offsets"), ("Polys", "offsets")):
            values = arrays[kind].get(name) if name else next(iter(arrays[kind].values()), None)
            stated = int(piece.get(f"NumberOf{kind}") or 0)
            if stated != (present := 0 if values is None else len(values)):
                raise ValueError(f"it states {stated} {kind.lower()} where it has {present}")
        return arrays

    def _kind(self, name: str) -> Any:
        """Return a type of numbers; None for text and others."""
        match = _KIND.fullmatch(name)
        return np.dtype(f"{self._order}{_KINDS[match[1]]}{int(match[2]) // 8}") if match else None

    def _values(self, array: ElementTree.Element) -> np.ndarray | None:
        """Return an array, with a row for each point or cell; None where it has no numbers."""
        kind = self._kind(array.get("type", ""))
        if kind is None:
            return None
        text = (array.text or "").strip().encode()
        if (form := array.get("format", "ascii")) == "ascii":
            values = (parse_numbers(text) if text else np.zeros(0)).astype(kind)
        else:
            content, encoded = memoryview(text), True
            if form == "appended":
                content = self._appended[int(array.attrib["offset"]) :]
                encoded = self._encoded
            values = np.frombuffer(self._bytes(content, encoded), kind)
        columns = int(array.get("NumberOfComponents") or 1)
        return values.reshape(-1, columns) if columns > 1 else values

    def _bytes(self, content: memoryview, encoded: bool) -> bytes | bytearray:
        """Return the bytes of an array, which a header of sizes precedes."""
        item = self._header.itemsize

        def part(start: int, size: int) -> memoryview:
            """Return bytes, of which those of the header and the others are encoded apart."""
            if not encoded:
                return content[start : start + size]
            start = -(-start // 3) * 4
            return memoryview(b64decode(content[start : start - (-size // 3) * 4]))[:size]

        def sizes(count: int) -> list[int]:
            return np.frombuffer(part(0, count * item), self._header).tolist()

        size = sizes(1)[0]
        if self._unpack is None:
            self._parts.add(min(size, len(content)))
            if encoded and content[-(-item // 3) * 4 - 1] != ord("="):  # encoded together
                return bytes(part(0, item + size)[item:])
            return bytes(part(item, size))
        if size > len(content):
            raise ValueError("it states more compressed parts than it has")
        lengths = sizes(3 + size)[3:]
        packed, ends = part((3 + size) * item, sum(lengths)), np.cumsum([0, *lengths])
        return b"".join(self._unpack(packed[a:b]) for a, b in pairwise(ends))
