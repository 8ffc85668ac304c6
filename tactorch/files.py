"""Files: written whole or not at all, and read as data of unknown origin."""

import io
import json
import math
import os
import re
import shutil
import sys
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any
from zipfile import ZipFile

from tactorch.budget import (
    MAX_DEPTH,
    MAX_PLAIN,
    MAX_YAML,
    TEXT,
    check_archive,
    check_depth,
    read_content,
    too_deep,
    unpack,
)
from tactorch.errors import FileError, TactorchError

if TYPE_CHECKING:
    import numpy as np


def natural_key(path: Path) -> list[str | int]:
    """Return a key of a file's name that sorts press2 before press10."""
    # Every second part is a number.
    return [int(p) if k % 2 else p for k, p in enumerate(re.split(r"(\d+)", path.name))]


def cache_folder() -> Path:
    """Return the folder for cached files: `$TACTORCH_CACHE`, or the user's cache folder."""
    if folder := os.environ.get("TACTORCH_CACHE"):
        return Path(folder).expanduser()
    if sys.platform == "win32":
        base = os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local"
    elif sys.platform == "darwin":
        base = Path.home() / "Library" / "Caches"
    else:
        base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "tactorch"


@contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Give a temporary sibling of `path` to write to; rename it to `path` on success.

    It may become a file or a folder. The folder of `path` is created. A process killed in between
    leaves `path` as it was. The temporary file keeps the suffix, because many writers choose their
    format by it.
    """
    target = Path(path)
    temporary = target.with_name(f".{target.stem}.{uuid.uuid4().hex[:8]}.part{target.suffix}")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        os.replace(temporary, target)
    except OSError as error:
        raise FileError(
            f"cannot write '{target}': {error}; check the folder, its permissions and the free "
            "space, or choose another place."
        ) from error
    finally:
        if temporary.is_dir():
            shutil.rmtree(temporary, ignore_errors=True)
        with suppress(OSError):
            temporary.unlink()


def write_file(path: str | Path, content: str | bytes) -> None:
    """Write a file, whole or not at all; text is written in UTF-8."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(content.encode("utf-8") if isinstance(content, str) else content)


def write_json(path: str | Path, values: Mapping[str, Any]) -> None:
    """Write strict JSON, NaN as null, whole or not at all."""
    write_file(path, json.dumps(_strict(values), indent=2, allow_nan=False) + "\n")


