"""Reading of MetaImage (.mha, .mhd) and NRRD (.nrrd, .nhdr, .seg.nrrd), through SimpleITK."""

import importlib.util
import logging
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from tactorch.budget import DEFLATE, check_memory, check_stored
from tactorch.errors import ConfigError, FileError

_log = logging.getLogger(__name__)
#: Formats by suffix, in SimpleITK.
ITK_FORMATS = {
    ".mha": "MetaImageIO", ".mhd": "MetaImageIO", ".nrrd": "NrrdImageIO", ".nhdr": "NrrdImageIO",
}  # fmt: skip
_HEADER_BYTES = 1 << 20
_META_END = re.compile(rb"^[ \t]*ElementDataFile[ \t]*=[^\n]*\n?", re.MULTILINE | re.IGNORECASE)
_NRRD_END = re.compile(rb"\r?\n[ \t]*\r?\n|\Z")
_DATA = ("elementdatafile", "datafile")
_SIZES = ("dimsize", "sizes")
_SPACINGS = ("elementspacing", "elementsize", "spacings", "spacedirections")
_UNITS = {"mm": "mm", "millimeter": "mm", "cm": "cm", "m": "m", "um": "um", "micron": "um"}
# Bytes of a number: of MetaImage without the prefix MET_, and of NRRD.
_BYTES = {
    "char": 1, "uchar": 1, "signedchar": 1, "unsignedchar": 1, "int8": 1, "uint8": 1, "int8_t": 1,
    "uint8_t": 1, "short": 2, "ushort": 2, "unsignedshort": 2, "int16": 2, "uint16": 2,
    "int16_t": 2, "uint16_t": 2, "shortint": 2, "int": 4, "uint": 4, "unsignedint": 4, "int32": 4,
    "uint32": 4, "int32_t": 4, "uint32_t": 4, "float": 4,
}  # fmt: skip


def read_itk(source: Path) -> tuple[np.ndarray, Float[np.ndarray, "4 4"], str, dict[int, str]]:
    """Read the array of a file, its affine matrix, their unit, and the names of segments.

    The matrix leads to patient coordinates (left, posterior, superior), to which those of a file of
    NRRD with another `space` are converted.

    Raises:
        ConfigError: SimpleITK is not installed.
        FileError: The file is damaged or too large, its data are in another folder, or its
            segments overlap.
    """
    if importlib.util.find_spec("SimpleITK") is None:
        raise ConfigError("Reading MHA and NRRD needs SimpleITK: pip install 'tactorch[volumes]'.")
    import SimpleITK

    kind = ITK_FORMATS[source.suffix.lower()]
    fields = _fields(source, kind)
    _check(source, fields)
    try:
        SimpleITK.ProcessObject.SetGlobalWarningDisplay(False)
        image = SimpleITK.ReadImage(str(source), imageIO=kind)
    except RuntimeError as error:
        reason = str(error).strip().splitlines()[-1]
        raise FileError(
            f"'{source}' cannot be read by SimpleITK: {reason} Is the file complete?"
        ) from error
    values: Any = SimpleITK.GetArrayFromImage(image)
    axes = image.GetDimension()
    parts = values.shape[axes:]  # layers of segments, or colours
    values = values.transpose([*range(axes)[::-1], *range(axes, axes + len(parts))])
    if axes < 3:
        raise FileError(f"'{source}' is an image of {axes} axes; give a volume, of three.")
    affine = np.eye(4)
    turn = np.array(image.GetDirection()).reshape(axes, axes)[:3, :3]
    affine[:3, :3] = turn * np.array(image.GetSpacing()[:3])
    affine[:3, 3] = image.GetOrigin()[:3]
    if not any(key in fields for key in _SPACINGS):
        _log.warning("'%s' does not state the size of its voxels: 1 is taken.", source)
    notes = {key: image.GetMetaData(key) for key in image.GetMetaDataKeys()}
    labels, names = _segments(source, values, notes, layers=bool(parts))
    return labels, affine, _unit(fields), names


