"""Limits of bags of unknown origin: what they unpack to, and what their databases compute."""

import re
import shutil
import sqlite3
import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from tactorch.budget import check_memory, max_bytes
from tactorch.errors import FileError
from tactorch.files import read_yaml

_COPIES = 3  # of a message, as rosbags decodes it
_COMPUTED = re.compile(r"\bas\b|\bvirtual\b", re.IGNORECASE)


@contextmanager
def limited(source: Path) -> Iterator[None]:
    """Limit what rosbags unpacks of a bag, and refuse what its reader cannot follow.

    Raises:
        FileError: The metadata are too large, or nested; a database has views.
    """
    from rosbags.rosbag2 import storage_mcap

    reader: Any = import_module("rosbags.rosbag2.reader")
    lz4, zstd = import_module("lz4.frame"), reader.zstd
    if source.is_dir():
        read_yaml(source / "metadata.yaml", f"'{source / 'metadata.yaml'}'")
    for database in [source] if source.is_file() else source.glob("*.db3"):
        _check_database(database)

    def unpack(decompressor: Any, data: bytes, size: float) -> bytes:
        check_memory(f"bag '{source}'", "a part of it, unpacked,", size)
        content: bytes = decompressor.decompress(data, int(size) + 1)  # what is longer is refused
        return content

    def message(data: bytes) -> bytes:
        return unpack(zstd.ZstdDecompressor(), data, max_bytes())

    by_name = {
        "lz4": lambda data, size: unpack(lz4.LZ4FrameDecompressor(), data, size),
        "zstd": lambda data, size: unpack(zstd.ZstdDecompressor(), data, size),
    }
    names = SimpleNamespace(
        decompress=message, open=lambda file, mode: _Unpacked(zstd.open(file, mode), source)
    )
    usual = dict(storage_mcap.DECOMPRESSORS)
    try:
        storage_mcap.DECOMPRESSORS.update(by_name)
        reader.zstd = names
        yield
    finally:
        storage_mcap.DECOMPRESSORS.update(usual)
        reader.zstd = zstd


class _Unpacked:
    """A compressed file of a bag, which is written to a temporary folder as far as it may be."""

    def __init__(self, file: Any, source: Path) -> None:
        self._file, self._source = file, source
        self._left = shutil.disk_usage(tempfile.gettempdir()).free // 2

    def read(self, size: int) -> bytes:
        content: bytes = self._file.read(size)
        self._left -= len(content)
        if self._left < 0:
            raise FileError(
                f"bag '{self._source}' takes more than half of the free space of "
                f"'{tempfile.gettempdir()}' when it is unpacked; set TMPDIR to a larger folder."
            )
        return content

    def __enter__(self) -> "_Unpacked":
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()


def _check_database(path: Path) -> None:
    """Refuse long messages, and views and computed columns, which may have rows without end."""
    query = "SELECT name, type, sql FROM sqlite_master"
    address = f"{path.absolute().as_uri()}?mode=ro"
    # rosbags names what is wrong.
    with suppress(sqlite3.Error), closing(sqlite3.connect(address, uri=True)) as database:
        for name, kind, text in database.execute(query).fetchall():
            if kind not in ("table", "index") or _COMPUTED.search(text or ""):
                raise FileError(
                    f"bag '{path}': {kind} {name!r} is computed by the database, which is not "
                    "read; give the bag as ros2 bag record wrote it."
                )
        (longest,) = database.execute("SELECT max(length(data)) FROM messages").fetchone()
        check_memory(f"bag '{path}'", f"a message of {longest} bytes", _COPIES * (longest or 0))
