"""Readers of surfaces: STL, Wavefront OBJ and PLY, each as text and, but for OBJ, binary."""

import codecs
import re
import struct
from array import array
from collections.abc import Callable
from pathlib import Path
from struct import Struct, unpack_from

import numpy as np
from jaxtyping import Int

from tactorch.budget import read_content
from tactorch.mesh.formats.numbers import parse_numbers
from tactorch.mesh.values import Points, Triangles

#: Positions of vertices; the vertices of each face, one face after another; and their numbers.
Polygons = tuple[Points, Int[np.ndarray, " v"], Int[np.ndarray, " f"]]
_EXPANSION = 8  # bytes of memory for each of the file
_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_HEADER = 84  # bytes before the triangles of a binary STL file
_TYPES = {
    name: code
    for names, code in (
        ("char int8", "i1"), ("uchar uint8", "u1"), ("short int16", "i2"), ("ushort uint16", "u2"),
        ("int int32", "i4"), ("uint uint32", "u4"), ("float float32", "f4"),
        ("double float64", "f8"),
    )
    for name in names.split()
}  # fmt: skip
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_VERTEX = re.compile(rb"\s*(?:vertex([^\r\n]*)|[^\r\n]*)", re.IGNORECASE)  # of STL
# A line of OBJ with the empty ones before it; "^" would be tried at each of these.
_LINE = re.compile(r"\s*(?:([vf])(?!\S)([^#\r\n]*)|[^\r\n]*)")
_MAX_ROWS = 4_000_000  # vertices and faces that are read one by one, which takes 10 s
_MAX_SQUARES = 2_000_000_000  # sum over polygons, whose division then takes 10 s


