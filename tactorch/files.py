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

from tactorch.errors import FileError

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
    path: str | Path, what: str, remedy: str, max_bytes: float = float("inf")
) -> "dict[str, np.ndarray]":
    """Read all arrays of an .npz file by name; their checksums are verified.

    Messages name the expected content `what`, and the `remedy` for a file that cannot be read or
    whose unpacked arrays exceed `max_bytes`.
    """
    import numpy as np

    source = require_file(path, what)
    arrays = {}
    try:
        with ZipFile(source) as archive:
            size = sum(part.file_size for part in archive.infolist())
            if size > max_bytes:
                raise ValueError(f"its arrays have {size} bytes, more than {max_bytes}")
            for name in archive.namelist():
                # NumPy stops reading where the array ends, before the checksum is compared.
                content = io.BytesIO(archive.read(name))
                array = np.lib.format.read_array(content, allow_pickle=False)
                arrays[name.removesuffix(".npy")] = array
        arrays.pop("allow_pickle", None)  # written by NumPy before 2.2
    except Exception as error:  # what a damaged archive raises has no common base
        raise FileError(f"{what} '{source}' cannot be read ({error}); {remedy}") from error
    return arrays


def read_json(path: str | Path, what: str, remedy: str, *keys: str) -> dict[str, Any]:
    """Read a file that holds a JSON object with at least `keys`; see `read_arrays`."""
    source = require_file(path, what)
    try:
        content = json.loads(source.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise FileError(f"{what} '{source}' cannot be read ({error}); {remedy}") from error
    if not isinstance(content, dict):
        raise FileError(f"{what} '{source}' is not a JSON object; {remedy}")
    missing = [key for key in keys if key not in content]
    if missing:
        raise FileError(f"{what} '{source}' lacks '{missing[0]}'; {remedy}")
    return content


def _neighbours(path: Path) -> str:
    """Return a hint: what the folder of a missing path holds."""
    parent = path.parent
    if not parent.is_dir():
        return f" Nor does its folder '{parent}' exist; check the spelling."
    names = sorted(p.name for p in parent.iterdir() if not p.name.startswith("."))[:6]
    listing = ", ".join(names) if names else "nothing"
    return f" Its folder holds: {listing}."
