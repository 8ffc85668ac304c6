"""Reading of NRRD (.nrrd, .nhdr, .seg.nrrd of 3D Slicer) and MetaImage (.mha, .mhd).

The libraries that read both end the process on some damaged files.
"""

import bz2
import logging
import re
import zlib
from collections.abc import Mapping
from math import prod
from pathlib import Path
from unicodedata import normalize

import numpy as np
from jaxtyping import Float

from tactorch.budget import DEFLATE, TEXT, check_memory, check_stored
from tactorch.errors import FileError
from tactorch.volumes.volume import Content

_log = logging.getLogger(__name__)
SUFFIXES = (".nrrd", ".nhdr", ".mha", ".mhd")
_HEADER_BYTES = 1 << 20
_META_END = re.compile(rb"^[ \t]*ElementDataFile[ \t]*=[^\n]*\n?", re.MULTILINE | re.IGNORECASE)
_NRRD_END = re.compile(rb"\r?\n[ \t]*\r?\n|\Z")
_TYPE = re.compile("(met)?(u|unsigned|signed)?(char|longlong|long|short|int(8|16|32|64)?)(int)?t?")
_SIZES = {"char": 1, "short": 2, "int": 4, "long": 8, "metlong": 4, "longlong": 8}
_FLOATS = {"float": "f4", "metfloat": "f4", "double": "f8", "metdouble": "f8"}
_PARTS = 32  # of a volume whose segments are found at once, which takes 16 bytes for each voxel
_PACKED = ("gzip", "gz", "bzip2", "bz2")
_UNITS = {
    "mm": "mm", "millimeter": "mm", "millimetre": "mm", "cm": "cm", "centimeter": "cm",
    "centimetre": "cm", "m": "m", "meter": "m", "metre": "m", "um": "um", "\u03bcm": "um",
    "micron": "um", "micrometer": "um", "micrometre": "um",
}  # fmt: skip
_OPPOSITE = {"right": 0, "anterior": 1, "inferior": 2}  # of left, posterior, superior
_PATIENT = {*_OPPOSITE, "left", "posterior", "superior", "time"}
_SHORT = {"r": "right", "a": "anterior", "i": "inferior"}

_Fields = Mapping[str, list[str]]


def read_nrrd(source: Path) -> Content:
    """Read a file.

    The matrix leads to patient coordinates (left, posterior, superior), to which those of NRRD with
    another `space` are converted.

    Raises:
        FileError: The file is damaged or too large, its data are in another folder, or its
            segments overlap.
    """
    fields, start = _header(source)
    try:
        values = _data(source, fields, start)
        affine, domain = _place(fields, values.ndim)
        layers = [axis for axis in range(values.ndim) if axis not in domain]
        if values.ndim > 3 and len(domain) == 3:
            values = values.transpose(*domain, *layers)
        labels, names = _segments(source, values, fields)
    except (ValueError, IndexError, OSError, EOFError, OverflowError, zlib.error) as error:
        raise FileError(
            f"'{source}' cannot be read ({error}); copy it again from its source."
        ) from error
    if not {"elementspacing", "elementsize", "spacings", "spacedirections"} & set(fields):
        _log.warning("'%s' does not state the size of its voxels: 1 is taken.", source)
    return labels, affine, _unit(fields), names


def _unit(fields: _Fields) -> str:
    """Return the unit of the three axes of space, in the words of the file where not known."""
    stated = re.findall(r'"([^"]+)"', _first(fields, "spaceunits"))[:3]
    plain = (normalize("NFKC", unit).strip().lower().removesuffix("s") for unit in stated)
    units = {_UNITS.get(name, unit) for name, unit in zip(plain, stated, strict=True)}
    return ", ".join(sorted(units)) or "mm"


def _header(source: Path) -> tuple[_Fields, int]:
    """Return the values of each field, by its name in small letters, and the end of the header."""
    with source.open("rb") as file:
        head = file.read(_HEADER_BYTES)
    is_meta = source.suffix.lower() in (".mha", ".mhd")
    end = (_META_END if is_meta else _NRRD_END).search(head)
    if end is None or not (is_meta or head.startswith(b"NRRD")):
        raise FileError(f"'{source}' has no header of {'MetaImage' if is_meta else 'NRRD'}.")
    fields: dict[str, list[str]] = {}
    for line in head[: end.end()].decode("utf-8", errors="replace").splitlines():
        key, _, value = line.partition("=" if is_meta else ":")
        name = key.replace(" ", "").lower()
        fields.setdefault(name, []).append(value.removeprefix("=").strip())
    return fields, end.end()