def _strict(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(k): _strict(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_strict(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def require_file(path: str | Path, what: str) -> Path:
    """Return `path` as a `Path`, or raise `FileError` naming it and `what` it should be."""
    return _require(Path(path), what, "file", Path.is_file)


def require_folder(path: str | Path, what: str) -> Path:
    """Return `path` as a `Path`, or raise `FileError` naming it and `what` it should be."""
    return _require(Path(path), what, "folder", Path.is_dir)


def _require(path: Path, what: str, kind: str, is_kind: Callable[[Path], bool]) -> Path:
    if not is_kind(path):
        raise FileError(f"{what} not found: '{path}' is not a {kind}.{_neighbours(path)}")
    return path


def checksum(path: str | Path) -> str:
    """Return the SHA-256 of a file's content."""
    digest = sha256()
    with open(path, "rb") as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


def write_arrays(path: str | Path, arrays: Mapping[str, Any], *, compressed: bool = False) -> None:
    """Write arrays of numbers or text by name to an .npz file, whole or not at all."""
    import numpy as np

    # The option allow_pickle=False is new in NumPy 2.2; earlier ones store it as an array.
    for name, values in arrays.items():
        if np.asarray(values).dtype.hasobject:
            raise ValueError(f"array '{name}' holds Python objects; give numbers or text.")
    memory = io.BytesIO()  # an archive on a full disk fails again from its destructor
    (np.savez_compressed if compressed else np.savez)(memory, **arrays)
    write_file(path, memory.getvalue())


def read_arrays(
    path: str | Path, what: str, remedy: str, copies: float = 1.0
) -> "dict[str, np.ndarray]":
    """Read all arrays of an .npz file by name; their checksums are verified.

    Messages name the expected content `what`, and the `remedy` for a file that cannot be read.
    Arrays are refused that, in `copies` of the caller, need too much memory.
    """
    source = require_file(path, what)
    arrays = {}
    try:
        with ZipFile(source) as archive:
            check_archive(f"{what} '{source}'", archive, copies)
            for entry in archive.infolist():
                # NumPy stops reading where the array ends, before the checksum is compared.
                content = unpack(archive, entry)
                arrays[entry.filename.removesuffix(".npy")] = as_array(content)
        arrays.pop("allow_pickle", None)  # written by NumPy before 2.2
    except TactorchError:
        raise
    except Exception as error:  # what a damaged archive raises has no common base
        raise FileError(f"{what} '{source}' cannot be read ({error}); {remedy}") from error
    return arrays


def as_array(content: bytes | bytearray) -> "np.ndarray":
    """Return the array in the content of an .npy file, without a copy of its values.

    Raises:
        ValueError: The content is no array, or its header states more than it holds.
    """
    import numpy as np

    memory = io.BytesIO(content)
    major, _ = np.lib.format.read_magic(memory)
    read_header = (
        np.lib.format.read_array_header_1_0 if major == 1 else np.lib.format.read_array_header_2_0
    )
    shape, is_fortran, kind = read_header(memory)
    if kind.hasobject:
        raise ValueError("it holds Python objects")
    if math.prod(shape) * kind.itemsize != len(content) - memory.tell():
        raise ValueError(f"its header states the shape {shape}, which is not what it holds")
    array = np.frombuffer(content, kind, math.prod(shape), memory.tell())
    return array.reshape(shape, order="F" if is_fortran else "C")


def read_json(path: str | Path, what: str, remedy: str, *keys: str) -> dict[str, Any]:
    """Read a file that holds a JSON object with at least `keys`; see `read_arrays`."""
    source = require_file(path, what)
    try:
        content = parse_json(read_content(source, TEXT), f"{what} '{source}'")
    except (OSError, ValueError) as error:
        raise FileError(f"{what} '{source}' cannot be read ({error}); {remedy}") from error
    if not isinstance(content, dict):
        raise FileError(f"{what} '{source}' is not a JSON object; {remedy}")
    missing = [key for key in keys if key not in content]
    if missing:
        raise FileError(f"{what} '{source}' lacks '{missing[0]}'; {remedy}")
    return content


def parse_json(text: str | bytes, source: str, error: type[TactorchError] = FileError) -> Any:
    """Return the value in JSON text of bounded depth; `source` is its name in messages.

    Raises:
        TactorchError: It is nested too deep, of class `error`.
        ValueError: It is not JSON.
    """
    try:
        value = json.loads(text)
    except RecursionError as cause:
        raise too_deep(source, error) from cause
    check_depth(source, value, error)
    return value


def read_yaml(path: Path, what: str, error: type[TactorchError] = FileError) -> Any:
    """Read a small YAML file without aliases or deep nesting, which parsers cannot follow.

    `what` is its name in messages.

    Raises:
        TactorchError: It is too large, has an alias, is nested too deep, or is not YAML; of class
            `error`.
        OSError: It cannot be read.
    """
    import yaml

    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    if (size := path.stat().st_size) > MAX_YAML:
        raise error(f"{what} has {size} bytes; give one of up to {MAX_YAML}.")
    try:
        text, depth = path.read_bytes(), 0
        for event in yaml.parse(text, Loader=loader):
            if isinstance(event, yaml.AliasEvent):
                raise error(
                    f"{what} uses the alias '*{event.anchor}'; write the value in its place."
                )
            is_plain = isinstance(event, yaml.ScalarEvent) and event.implicit[0]
            if is_plain and (length := len(event.value)) > MAX_PLAIN:
                raise error(
                    f"{what} has a value of {length} characters in line "
                    f"{event.start_mark.line + 1}; put text in quotes, and shorten numbers."
                )
            depth += isinstance(event, yaml.CollectionStartEvent)
            depth -= isinstance(event, yaml.CollectionEndEvent)
            if depth > MAX_DEPTH:
                raise too_deep(what, error)
        return yaml.load(text, loader)
    except (yaml.YAMLError, ValueError) as cause:  # also dates and numbers that do not exist
        reason = " ".join(str(cause).split())
        raise error(f"{what} is not valid YAML: {reason}; repair it.") from cause


def _neighbours(path: Path) -> str:
    """Return a hint: what the folder of a missing path holds."""
    parent = path.parent
    if not parent.is_dir():
        return f" Nor does its folder '{parent}' exist; check the spelling."
    names = sorted(p.name for p in parent.iterdir() if not p.name.startswith("."))[:6]
    listing = ", ".join(names) if names else "nothing"
    return f" Its folder holds: {listing}."
