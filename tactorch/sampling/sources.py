"""Sources of presses: a presser on request, a growing recording, or a folder of recordings.

Files are polled, which works on every file system, network drives included. A file that cannot be
read may be half written: it is read again, and reported once it stays unreadable.
"""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from tactorch.errors import ConfigError, FileError, RecordingError
from tactorch.recording import Press, Recording, read_presses
from tactorch.recording.append import OtherObjectError, digest
from tactorch.sampling.candidates import Patch
from tactorch.sampling.presser import Presser

SUFFIXES = (".h5", ".hdf5")


@dataclass(frozen=True, eq=False)
class Arrival:
    """A press that has come.

    Attributes:
        press: The press.
        key: File and number, unique within a run.
        digest: Hash of its values.
    """

    press: Press
    key: str
    digest: str


class PressSource(ABC):
    """Source of presses on one object.

    Attributes:
        name: Name for messages.
    """

    name: str

    @abstractmethod
    def poll(self) -> list[Arrival]:
        """Return the presses that came since the last call, in order."""

    def request(self, patch: Patch) -> None:  # noqa: B027, only pressers listen
        """Ask for a press on a patch; ignored where somebody else presses."""


class PresserSource(PressSource):
    """Presses that a presser carries out on request.

    Args:
        presser: Robot, real or simulated.
    """

    name = "the presser"

    def __init__(self, presser: Presser) -> None:
        self._presser, self._count = presser, 0
        self._requested: Patch | None = None

    def request(self, patch: Patch) -> None:
        """See `PressSource.request`."""
        self._requested = patch

    def poll(self) -> list[Arrival]:
        """Carry out the requested press, if any."""
        patch, self._requested = self._requested, None
        if patch is None:
            return []
        press = self._presser.press(patch)
        self._count += 1
        return [Arrival(press, f"press {self._count}", digest(press))]


class RecordingSource(PressSource):
    """A growing recording, or a folder of recordings.

    The file or folder is first read by `poll`, and need not exist before.

    Args:
        path: A recording (.h5), or an existing folder.
        patience_seconds: Time after which an unreadable file is reported, s.
        check_units: See `Recording`.
        report: Called with the message for each invalid press and file.

    Raises:
        ConfigError: the path is neither.

    Attributes:
        about: The object, once a valid press was read; it never changes.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        patience_seconds: float = 5.0,
        check_units: bool = True,
        report: Callable[[str], None] = lambda message: None,
    ) -> None:
        self.path, self.name = Path(path), f"'{path}'"
        self.about: Recording | None = None
        self._report, self._patience, self._check_units = report, patience_seconds, check_units
        if not self.path.is_dir() and self.path.suffix not in SUFFIXES:
            raise ConfigError(
                f"'{path}' is neither a folder nor a recording (.h5); give the file that presses "
                "are appended to, or make the folder that recordings are put into."
            )
        self._files: dict[str, _File] = {}

    def poll(self) -> list[Arrival]:
        """Return the presses that came since the last call; files of a folder in order of name.

        Raises:
            OtherObjectError: a recording is of another object than earlier presses.
            RecordingError: presses that were read before were changed or removed, or the only
                recording is invalid.
        """
        arrivals: list[Arrival] = []
        for path in self._paths():
            arrivals += self._read(self._files.setdefault(path.name, _File(path)))
        return arrivals

    def _paths(self) -> list[Path]:
        if not self.path.is_dir():
            return [self.path] if self.path.is_file() else []
        paths = (path for path in self.path.iterdir() if path.suffix in SUFFIXES)
        return sorted(path for path in paths if not path.name.startswith("."))

    def _read(self, file: "_File") -> list[Arrival]:
        try:
            stamp = file.stamp()
            if stamp == file.read_at:
                return []
            # The last known press is read again, to notice a replaced file.
            contents = read_presses(
                file.path,
                after=max(file.count - 1, 0),
                check_units=self._check_units,
                known=self.about,
            )
        except OtherObjectError:
            raise
        except (FileError, RecordingError, OSError) as error:
            self._unreadable(file, error)
            return []
        file.read_at, file.failed_at, file.reported = stamp, None, False
        file.check(contents.count, contents.presses)
        for index, fault in contents.faults.items():
            if index >= file.count:
                self._report(f"{file.press_name(index)} is invalid and skipped: {fault}")
        new = {i: press for i, press in contents.presses.items() if i >= file.count}
        file.count = contents.count
        if contents.recording is not None and new:
            before = () if self.about is None else self.about.presses
            presses = (*before, *new.values())
            self.about = replace(contents.recording, presses=presses, check_units=False)
        arrivals = [Arrival(press, file.press_name(i), digest(press)) for i, press in new.items()]
        if new:
            file.last = max(new), arrivals[-1].digest
        return arrivals

    def _unreadable(self, file: "_File", error: Exception) -> None:
        """Report a file once it has been unreadable for `patience_seconds`.

        Raises:
            RecordingError: the only file can be read and is no valid recording; waiting does not
                help.
        """
        now = time.monotonic()
        file.failed_at = now if file.failed_at is None else file.failed_at
        if file.reported or now - file.failed_at < self._patience:
            return
        if isinstance(error, RecordingError) and not self.path.is_dir():
            raise error
        file.reported = True
        self._report(f"'{file.path}' cannot be read yet, and is tried again: {error}")


@dataclass(eq=False)
class _File:
    """Reading state of one file.

    Attributes:
        path: Path of the file.
        read_at: Its stamp at the last reading.
        count: Number of presses read, valid or not.
        last: Number and hash of the last valid press.
        failed_at: Time of the first failure since the last reading; None without one.
        reported: Whether the failure was reported.
    """

    path: Path
    read_at: tuple[int, int, int] | None = None
    count: int = 0
    last: tuple[int, str] | None = None
    failed_at: float | None = None
    reported: bool = False

    def press_name(self, index: int) -> str:
        """Name of a press in messages and keys."""
        return f"{self.path.name}, press {index + 1}"

    def stamp(self) -> tuple[int, int, int]:
        """Time, size and inode, which change with the file."""
        status = self.path.stat()
        return status.st_mtime_ns, status.st_size, status.st_ino

    def check(self, count: int, presses: Mapping[int, Press]) -> None:
        """Refuse a file that was replaced.

        Raises:
            RecordingError: it has fewer presses than before, or other ones.
        """
        if count < self.count:
            raise RecordingError(
                f"recording '{self.path}' has {count} presses and had {self.count}: it was "
                "replaced by another. Start another run for it."
            )
        if self.last is None or self.last[0] != self.count - 1:
            return
        again = presses.get(self.last[0])
        if again is None or digest(again) != self.last[1]:
            raise RecordingError(
                f"{self.press_name(self.last[0])} changed since it was read: the recording was "
                "replaced. Start another run for it."
            )