def _first(fields: _Fields, *names: str) -> str:
    return next((value for name in names for value in fields.get(name, ())), "")


def _numbers(fields: _Fields, *names: str) -> list[float]:
    return [float(word) for word in _first(fields, *names).split()]


def _data(source: Path, fields: _Fields, start: int) -> np.ndarray:
    """Read the array, after comparing its size with the file and the limits."""
    path = _data_path(source, fields)
    sizes = [int(word) for word in _first(fields, "sizes", "dimsize").split()]
    channels = int(_first(fields, "elementnumberofchannels") or 1)
    if not sizes or min(*sizes, channels) < 1:
        raise ValueError(f"its sizes are {sizes}")
    order = _first(fields, "endian", "elementbyteordermsb", "binarydatabyteordermsb").lower()
    dtype = np.dtype(("><"[order not in ("big", "true")]) + _code(fields))
    count = prod(sizes) * channels
    claim = f"{' x '.join(map(str, sizes))} voxels of {dtype.itemsize} bytes"
    check_memory(source, claim, count * (3 * dtype.itemsize + 8))  # and as labels
    packed = _first(fields, "compresseddata").lower() == "true"
    encoding = _first(fields, "encoding").lower() or ("gzip" if packed else "raw")
    text = encoding in ("ascii", "text", "txt") or _first(fields, "binarydata").lower() == "false"
    least = 1.0 if text else dtype.itemsize / (DEFLATE if encoding in _PACKED else 1)
    if not encoding.startswith("bz"):
        check_stored(path, claim, count * least)
    size = count * dtype.itemsize
    longest = 2 * size + _HEADER_BYTES if encoding in _PACKED else size
    if text:
        longest = path.stat().st_size
        check_memory(path, f"its text of {longest / 1e6:.0f} MB", TEXT * longest)
    content = _content(path, fields, start if path == source else 0, longest)
    if text:
        values = np.array(content.split()[:count], dtype=np.float64)
    else:
        values = np.frombuffer(_unpacked(content, encoding, size), dtype, count)
    shape = ([channels] if channels > 1 else []) + sizes
    return values.reshape(shape, order="F")


def _code(fields: _Fields) -> str:
    """Return the type of a value in the words of NumPy, such as "i4"."""
    stated = _first(fields, "type", "elementtype")
    name = re.sub("[ _]", "", stated.lower())
    match = _TYPE.fullmatch(name)
    if match is None and name not in _FLOATS:
        raise ValueError(f"its type '{stated[:40]}' is not known")
    if match is None:
        return _FLOATS[name]
    kind = "metlong" if match[1] and match[3] == "long" else match[3]
    size = int(match[4]) // 8 if match[4] else _SIZES[kind]
    return f"{'u' if match[2] and match[2][0] == 'u' else 'i'}{size}"


def _data_path(source: Path, fields: _Fields) -> Path:
    """Return the file of the data, which must be in the folder of the header."""
    name = _first(fields, "datafile", "elementdatafile") or "LOCAL"
    path = source if name.upper() == "LOCAL" else (source.parent / name).resolve()
    if path != source and (source.parent.resolve() not in path.parents or not path.is_file()):
        raise FileError(
            f"'{source}' has its data in '{name}', which is no file in its folder; write header "
            "and data as one file (.mha, .nrrd), or copy the data there."
        )
    return path


def _content(path: Path, fields: _Fields, start: int, longest: int) -> bytes:
    """Read the data up to a length, without lines and bytes that the header says to skip."""
    with path.open("rb") as file:
        file.seek(start)
        for _ in range(int(_first(fields, "lineskip") or 0)):
            if not file.readline(_HEADER_BYTES):
                break
        skipped = int(_first(fields, "byteskip", "headersize") or 0)
        last = max(path.stat().st_size - longest, 0)
        file.seek(file.tell() + skipped if skipped >= 0 else last)
        return file.read(longest)


