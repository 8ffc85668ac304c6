"""Files of presses: one file, or those of a folder."""

from collections.abc import Sequence
from pathlib import Path

from tactorch.errors import FileError
from tactorch.files import natural_key


def press_files(path: Path, suffixes: Sequence[str], kind: str) -> list[Path]:
    """Return a file, or the files with these suffixes in a folder, press2 before press10.

    `kind` names them in messages.
    """
    if not path.is_dir():
        if path.suffix.lower() not in suffixes:
            known = ", ".join(suffixes)
            raise FileError(f"'{path}' has the unknown suffix '{path.suffix}'; use one of {known}.")
        return [path]
    files = sorted((f for f in path.iterdir() if f.suffix.lower() in suffixes), key=natural_key)
    if not files:
        raise FileError(
            f"'{path}' contains no {kind} ({', '.join(suffixes)}); give one for each press."
        )
    return files
