"""Meshes of Abaqus and CalculiX (.inp): nodes, solid elements and sets of elements of one part."""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from tactorch.budget import check_memory, read_content
from tactorch.errors import FileError, MeshError
from tactorch.mesh.formats.cells import Cells, MeshFile
from tactorch.mesh.formats.groups import regions_of_groups
from tactorch.mesh.formats.numbers import places

_EXPANSION = 16  # bytes of memory for each of the file
_DEPTH = 10  # of files that include one another
_INCLUDED = 1000  # files
_INPUT = re.compile(r"\*\s*(INCLUDE|NODE|ELEMENT|ELSET)\b.*?,\s*INPUT\s*=\s*([^,]+)", re.IGNORECASE)
_TYPE = re.compile(r"(?:[A-Z]*C3D|F3D|SC|CSS)(\d+)[A-Z]*$")
_SHAPE = {4: "tetra", 5: "pyramid", 6: "wedge", 8: "hexahedron", 10: "tetra", 13: "pyramid"}
_SHAPE |= {15: "wedge", 20: "hexahedron", 27: "hexahedron"}
_MADE = ("NGEN", "NFILL", "NCOPY", "NMAP", "ELGEN", "ELCOPY", "SYSTEM")


_Member = np.ndarray | range | str  # numbers of elements, or the name of another set


class _Keyword(NamedTuple):
    """A keyword with its parameters and the lines of data after it."""

    name: str
    parameters: dict[str, str]
    data: list[str]


@dataclass(eq=False)
class _Part:
    """Nodes, elements and sets of a part, or of a file without parts."""

    nodes: dict[int, list[float]] = field(default_factory=dict)
    elements: list[tuple[int, np.ndarray]] = field(default_factory=list)  # nodes of one; rows
    others: list[np.ndarray] = field(default_factory=list)  # numbers of those that are not solid
    sets: dict[str, list[_Member]] = field(default_factory=dict)
    sections: set[str] = field(default_factory=set)  # sets that have a material
    places: list[list[str]] = field(default_factory=list)  # data of its instances


def read_abaqus(path: Path) -> MeshFile:
    """Read a file; regions are the sets of its solid sections, or else its sets of elements.

    Raises:
        FileError: It includes a file that is not in its folder, or itself.
        MeshError: It has several parts, or nodes and elements that other keywords make.
        ValueError: It is damaged.
    """
    parts: dict[str, _Part] = {"": _Part()}
    part_of = {"": ""}  # an instance
    scope = ""
    for keyword in _keywords(path):
        name, given = keyword.name, keyword.parameters
        if name in ("PART", "INSTANCE"):
            scope = _key(given.get("PART" if name == "INSTANCE" else "NAME", ""))
            part = parts.setdefault(scope, _Part())
            if name == "INSTANCE":
                part_of[_key(given.get("NAME", ""))] = scope
                part.places.append(keyword.data)
        elif name in ("END PART", "END INSTANCE"):
            scope = ""
        elif name in _MADE:
            raise MeshError(
                f"*{name} makes or moves nodes or elements, which is not read; write them all."
            )
        else:
            _read(keyword, parts[part_of.get(_key(given.get("INSTANCE", "")), "") or scope])
    if scope:
        raise ValueError(f"it has no *END for the part {scope}")
    solid = {name: part for name, part in parts.items() if part.elements}
    if len(solid) > 1:
        raise MeshError(f"it has {len(solid)} parts ({', '.join(solid)}); write one of them.")
    name, part = next(iter(solid.items()), ("", parts[""]))
    if len(part.places) > 1:
        raise MeshError(f"the part {name} has {len(part.places)} instances; write one of them.")
    return _assembled(part, path)


def _key(name: str) -> str:
    return name.strip().strip('"').upper()


def _keywords(path: Path) -> Iterator[_Keyword]:
    """Return the keywords of a file and those that it includes; names are in capitals."""
    current: _Keyword | None = None
    for line in _lines(path, path.resolve().parent, (), []):
        if not line.startswith("*"):
            if current is not None:
                current.data.append(line)
            continue
        if current is not None:
            yield current
        name, *words = line[1:].split(",")
        pairs = (word.partition("=") for word in words)
        parameters = {_key(key): value.strip() for key, _, value in pairs}
        current = _Keyword(" ".join(name.split()).upper(), parameters, [])
    if current is not None:
        yield current