def _unpacked(content: bytes, encoding: str, size: int) -> bytes:
    """Return as many bytes as the array has."""
    if encoding in ("gzip", "gz"):
        return zlib.decompressobj(wbits=47).decompress(content, size)
    if encoding in ("bzip2", "bz2"):
        return bz2.BZ2Decompressor().decompress(content, size)
    if encoding != "raw":
        raise ValueError(f"its encoding '{encoding[:40]}' is not known")
    return content


def _place(fields: _Fields, axes: int) -> tuple[Float[np.ndarray, "4 4"], list[int]]:
    """Return the affine matrix, and the axes of the array that are those of space."""
    affine, domain = np.eye(4), list(range(axes))
    vectors = re.findall(r"none|\([^)]*\)", _first(fields, "spacedirections"))
    if vectors:
        domain = [axis for axis, words in enumerate(vectors) if words != "none"]
        columns = [_vector(vectors[axis]) for axis in domain]
    else:
        kinds = _first(fields, "kinds").split()
        domain = [axis for axis in domain if axis >= len(kinds) or kinds[axis] != "list"]
        if int(_first(fields, "elementnumberofchannels") or 1) > 1:
            domain = domain[1:]
        spacing = _numbers(fields, "elementspacing", "elementsize", "spacings") or [1.0] * axes
        count = int(_first(fields, "ndims") or 0)
        turn = _numbers(fields, "transformmatrix", "rotation", "orientation")
        table = np.array(turn).reshape(count, count) if turn else np.eye(max(len(domain), 3))
        steps = [spacing[axis] for axis in domain] if len(spacing) == axes else spacing
        columns = [step * row for step, row in zip(steps, table, strict=False)]
    for axis, column in enumerate(columns[:3]):
        affine[: len(column[:3]), axis] = column[:3]
    origin = _first(fields, "spaceorigin")
    at = _vector(origin) if origin else _numbers(fields, "offset", "position", "origin")
    affine[: len(at[:3]), 3] = at[:3]
    affine[_signs(_first(fields, "space"))] *= -1.0
    return affine, domain


def _vector(text: str) -> Float[np.ndarray, " k"]:
    return np.array([float(word) for word in text.strip("()").split(",")])


def _signs(space: str) -> list[int]:
    """Return the axes of a space that are opposite to left, posterior, superior."""
    words = space.lower().split("-")
    if len(words) == 1 and re.fullmatch("[lr][ap][si]t?", words[0]):
        words = [_SHORT.get(letter, "left") for letter in words[0]]
    is_of_patient = _PATIENT.issuperset(words)  # unlike "3D-right-handed"
    return [_OPPOSITE[word] for word in words if is_of_patient and word in _OPPOSITE]


def _segments(
    source: Path, values: np.ndarray, fields: _Fields
) -> tuple[np.ndarray, dict[int, str]]:
    """Return labels, and the names of the segments of 3D Slicer.

    Segments of several layers, which are the last axis, are numbered from 1.
    """
    count = sum(re.fullmatch(r"segment\d+_labelvalue", key) is not None for key in fields)
    names = [_first(fields, f"segment{i}_name") or f"segment {i}" for i in range(count)]
    numbers = [int(_first(fields, f"segment{i}_labelvalue") or i + 1) for i in range(count)]
    if values.ndim != 4 or not count:
        return values, dict(zip(numbers, names, strict=True))
    labels = np.zeros(values.shape[:-1], dtype=np.int32)
    layers = np.array([int(_first(fields, f"segment{i}_layer") or 0) for i in range(count)])
    stated, axis = np.array(numbers, dtype=np.int64), int(np.argmax(labels.shape))
    order = np.argsort(stated, kind="stable")
    for layer in np.unique(layers).tolist():
        rows = order[layers[order] == layer]
        known = stated[rows]
        wrong = rows[1:][known[1:] == known[:-1]].tolist()
        parts = (np.array_split(a, _PARTS, axis) for a in (values[..., layer], labels))
        for part, label in zip(*parts, strict=True):
            place = np.searchsorted(known, part).clip(max=len(known) - 1)
            inside = known[place] == part
            wrong += rows[place[inside & (label != 0)][:1]].tolist()
            if wrong:
                raise FileError(
                    f"'{source}' has segments that overlap, such as '{names[wrong[0]]}'; export "
                    "segments that do not."
                )
            label[inside] = rows[place[inside]] + 1
    return labels, dict(enumerate(names, start=1))
