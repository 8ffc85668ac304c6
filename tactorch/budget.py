"""Limits of the memory: for files of unknown origin, the depth of their nesting, and arrays.

A file may state sizes that it does not hold, expand to far more than its size, or be nested deeper
than a parser can follow. Readers compare what a file states with these limits before they allocate
memory or loop over it. The memory for one file is 1.5 GiB, or half of the free memory where that is
less; the environment variable `TACTORCH_FILE_GIB` sets another number of GiB. Computations whose
arrays grow with the number of presses work in parts so that the arrays of each take 4 GiB at most,
or half of the free memory where that is less; `TACTORCH_WORK_GIB` sets another number.
"""

import gzip
import io
import math
import os
import zlib
from collections.abc import Callable, Mapping, Sequence
from itertools import accumulate
from pathlib import Path
from typing import Any, BinaryIO
from zipfile import ZIP_DEFLATED, ZIP_LZMA, ZIP_STORED, ZipFile, ZipInfo

from tactorch.errors import ConfigError, FileError, TactorchError

_VARIABLE = "TACTORCH_FILE_GIB"
_WORK_VARIABLE = "TACTORCH_WORK_GIB"
_GIB = 1 << 30
_MAX_BYTES = 3 * _GIB // 2
_MAX_WORK_BYTES = 4 * _GIB
_SMALL = 1 << 24  # bytes that are read however little memory is free
#: Largest expansion by deflate: gzip, zlib, .npz, and compressed HDF5.
DEFLATE = 1032
#: Bytes of Python objects for each byte of JSON, or of a table of text.
TEXT = 30
#: Nested tables and lists in YAML and JSON.
MAX_DEPTH = 32
#: Bytes of a YAML file; settings that people write are far smaller.
MAX_YAML = 1_000_000
#: Characters of a value in YAML without quotes: a hexadecimal number of 4300 decimal digits, which
#: is the longest that Python shows, has 3570, and the time for numbers grows as their square.
MAX_PLAIN = 3000
#: Pixels of a picture, and of a frame of a video.
MAX_PIXELS = 100_000_000
_MAX_EXPANDED = 10**7  # characters of settings that refer to others
_MAX_WORD = 20_000  # characters of a setting as typed, which take a second
_PIECE = 1 << 12  # of compressed data; LZMA expands it to 30 MB at most, bzip2 to GB
_PACKERS = (ZIP_STORED, ZIP_DEFLATED, ZIP_LZMA)


def max_bytes() -> int:
    """Return how many bytes of memory the content of one file may take.

    Raises:
        ConfigError: The environment variable `TACTORCH_FILE_GIB` is not a positive number.
    """
    return _limit(_VARIABLE, _MAX_BYTES)


def work_bytes() -> int:
    """Return how many bytes of memory the arrays of one computation may take.

    Raises:
        ConfigError: The environment variable `TACTORCH_WORK_GIB` is not a positive number.
    """
    return _limit(_WORK_VARIABLE, _MAX_WORK_BYTES)


def check_work(what: str, needed: float) -> None:
    """Refuse arrays of a computation, before they are made, that take more than `work_bytes`.

    Raises:
        ConfigError: They take more.
    """
    if needed > (limit := work_bytes()):
        raise ConfigError(
            f"{what} would take {_size(needed)} of memory, and the arrays of one computation may "
            f"take {_size(limit)}; use fewer presses or a coarser mesh, or set TACTORCH_WORK_GIB="
            f"{math.ceil(needed / _GIB)} if the memory suffices."
        )