def _lines(path: Path, folder: Path, outer: tuple[Path, ...], read: list[int]) -> Iterator[str]:
    """Return lines without comments; `read` lists the bytes of each file."""
    content = read_content(path, _EXPANSION)
    read.append(len(content))
    if len(read) > _INCLUDED:
        raise FileError(f"'{outer[0]}' includes more than {_INCLUDED} files; write one file.")
    check_memory(outer[0] if outer else path, "the files it includes", _EXPANSION * sum(read))
    chain = (*outer, path.resolve())
    lines = iter(content.decode("utf-8", errors="replace").splitlines())
    for text in lines:
        line = text.strip()
        while line.startswith("*") and line.endswith(","):
            line += next(lines, "").strip() or " "
        if line.startswith("**") or not line:
            continue
        included = _INPUT.match(line)
        if included is None or included[1].upper() != "INCLUDE":
            yield line.strip()
        if included is not None:
            yield from _lines(_included(included[2], folder, chain), folder, chain, read)


def _included(name: str, folder: Path, chain: tuple[Path, ...]) -> Path:
    """Return the path of an included file, which must be in the folder of the mesh."""
    given = name.strip().strip("\"'")
    path = (folder / given).resolve()
    reason = (
        "is not in the folder of the mesh; copy it there"
        if folder not in path.parents
        else "includes itself"
        if path in chain
        else f"is included by {_DEPTH} files, one in another; write one file"
        if len(chain) >= _DEPTH
        else ""
        if path.is_file()
        else "is no file; copy it to the folder of the mesh"
    )
    if reason:
        raise FileError(f"'{chain[0]}' includes '{given}', which {reason}.")
    return path


def _read(keyword: _Keyword, part: _Part) -> None:
    """Add what a keyword states."""
    given = keyword.parameters
    if keyword.name == "NODE":
        if _key(given.get("SYSTEM", "R")) != "R":
            raise MeshError("*NODE, SYSTEM= is not read; write Cartesian coordinates.")
        for line in keyword.data:
            number, *x = _words(line)
            part.nodes[int(number)] = [float(v.upper().replace("D", "E")) for v in x[:3]]
    elif keyword.name == "ELEMENT":
        _read_elements(keyword, part)
    elif keyword.name == "ELSET":
        members = part.sets.setdefault(_key(given.get("ELSET", "")), [])
        if "GENERATE" in given:
            for line in keyword.data:
                first, last, *step = (int(word) for word in _words(line))
                members.append(range(first, last + 1, step[0] if step else 1))
        else:
            words = [word for line in keyword.data for word in _words(line)]
            members.append(np.array([int(w) for w in words if w.isdigit()], dtype=np.int64))
            members.extend(_key(word) for word in words if not word.isdigit())
    elif keyword.name == "SOLID SECTION" and "ELSET" in given:
        part.sections.add(_key(given["ELSET"]))


def _words(line: str) -> list[str]:
    return [word.strip() for word in line.split(",") if word.strip()]


def _read_elements(keyword: _Keyword, part: _Part) -> None:
    """Read elements, whose nodes may take several lines."""
    kind = _key(keyword.parameters.get("TYPE", ""))
    match = _TYPE.match(kind)
    width = int(match[1]) if match else 0
    if match and width not in _SHAPE:
        raise MeshError(f"elements {kind} are not known; use C3D4, C3D10, C3D8, C3D20 or the like.")
    if match:
        numbers = [int(word) for line in keyword.data for word in _words(line)]
        if len(numbers) % (1 + width):
            raise ValueError(f"elements {kind} do not have {width} nodes each")
        rows = np.array(numbers, dtype=np.int64).reshape(-1, 1 + width)
        part.elements.append((width, rows))
        members = rows[:, 0]
    else:
        starts = [True, *(not line.endswith(",") for line in keyword.data)]
        first = [
            int(_words(line)[0]) for line, new in zip(keyword.data, starts, strict=False) if new
        ]
        members = np.array(first, dtype=np.int64)
        part.others.append(members)
    if "ELSET" in keyword.parameters:
        part.sets.setdefault(_key(keyword.parameters["ELSET"]), []).append(members)