def _fields(source: Path, kind: str) -> dict[str, list[str]]:
    """Return the values of each field of the header, by its name without spaces and capitals."""
    with source.open("rb") as file:
        head = file.read(_HEADER_BYTES)
    separator, end = ("=", _META_END) if kind == "MetaImageIO" else (":", _NRRD_END)
    match = end.search(head)
    if match is None:
        raise FileError(f"'{source}' has no header of {kind.removesuffix('IO')}; write it again.")
    fields: dict[str, list[str]] = {}
    for line in head[: match.end()].decode("utf-8", errors="replace").splitlines():
        key, _, value = line.partition(separator)
        fields.setdefault(key.replace(" ", "").lower(), []).append(value.strip())
    return fields


def _check(source: Path, fields: Mapping[str, list[str]]) -> None:
    """Compare what the header states with the files and with the limits."""
    data = source
    for name in (name for key in _DATA for name in fields.get(key, ())):
        if name.upper() != "LOCAL":
            data = (source.parent / name).resolve()
            if source.parent.resolve() not in data.parents or not data.is_file():
                raise FileError(
                    f"'{source}' has its data in '{name}', which is no file in its folder; write "
                    "header and data as one file (.mha, .nrrd), or copy the data there."
                )
    sizes = _numbers(source, fields, _SIZES)
    if not sizes or min(sizes) < 1:
        raise FileError(f"'{source}' has no sizes of at least one voxel; write it again.")
    channels = _numbers(source, fields, ("elementnumberofchannels",)) or [1.0]
    voxels = float(np.prod(sizes)) * channels[0]
    kind = (fields.get("elementtype") or fields.get("type") or [""])[0].lower().replace(" ", "")
    size = _BYTES.get(kind.removeprefix("met_"), 8)
    claim = f"{' x '.join(f'{n:g}' for n in sizes)} voxels of {size} bytes"
    check_memory(source, claim, voxels * (2 * size + 8))  # and as labels
    packed = (fields.get("compresseddata") or ["false"])[0].lower() == "true"
    encoding = (fields.get("encoding") or ["gzip" if packed else "raw"])[0].lower()
    least = {"raw": size, "ascii": 1, "text": 1, "txt": 1, "hex": 2 * size}.get(
        encoding, size / DEFLATE
    )
    if not encoding.startswith("bz"):
        check_stored(data, claim, voxels * least)


def _numbers(source: Path, fields: Mapping[str, list[str]], keys: tuple[str, ...]) -> list[float]:
    text = next((value for key in keys for value in fields.get(key, ())), "")
    try:
        return [float(word) for word in text.split()]
    except ValueError as error:
        raise FileError(
            f"'{source}' states {keys[0]} as '{text[:80]}', which are no numbers; write it again."
        ) from error


def _unit(fields: Mapping[str, list[str]]) -> str:
    """Return the unit of a header, as all axes have it, or mm."""
    units = set(re.findall(r'"([^"]+)"', " ".join(fields.get("spaceunits", ()))))
    return _UNITS.get(units.pop().lower(), "mm") if len(units) == 1 else "mm"


def _segments(
    source: Path, values: np.ndarray, notes: Mapping[str, str], *, layers: bool
) -> tuple[np.ndarray, dict[int, str]]:
    """Return labels, and the names of the segments of 3D Slicer.

    Segments of several layers, which are the last axis, are numbered from 1.
    """
    count = sum(re.fullmatch(r"Segment\d+_LabelValue", key) is not None for key in notes)
    names = [notes.get(f"Segment{i}_Name", f"segment {i}") for i in range(count)]
    numbers = [int(notes.get(f"Segment{i}_LabelValue", i + 1)) for i in range(count)]
    if not layers or not count:
        return values, dict(zip(numbers, names, strict=True))
    labels = np.zeros(values.shape[:-1], dtype=np.int32)
    for i, number in enumerate(numbers):
        inside = values[..., int(notes.get(f"Segment{i}_Layer", 0))] == number
        if (labels[inside] != 0).any():
            raise FileError(
                f"'{source}' has segments that overlap, such as '{names[i]}'; export segments that "
                "do not."
            )
        labels[inside] = i + 1
    return labels, dict(enumerate(names, start=1))
