"""Readers of surfaces: STL, Wavefront OBJ and PLY, each as text and, but for OBJ, binary."""

import codecs
import re
from collections.abc import Callable
from itertools import groupby
from pathlib import Path

import numpy as np
from jaxtyping import Int

from tactorch.budget import read_content
from tactorch.mesh.formats.numbers import parse_numbers
from tactorch.mesh.values import Points, Triangles

#: Vertices, and faces in their order: each array has those of equally many vertices.
Polygons = tuple[Points, list[np.ndarray]]
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
_PIECE = 64  # rows that are read at first, as they may differ in length


def read_stl(path: Path) -> Polygons:
    """Read the triangles of all solids of a file; vertices are repeated for each."""
    content = read_content(path, _EXPANSION).removeprefix(codecs.BOM_UTF8)
    count = int.from_bytes(content[80:_HEADER], "little")
    # Binary files may begin with "solid", and have bytes after the triangles.
    whole = len(content) >= _HEADER + _TRIANGLE.itemsize * count and b"\0" in content
    if not whole and re.match(rb"\s*solid\b", content, re.IGNORECASE):
        if not re.search(rb"end\s*solid[^\r\n]*\s*$", content[-1000:], re.IGNORECASE):
            raise ValueError("it has no line 'endsolid' at its end")
        lines = (line.strip() for line in content.splitlines())
        words = b" ".join(line[6:] for line in lines if line[:6].lower() == b"vertex")
        corners = parse_numbers(words).reshape(-1, 3)
    else:
        if len(content) < _HEADER + _TRIANGLE.itemsize * count:
            raise ValueError(f"it states {count} triangles, and has {len(content)} bytes")
        table = (
            np.frombuffer(content, _TRIANGLE, count, _HEADER) if count else np.zeros(0, _TRIANGLE)
        )
        corners = table["corners"].reshape(-1, 3).astype(np.float64)
    return corners, [np.arange(len(corners)).reshape(-1, 3)]


def read_obj(path: Path) -> Polygons:
    """Read the vertices and faces of all groups and objects of a file.

    meshio refuses files whose texture or normal lists differ in length from the vertex list, which
    is most files that have any.
    """
    vertices: list[list[float]] = []
    faces: list[list[int]] = []
    text = read_content(path, 2 * _EXPANSION).decode("utf-8", errors="replace")
    text = re.sub(r"\\[ \t]*\r?\n", " ", text)  # a line may go on in the next one
    for number, line in enumerate(text.splitlines(), start=1):
        key, *fields = line.split("#")[0].split() or [""]
        try:
            if key == "v":
                if len(fields) < 3:
                    raise ValueError(f"a vertex needs three coordinates, not {len(fields)}")
                vertices.append([float(field) for field in fields[:3]])
            elif key == "f":
                # Vertices count from 1, or back from the latest from -1.
                indices = [int(field.split("/")[0]) for field in fields]
                for index in indices:
                    if index == 0 or index < -len(vertices):
                        raise ValueError(f"there is no vertex {index}")
                if len(indices) > 2:
                    faces.append([i - 1 if i > 0 else len(vertices) + i for i in indices])
        except ValueError as error:
            raise ValueError(f"line {number}: {error}") from error
    runs = [np.array(list(run), dtype=np.int64) for _, run in groupby(faces, key=len)]
    return np.array(vertices, dtype=np.float64).reshape(-1, 3), runs


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
    points, faces = np.zeros((0, 3)), []
    place = 0
    for name, count, properties in elements:
        place, tables = _ply_rows(data, place, name, count, properties, order)
        for table in tables:
            fields = table.dtype.names or ()
            if name == "vertex" and {"x", "y", "z"}.issubset(fields):
                rows = np.column_stack([table[axis].astype(np.float64) for axis in "xyz"])
                points = np.concatenate((points, rows)) if len(points) else rows
            key = next((f for f in fields if f in ("vertex_indices", "vertex_index")), None)
            if name == "face" and key is not None and table[key].shape[1] > 2:
                faces.append(table[key].astype(np.int64))
    return points, faces


_Property = tuple[str, str, str | None]  # name, type, and type of the number of a list's items


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
    data: bytes, place: int, name: str, count: int, properties: list[_Property], order: str
) -> tuple[int, list[np.ndarray]]:
    """Return the end of an element's rows, and these as tables with lists of the same lengths."""
    tables: list[np.ndarray] = []
    done, piece = 0, _PIECE
    while done < count:
        if not properties:
            raise ValueError(f"the header states {count} rows of {name} without properties")
        kind = _ply_row(data, place, properties, order)
        rows = min(piece, count - done, (len(data) - place) // max(kind.itemsize, 1))
        if not rows:
            raise ValueError(f"the header states {count} rows of {name}, and the file has {done}")
        table = np.frombuffer(data, kind, rows, place)
        same = np.ones(rows, dtype=bool)
        for key in (key for key in kind.names or () if key.startswith("number of ")):
            same &= table[key] == table[key][0]
        rows = rows if same.all() else int(same.argmin())
        piece = 2 * piece if same.all() else _PIECE
        tables.append(table[:rows])
        done, place = done + rows, place + rows * kind.itemsize
    return place, tables


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


def triangulated(points: Points, faces: list[np.ndarray]) -> Int[np.ndarray, "t 3"]:
    """Return triangles, in the order of the faces, which have equally many vertices per array.

    Raises:
        ValueError: A polygon cannot be divided: it is not flat, or its sides cross.
    """
    return np.concatenate([_DIVISIONS.get(run.shape[1], _polygons)(points, run) for run in faces])


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
