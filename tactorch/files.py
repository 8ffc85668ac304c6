"""Files that are either whole or absent."""

import os
import sys
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from hashlib import sha256
from pathlib import Path

from tactorch.errors import FileError


def cache_folder() -> Path:
    """Return the folder for cached files: `$TACTORCH_CACHE`, or the user's cache folder."""
    chosen = os.environ.get("TACTORCH_CACHE")
    if chosen:
        return Path(chosen).expanduser()
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

    A process killed in between leaves `path` as it was. The temporary file keeps the suffix,
    because many writers choose their format by it.

    Args:
        path: The file to create or replace; its folder is created.

    Yields:
        The temporary path.

    Raises:
        FileError: the file or its folder cannot be written.
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
        with suppress(OSError):
            temporary.unlink()


def require_file(path: str | Path, what: str) -> Path:
    """Return `path` as a `Path`, or raise `FileError` naming it and `what` it should be."""
    found = Path(path)
    if not found.is_file():
        hint = _nearest(found)
        raise FileError(f"{what} not found: '{found}' is not a file.{hint}")
    return found


def require_folder(path: str | Path, what: str) -> Path:
    """Return `path` as a `Path`, or raise `FileError` naming it and `what` it should be."""
    found = Path(path)
    if not found.is_dir():
        raise FileError(f"{what} not found: '{found}' is not a folder.{_nearest(found)}")
    return found


def checksum(path: str | Path) -> str:
    """Return the SHA-256 of a file's content."""
    digest = sha256()
    with open(path, "rb") as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


def _nearest(path: Path) -> str:
    """Say what does exist beside a missing path."""
    parent = path.parent
    if not parent.is_dir():
        return f" Nor does its folder '{parent}' exist; check the spelling."
    names = sorted(p.name for p in parent.iterdir() if not p.name.startswith("."))[:6]
    listing = ", ".join(names) if names else "nothing"
    return f" Its folder holds: {listing}."
