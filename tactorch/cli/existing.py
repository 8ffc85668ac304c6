"""Files and runs that exist: a command replaces them where overwrite=true says so."""

import os
import tempfile
from collections.abc import Sequence
from pathlib import Path

from tactorch.cli.compose import compose_options
from tactorch.cli.overrides import given
from tactorch.cli.resume import command_of, has_state
from tactorch.cli.schema import app_name
from tactorch.errors import ConfigError, FileError

#: Commands that continue what their run folder, or their output, holds.
CONTINUING = ("live", "generate", "reproduce")
_SHOWN = 3  # results in a message


def check_file(path: Path, overwrite: bool) -> None:
    """Refuse, before the work, a file that exists or that cannot be written.

    Raises:
        ConfigError: The file exists, and it may not be replaced.
        FileError: Its folder cannot be made or written.
    """
    if path.is_file() and not overwrite:
        raise ConfigError(
            f"out={path} exists; give overwrite=true to replace it, or out=... with another name."
        )
    folder = path.parent
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise FileError(
            f"out={path}: nothing can be written into '{folder}' ({error.strerror}); choose "
            "another folder, or check its permissions and the free space."
        ) from error


def check_run_folder(command: str, words: Sequence[str]) -> None:
    """Refuse a folder, given as run_dir, with the results of an earlier run.

    With overwrite=true its log is removed; the command itself removes the results.

    Raises:
        ConfigError: The folder holds a run of another command, or results that may not be replaced.
    """
    typed = given(words)
    if "run_dir" not in typed:
        return
    folder = Path(typed["run_dir"])
    if "${" in typed["run_dir"] and "${hydra" not in typed["run_dir"]:
        folder = Path(compose_options(command, words).run_dir)
    resumed = typed.get("resume", "")
    if resumed and os.path.realpath(folder) == os.path.realpath(resumed):
        return
    results, earlier = _results(folder), command_of(folder)
    if not results or earlier is None:
        return
    if earlier != app_name(command):
        raise ConfigError(
            f"run_dir={folder} holds a run of tactorch {earlier}; choose another run_dir."
        )
    if command in CONTINUING:
        return
    if typed.get("overwrite", "").lower() not in ("true", "yes", "on", "1"):
        more = ", ..." if len(results) > _SHOWN else ""
        listed = ", ".join(results[:_SHOWN]) + more
        resume = f"resume={folder} to continue it, " if has_state(command, folder) else ""
        raise ConfigError(
            f"run_dir={folder} holds the results of an earlier run ({listed}); give {resume}"
            "another run_dir, or overwrite=true to replace them."
        )
    for log in (*folder.glob(f"{earlier}.log"), *folder.glob(f"*/{earlier}.log")):
        log.unlink()


def _results(folder: Path) -> list[str]:
    """Return the names in a folder that are neither hidden nor logs."""
    if not folder.is_dir():
        return []
    names = (path.name for path in folder.iterdir())
    return sorted(name for name in names if name[0] != "." and not name.endswith(".log"))