def _limit(variable: str, most: int) -> int:
    """Return the bytes that a variable states; half of the free memory or `most` without it."""
    if not (text := os.environ.get(variable)):
        return min(most, _free_bytes(2 * most) // 2)
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not 0.0 < number < math.inf:
        raise ConfigError(f"{variable}={text!r} is not a positive number; give GiB, such as 4.")
    return int(number * _GIB)


def _free_bytes(free: int) -> int:
    """Return the memory that is free without swapping, or that of the container if it is less.

    It is `free` at most.
    """
    for path, name, unit in (
        ("/proc/meminfo", "MemAvailable:", 1024),
        ("/sys/fs/cgroup/memory.max", "", 1),
    ):
        try:
            line = next(x for x in Path(path).read_text().splitlines() if x.startswith(name))
            free = min(free, int(line.removeprefix(name).split()[0]) * unit)
        except (OSError, ValueError, StopIteration):  # another system; a container without limit
            continue
    return free


def check_memory(
    source: object, claim: str, needed: float, error: type[TactorchError] = FileError
) -> None:
    """Refuse content that needs too much memory.

    Args:
        source: The file in messages, such as "mesh 'a.ply'", or its path.
        claim: What the file states, such as "1000000000 faces".
        needed: Memory for it in bytes, after conversion (of float32 to float64, for example) and
            with the copies that exist at the same time.
        error: Class of the error.

    Raises:
        TactorchError: It is more than `max_bytes`.
    """
    if needed <= _SMALL and not os.environ.get(_VARIABLE):
        return  # most content: asking the system takes longer than reading it
    if needed <= (limit := max_bytes()):
        return
    raise error(
        f"{_name(source)} is too large: {claim} would take {_size(needed)} of memory, and one file "
        f"may take {_size(limit)}; give a smaller file, or set TACTORCH_FILE_GIB="
        f"{math.ceil(needed / _GIB)} if its origin is trusted and the memory suffices."
    )


def check_stored(source: Path, claim: str, needed: float) -> None:
    """Refuse a file that states more than it holds.

    Args:
        source: The file.
        claim: What the file states, such as "1000000000 faces".
        needed: Least number of bytes in a file that can hold it; with compression, the number
            before it over `DEFLATE`.

    Raises:
        FileError: It holds less than that.
    """
    if needed > (stored := source.stat().st_size):
        raise FileError(
            f"{_name(source)} is incomplete or its header is wrong: {claim} take "
            f"{_size(needed)} or more, and it holds {_size(stored)}; write it again, or copy it "
            "again from its source."
        )


def read_content(path: Path, expansion: float = 1.0) -> bytes:
    """Return the content of a file, if the memory for it suffices.

    `expansion` is the bytes of memory for each byte, such as `TEXT`.

    Raises:
        FileError: The file is too large.
        OSError: It cannot be read.
    """
    with open(path, "rb") as file:
        size = os.fstat(file.fileno()).st_size
        check_memory(path, f"its content of {_size(size)}", size * expansion)
        return file.read(size)


def gunzip(path: Path, rest: float = 0.0) -> io.BytesIO:
    """Return the content of a file that is compressed by gzip, as far as it may be in memory.

    `rest` is the bytes of memory that the values of the content take besides it.

    Raises:
        FileError: The content is too large.
        OSError, EOFError, zlib.error: It cannot be read.
    """
    memory = io.BytesIO()
    with gzip.open(path, "rb") as file:
        while piece := file.read(1 << 20):
            size = memory.tell() + len(piece)
            check_memory(path, f"its unpacked content of {_size(size)} or more", size + rest)
            memory.write(piece)
    memory.seek(0)
    return memory


class Unpacking:
    """Unpacking of the compressed parts of a file, as far as all may be in memory.

    `copies` of the content exist at the same time.
    """

    def __init__(self, path: Path, copies: float) -> None:
        self._path, self._copies, self._size = path, copies, 0

    def add(self, size: int) -> None:
        """Count a part that is not compressed, and refuse it if all so far are too large."""
        self._size += size
        claim = f"its unpacked content of {_size(self._size)} or more"
        check_memory(self._path, claim, self._copies * self._size)

    def part(self, make: Callable[[], Any], data: bytes | memoryview) -> bytearray:
        """Return what a part contains; `make` returns a decompressor.

        Raises:
            FileError: The parts so far are too large.
            EOFError, zlib.error, lzma.LZMAError: It cannot be read.
        """
        unpacked, content = make(), bytearray()
        while not unpacked.eof:
            piece = unpacked.decompress(data, 1 << 20)
            data = getattr(unpacked, "unconsumed_tail", b"")  # LZMA keeps what it has not consumed
            if not piece and not data:
                raise EOFError("a compressed part is incomplete")
            self.add(len(piece))
            content += piece
        return content


def check_deflated(path: Path, file: BinaryIO) -> None:
    """Refuse a raw stream of deflate in an open file that unpacks to too much; see `gunzip`."""
    unpacked, size = zlib.decompressobj(-zlib.MAX_WBITS), 0
    while (piece := unpacked.unconsumed_tail or file.read(_PIECE)) and not unpacked.eof:
        size += len(unpacked.decompress(piece, 1 << 20))
        check_memory(path, f"its unpacked content of {_size(size)} or more", 2 * size)


def check_archive(path: object, archive: ZipFile, copies: float = 1.0) -> None:
    """Refuse an archive whose unpacked members, in `copies`, need too much memory, or bzip2."""
    if any(entry.compress_type not in _PACKERS for entry in archive.infolist()):
        raise FileError(
            f"{_name(path)} is compressed by bzip2, which is not read; write it again with deflate."
        )
    total = sum(entry.file_size for entry in archive.infolist())
    check_memory(path, f"its unpacked content of {_size(total)}", copies * total)


def unpack(archive: ZipFile, entry: ZipInfo) -> bytearray:
    """Return a member of an archive, after `check_archive`; its checksum is verified.

    `ZipFile.read` expands all of a member that is compressed by LZMA, whatever its size is said to
    be.
    """
    content = bytearray()
    with archive.open(entry) as member:
        while piece := member.read(_PIECE if entry.compress_type == ZIP_LZMA else 1 << 20):
            content += piece
    return content


def check_depth(source: object, value: Any, error: type[TactorchError] = FileError) -> None:
    """Refuse tables and lists that are nested deeper than `MAX_DEPTH`."""
    level: list[Any] = [[value]]
    for _ in range(MAX_DEPTH + 1):
        tables = (v.values() if isinstance(v, Mapping) else v for v in level)
        level = [x for v in tables for x in v if isinstance(x, Mapping | list | tuple)]
        if not level:
            return
    raise too_deep(source, error)


def check_references(source: object, settings: Sequence[str]) -> None:
    """Refuse settings whose references, ${NAME}, to each other may expand to too much text."""
    factor = math.prod(max(1, setting.count("${")) for setting in settings)
    if factor * sum(map(len, settings)) > _MAX_EXPANDED:
        raise FileError(
            f"{_name(source)} has settings that refer to others (${{NAME}}) many times, which may "
            f"expand to more than {_MAX_EXPANDED:.0e} characters; write the values in their place."
        )


def check_words(words: Sequence[str]) -> None:
    """Refuse settings as typed that Hydra cannot parse in reasonable time, or at all.

    Raises:
        ConfigError: One is too long, or has brackets within too many others.
    """
    for word in words:
        depths = accumulate((c in "[{(") - (c in "]})") for c in word)
        if len(word) > _MAX_WORD or max(depths, default=0) > MAX_DEPTH:
            raise ConfigError(
                f"the setting '{word[:40]}...' has more than {_MAX_WORD} characters, or more than "
                f"{MAX_DEPTH} brackets within each other; give a shorter value."
            )


def too_deep(source: object, error: type[TactorchError] = FileError) -> TactorchError:
    """Return the error of content that is nested deeper than `MAX_DEPTH`."""
    return error(
        f"{_name(source)} is nested deeper than {MAX_DEPTH} levels of tables and lists; write it "
        "with fewer."
    )


def _name(source: object) -> str:
    return f"'{source}'" if isinstance(source, Path) else str(source)


def _size(number: float) -> str:
    """Return a number of bytes as text."""
    for unit, size in (("GiB", _GIB), ("MiB", 1 << 20)):
        if number >= size:
            return f"{number / size:.3g} {unit}"
    return f"{math.ceil(number)} bytes"