def _assembled(part: _Part, path: Path) -> MeshFile:
    known = np.array(sorted(part.nodes), dtype=np.int64)
    points = np.array([part.nodes[n] for n in part.nodes], dtype=np.float64).reshape(-1, 3)
    order = np.argsort(np.array(list(part.nodes), dtype=np.int64))
    cells = []
    for width, rows in part.elements:
        name = _SHAPE[width] + ("" if width <= 8 else str(width))
        cells.append(Cells(name, order[places(known, rows[:, 1:], "node")]))
    if part.others:
        cells.append(Cells("others", np.zeros((0, 1), dtype=np.int64)))
    regions = None
    if part.elements:
        numbers = np.concatenate([rows[:, 0] for _, rows in part.elements])
        regions = _regions(part, numbers, path)
    return MeshFile(_placed(points, part), cells, regions)


def _placed(points: Float[np.ndarray, "n 3"], part: _Part) -> Float[np.ndarray, "n 3"]:
    """Return the points at the place of the part's instance: moved, and then turned."""
    rows = [[float(word) for word in _words(line)] for line in (part.places or [[]])[0]]
    if rows:
        points = points + np.array(rows[0][:3])
    if len(rows) > 1:
        start, end, angle = np.array(rows[1][:3]), np.array(rows[1][3:6]), rows[1][6]
        axis = (end - start) / np.linalg.norm(end - start)
        points = start + Rotation.from_rotvec(angle * axis, degrees=True).apply(points - start)
    return points


def _regions(
    part: _Part, numbers: Int[np.ndarray, " e"], path: Path
) -> Int[np.ndarray, " e"] | None:
    """Return the number of the set of each element; sets are numbered from 1, as in the file."""
    sets = _Sets(part, numbers, path)
    chosen = [name for name in part.sets if name in part.sections] or list(part.sets)
    found = {name: rows for name in chosen if len(rows := sets.members(name))}
    names = dict(enumerate(found, start=1))
    members = {number: found[name] for number, name in names.items()}
    return regions_of_groups(members, np.ones(len(numbers)), names, path)


class _Sets:
    """The sets of a part."""

    def __init__(self, part: _Part, numbers: Int[np.ndarray, " e"], path: Path) -> None:
        self._sets, self._path = part.sets, path
        self._order = np.argsort(numbers)
        self._solid = numbers[self._order]
        self._all = np.sort(np.concatenate([numbers, *part.others]))
        self._found: dict[str, np.ndarray] = {}
        self._count = 0

    def members(self, name: str, depth: int = 0) -> Int[np.ndarray, " k"]:
        """Return the solid elements of a set, as indices."""
        if name in self._found:
            return self._found[name]
        if name not in self._sets:
            raise ValueError(f"there is no set of elements {name}")
        if depth > _DEPTH:
            raise MeshError(f"the set {name} is in {_DEPTH} others, one in another, or in itself.")
        parts = [np.zeros(0, dtype=np.int64)]
        for item in self._sets[name]:
            if isinstance(item, str):
                parts.append(self.members(item, depth + 1))
                continue
            if _count(self._all, item) < len(item):
                raise MeshError(
                    f"the set {name} has {len(item)} elements, of which the file does not have all;"
                    " remove the others from the set."
                )
            parts.append(self._order[_inside(self._solid, item)])
        rows = np.unique(np.concatenate(parts))
        self._found[name] = rows
        self._count += len(rows)
        check_memory(self._path, f"{len(self._sets)} sets of elements", 48 * self._count)
        return rows


def _inside(known: Int[np.ndarray, " e"], item: np.ndarray | range) -> Int[np.ndarray, " k"]:
    """Return the places of some numbers among sorted ones."""
    if isinstance(item, range):
        low, high = np.searchsorted(known, [item.start, max(item.stop, item.start)])
        return low + np.flatnonzero((known[low:high] - item.start) % item.step == 0)
    return np.flatnonzero(np.isin(known, item))


def _count(known: Int[np.ndarray, " e"], item: np.ndarray | range) -> int:
    """Return how many of some numbers are among sorted ones."""
    return len(_inside(known, item)) if isinstance(item, range) else int(np.isin(item, known).sum())