def read_stl(path: Path) -> Polygons:
    """Read the triangles of all solids of a file; vertices are repeated for each."""
    content = read_content(path, _EXPANSION).removeprefix(codecs.BOM_UTF8)
    count = int.from_bytes(content[80:_HEADER], "little")
    # Binary files may begin with "solid", and have bytes after the triangles.
    whole = len(content) >= _HEADER + _TRIANGLE.itemsize * count and b"\0" in content
    if not whole and re.match(rb"\s*solid\b", content, re.IGNORECASE):
        if not re.search(rb"end\s*solid[^\r\n]*\s*$", content[-1000:], re.IGNORECASE):
            raise ValueError("it has no line 'endsolid' at its end")
        corners = parse_numbers(b" ".join(_VERTEX.findall(content))).reshape(-1, 3)
    else:
        if len(content) < _HEADER + _TRIANGLE.itemsize * count:
            raise ValueError(f"it states {count} triangles, and has {len(content)} bytes")
        table = (
            np.frombuffer(content, _TRIANGLE, count, _HEADER) if count else np.zeros(0, _TRIANGLE)
        )
        corners = table["corners"].reshape(-1, 3).astype(np.float64)
    if len(corners) % 3:
        raise ValueError(f"its facets have {len(corners)} vertices, not three each")
    return corners, np.arange(len(corners)), np.full(len(corners) // 3, 3)


def read_obj(path: Path) -> Polygons:
    """Read the vertices and faces of all groups and objects of a file.

    meshio refuses files whose texture or normal lists differ in length from the vertex list, which
    is most files that have any.
    """
    vertices, nodes, widths = array("d"), array("q"), array("q")
    text = read_content(path, 2 * _EXPANSION).decode("utf-8", errors="replace")
    if "\\" in text:  # a line may go on in the next one
        text = re.sub(r"^([ \t]*[vf][^\n#]*?)\\[ \t]*\r?\n", r"\1 ", text, flags=re.MULTILINE)
    for line in _LINE.finditer(text):
        if line[1] is None:
            continue
        try:
            count = len(vertices) // 3
            if count + len(widths) >= _MAX_ROWS:
                raise ValueError(f"it has more than {_MAX_ROWS} vertices and faces; write fewer")
            fields = line[2].split()
            if line[1] == "v":
                if len(fields) < 3:
                    raise ValueError(f"a vertex needs three coordinates, not {len(fields)}")
                vertices.extend([float(field) for field in fields[:3]])
            elif len(fields) > 2:
                # Vertices count from 1, or back from the latest from -1.
                indices = [int(field.split("/")[0]) for field in fields]
                if (least := min(indices)) < -count or 0 in indices:
                    raise ValueError(f"there is no vertex {min(least, 0)}")
                nodes.extend([i - 1 if i > 0 else count + i for i in indices])
                widths.append(len(indices))
        except ValueError as error:
            number = text.count("\n", 0, line.start(1)) + 1
            raise ValueError(f"line {number}: {error}") from error
    points = np.array(vertices, dtype=np.float64).reshape(-1, 3)
    return points, np.array(nodes, dtype=np.int64), np.array(widths, dtype=np.int64)


def read_ply(path: Path) -> Polygons:
    """Read the positions of vertices and the faces of a file; other properties are skipped."""
    content = read_content(path, _EXPANSION)
    end = re.search(rb"^end_header[ \t]*\r?\n", content, re.MULTILINE)
    if end is None or not content.startswith(b"ply"):
        raise ValueError("the header has no end")
    order, elements = _ply_header(content[: end.start()].decode("ascii", errors="replace"))
    data = content[end.end() :]
    if not order:
        data, order = parse_numbers(data).tobytes(), "="
        elements = [
            (name, count, [(key, "f8", number and "f8") for key, _, number in properties])
            for name, count, properties in elements
        ]
    found: dict[str, _Values] = {}
    place = 0
    for name, count, properties in elements:
        wanted = _WANTED.get(name, ())
        place = _ply_rows(data, place, name, count, properties, order, wanted, found)
    axes = [found[axis][0].astype(np.float64) for axis in "xyz" if axis in found]
    points = np.column_stack(axes) if len(axes) == 3 else np.zeros((0, 3))
    nodes, widths = next((found[key] for key in _WANTED["face"] if key in found), (_NONE, _NONE))
    nodes = nodes.astype(np.int64)[np.repeat(widths, widths) > 2]
    return points, nodes, widths[widths > 2]


_Property = tuple[str, str, str | None]  # name, type, and type of the number of a list's items
_Values = tuple[np.ndarray, np.ndarray]  # one after another, and how many are in each row
_WANTED = {"vertex": ("x", "y", "z"), "face": ("vertex_indices", "vertex_index")}
_NONE = np.zeros(0, dtype=np.int64)


def _ply_header(text: str) -> tuple[str, list[tuple[str, int, list[_Property]]]]:
    """Return the order of bytes, empty for text, and names, rows and properties of elements."""
    order = ""
    elements: list[tuple[str, int, list[_Property]]] = []
    for line in text.splitlines():
        key, *words = line.split() or [""]
        if key == "format":
            order = _ORDERS[words[0]]
        elif key == "element":
            elements.append((words[0], int(words[1]), []))
        elif key == "property" and words[0] == "list":
            elements[-1][2].append((words[3], _TYPES[words[2]], _TYPES[words[1]]))
        elif key == "property":
            elements[-1][2].append((words[1], _TYPES[words[0]], None))
    return order, elements


def _ply_rows(
    data: bytes, place: int, name: str, count: int, properties: list[_Property], order: str,
    wanted: tuple[str, ...], found: dict[str, _Values],
) -> int:  # fmt: skip
    """Add the values of the wanted properties of an element, and return the end of its rows."""
    if count and not properties:
        raise ValueError(f"the header states {count} rows of {name} without properties")
    if not count:
        return place
    kind = _ply_row(data, place, properties, order)
    if place + count * kind.itemsize <= len(data):
        table = np.frombuffer(data, kind, count, place)
        numbers = [key for key in kind.names or () if key.startswith("number of ")]
        if all((table[key] == table[key][0]).all() for key in numbers):
            for key in {*wanted}.intersection(kind.names or ()):
                found[key] = table[key].ravel(), np.full(count, table[key][0].size)
            return place + table.nbytes
    lists = {key: (array("d"), array("q")) for key, *_ in properties if key in wanted}
    try:
        if (place := _ply_lists(data, place, count, properties, order, lists)) > len(data):
            raise struct.error
    except struct.error as error:
        raise ValueError(f"the header states {count} rows of {name}, and it has fewer") from error
    found |= {key: (np.array(x), np.array(n, np.int64)) for key, (x, n) in lists.items()}
    return place


def _ply_lists(
    data: bytes, place: int, count: int, properties: list[_Property], order: str,
    found: dict[str, tuple["array[float]", "array[int]"]],
) -> int:  # fmt: skip
    """Add the values of rows whose lists differ in length, and return their end."""
    steps = [(key, np.dtype(code), n and Struct(order + np.dtype(n).char))
             for key, code, n in properties]  # fmt: skip
    for row in range(count):
        if row >= _MAX_ROWS:
            raise ValueError(f"it has more than {_MAX_ROWS} rows that differ; write triangles")
        for key, kind, number in steps:
            length = 1
            if number:
                length = int(number.unpack_from(data, place)[0])
                place += number.size
            if length < 0 or length**2 > _MAX_SQUARES:
                raise ValueError(f"a list of {key} states {length} items")
            if key in found:
                values, widths = found[key]
                values.extend(unpack_from(f"{order}{length}{kind.char}", data, place))
                widths.append(length)
            place += length * kind.itemsize
    return place


def _ply_row(data: bytes, place: int, properties: list[_Property], order: str) -> np.dtype:
    """Return the type of the row at a place, whose lists state their lengths."""
    fields: list[tuple[str, str] | tuple[str, str, tuple[int]]] = []
    size = 0
    for key, code, number in properties:
        length = 1
        if number is not None:
            counter = np.dtype(order + number)
            if place + size + counter.itemsize > len(data):
                break
            length = int(np.frombuffer(data, counter, 1, place + size)[0])
            if not 0 <= length <= len(data):
                raise ValueError(f"a list of {key} states {length} items")
            fields.append((f"number of {key}", order + number))
            size += counter.itemsize
        fields.append((key, order + code) if number is None else (key, order + code, (length,)))
        size += length * np.dtype(code).itemsize
    complete = len([f for f in fields if not f[0].startswith("number of ")]) == len(properties)
    return np.dtype(fields) if complete else np.dtype(f"V{len(data) + 1}")


def triangulated(
    points: Points, nodes: Int[np.ndarray, " v"], widths: Int[np.ndarray, " f"]
) -> Int[np.ndarray, "t 3"]:
    """Return triangles, in the order of the faces; see `Polygons`.

    Raises:
        ValueError: A polygon cannot be divided: it is not flat, or its sides cross; or this takes
            too long.
    """
    if (squares := widths.astype(np.float64) ** 2)[widths > 4].sum() > _MAX_SQUARES:
        raise ValueError(
            f"its faces have up to {widths.max()} vertices, whose division takes too long ("
            f"{squares.sum():.1e} for their squares, of {_MAX_SQUARES:.0e}); write triangles"
        )
    starts = np.cumsum(widths) - widths
    parts, faces = [], []
    for width in np.unique(widths).tolist():
        same = np.flatnonzero(widths == width)
        rows = nodes[starts[same, None] + np.arange(width)]
        parts.append(_DIVISIONS.get(width, _polygons)(points, rows))
        faces.append(np.repeat(same, width - 2))
    return np.concatenate(parts)[np.argsort(np.concatenate(faces), kind="stable")]


def _quads(points: Points, quads: Int[np.ndarray, "k 4"]) -> Int[np.ndarray, "t 3"]:
    """Halve quadrangles, at the diagonal that is inside."""
    first, second = quads[:, [0, 1, 2, 0, 2, 3]], quads[:, [1, 2, 3, 1, 3, 0]]
    inside = (quads.max(axis=1) >= len(points)) | (quads.min(axis=1) < 0)  # refused later
    a, b, c, d = (points[np.where(inside, 0, column)] for column in quads.T)
    turn = (np.cross(b - a, c - a) * np.cross(c - a, d - a)).sum(axis=1)
    inside |= turn >= 0.0
    return np.where(inside[:, None], first, second).reshape(-1, 3)


def _polygons(points: Points, polygons: Int[np.ndarray, "k c"]) -> Int[np.ndarray, "t 3"]:
    """Divide polygons of five corners or more."""
    import pyvista

    if polygons.min() < 0 or polygons.max() >= len(points):
        raise ValueError(f"a face has a vertex that is not one of {len(points)}")
    width = polygons.shape[1]
    rows = np.column_stack((np.full(len(polygons), width), polygons))
    surface = pyvista.PolyData(points, rows.ravel())
    triangles = surface.triangulate().faces.reshape(-1, 4)[:, 1:].astype(np.int64)
    if len(triangles) != (width - 2) * len(polygons):
        raise ValueError(
            f"faces of {width} vertices cannot be divided: they are not flat, or their sides "
            "cross; write triangles"
        )
    return triangles


_DIVISIONS: dict[int, Callable[[Points, np.ndarray], Triangles]] = {
    3: lambda points, faces: faces,
    4: _quads,
}
