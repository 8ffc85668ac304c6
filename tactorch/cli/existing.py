"""Files and runs that exist: a command replaces them where overwrite=true says so."""

import os
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from stat import S_ISREG
from types import MappingProxyType

from tactorch.cli.compose import compose_options
from tactorch.cli.overrides import given
from tactorch.cli.resume import command_of, has_state
from tactorch.cli.schema import app_name
from tactorch.errors import ConfigError, FileError

#: Commands that continue what their run folder, or their output, holds.
CONTINUING = ("live", "generate", "reproduce")
#: Commands whose `out` is a folder, which they check themselves.
WRITING_FOLDERS = ("generate", "reproduce", "sensor unpack")
_SHOWN = 3  # results in a message


def check_file(path: Path, overwrite: bool) -> None:
    """Refuse, before the work, a file that exists or that cannot be written.

    Raises:
        ConfigError: The file exists, and it may not be replaced.
        FileError: Its folder cannot be made or written.
    """
    if path.is_dir():
        raise ConfigError(f"out={path} is a folder; give the name of a file, such as {path}/NAME.")
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

    Raises:
        ConfigError: The folder holds a run of another command, or results that may not be replaced.
    """
    typed = given(words)
    if "run_dir" not in typed:
        return
    folder = _run_folder(command, words)
    resumed = typed.get("resume", "")
    if resumed and os.path.realpath(folder) == os.path.realpath(resumed):
        return
    results, earlier = results_in(folder), command_of(folder)
    if (folder / f"{app_name(command)}.log").is_file():  # a copy may lack hidden files
        earlier = earlier or app_name(command)
    if not results or earlier is None:
        return
    if earlier != app_name(command):
        raise ConfigError(
            f"run_dir={folder} holds a run of tactorch {earlier}; choose another run_dir."
        )
    if command in CONTINUING:
        return
    if not _is_true(typed, "overwrite"):
        more = ", ..." if len(results) > _SHOWN else ""
        listed = ", ".join(results[:_SHOWN]) + more
        continues = command_of(folder) is not None and has_state(command, folder)
        resume = f"resume={folder} to continue it, " if continues else ""
        raise ConfigError(
            f"run_dir={folder} holds the results of an earlier run ({listed}); give {resume}"
            "another run_dir, or overwrite=true to replace them."
        )


def _run_folder(command: str, words: Sequence[str]) -> Path:
    """Return the folder that is given as run_dir."""
    typed = given(words)["run_dir"]
    if "${" in typed and "${hydra" not in typed:
        typed = compose_options(command, words).run_dir
    return Path(typed)


class Replaced:
    """The run that a command continues or replaces; one that is refused is put back.

    Hydra replaces its settings and adds to its logs before the command checks anything else.
    """

    _folder: Path = Path()
    _results: Mapping[str, int] | None = None
    _saved: Mapping[Path, bytes] = MappingProxyType({})

    def __init__(self, command: str, words: Sequence[str]) -> None:
        typed = given(words)
        resumed = typed.get("resume", "null") not in ("", "null")
        replaced = not resumed and command not in CONTINUING and _is_true(typed, "overwrite")
        patterns = [".hydra/*"] if resumed or replaced else []
        if replaced:
            patterns += ["*/.hydra/*", f"{app_name(command)}.log", f"*/{app_name(command)}.log"]
        if patterns and "run_dir" in typed:
            self._folder = _run_folder(command, words)
            paths = [path for pattern in patterns for path in self._folder.glob(pattern)]
            self._saved = {path: path.read_bytes() for path in paths if path.is_file()}
            self._results = self._stamps() if replaced else None
        for path in self._saved:
            if path.suffix == ".log":
                path.unlink()

    def restore(self, interrupted: bool = False) -> None:
        """Put the settings and logs back, unless the results were replaced, or may be continued."""
        untouched = self._results is not None and self._results == self._stamps()
        if untouched or (self._results is None and not interrupted):
            for path, content in self._saved.items():
                path.write_bytes(content)

    def _stamps(self) -> dict[str, int]:
        """Return the times at which files other than settings and logs were written."""
        files = [*self._folder.glob("[!.]*"), *self._folder.glob("[!.]*/[!.]*")]
        stamps = {str(path): path.lstat() for path in files if path.suffix != ".log"}
        return {path: stat.st_mtime_ns for path, stat in stamps.items() if S_ISREG(stat.st_mode)}


def _is_true(typed: Mapping[str, str], name: str) -> bool:
    return typed.get(name, "").lower() in ("true", "yes", "on", "1")


def results_in(folder: Path) -> list[str]:
    """Return the names in a folder that are neither hidden nor logs."""
    if not folder.is_dir():
        return []
    names = (path.name for path in folder.iterdir())
    return sorted(name for name in names if name[0] != "." and not name.endswith(".log"))
