"""Recordings that grow, as a source of presses, and replay of a recording into one.

Files are polled, which works on every file system, network drives included. A file that cannot be
read may be half written: it is read again, and reported once it stays unreadable.
"""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Event
from typing import NamedTuple

from tactorch.errors import ConfigError, FileError, RecordingError
from tactorch.recording import Press, Recording, append_press, compact, read_presses
from tactorch.recording.append import OtherObjectError, digest

_SUFFIXES = (".h5", ".hdf5")


class Arrival(NamedTuple):
    """A press that has come; the key is unique within a run, the digest a hash of its values."""

    press: Press
    key: str
    digest: str


class PressSource(ABC):
    """Source of presses on one object."""

    name: str  # for messages
    about: Recording | None = None  # the object, once a press was read; it never changes

    @abstractmethod
    def poll(self) -> list[Arrival]:
        """Return the presses that came since the last call, in order."""


class RecordingSource(PressSource):
    """A growing recording, or a folder of recordings.

    The file or folder is first read by `poll`, and need not exist before.

    Args:
        path: A recording (.h5), or an existing folder.
        patience_seconds: Time after which an unreadable file is reported, s.
        check_units: See `Recording`.
        report: Called with the message for each invalid press and file.
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
        self._report, self._patience, self._check_units = report, patience_seconds, check_units
        if not self.path.is_dir() and self.path.suffix not in _SUFFIXES:
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
        paths = [self.path] if self.path.is_file() else []
        if self.path.is_dir():
            files = (path for path in self.path.iterdir() if path.suffix in _SUFFIXES)
            paths = sorted(path for path in files if not path.name.startswith("."))
        arrivals: list[Arrival] = []
        for path in paths:
            arrivals += self._read(self._files.setdefault(path.name, _File(path)))
        return arrivals

    def _read(self, file: "_File") -> list[Arrival]:
        try:
            status = file.path.stat()
            stamp = status.st_mtime_ns, status.st_size, status.st_ino
            if stamp == file.read_at:
                return []
            # The last known press is read again, to notice a replaced file.
            after = max(file.count - 1, 0)
            contents = read_presses(
                file.path, after=after, check_units=self._check_units, known=self.about
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
        last = contents.presses.get(contents.count - 1)
        file.count, file.last = contents.count, None if last is None else digest(last)
        arrivals = [Arrival(press, file.press_name(i), digest(press)) for i, press in new.items()]
        if contents.recording is not None and new:
            before = () if self.about is None else self.about.presses
            presses = (*before, *new.values())
            self.about = replace(contents.recording, presses=presses, check_units=False)
        return arrivals

    def _unreadable(self, file: "_File", error: Exception) -> None:
        """Report a file once it has been unreadable for `patience_seconds`.

        Waiting does not help where the only file can be read and is no valid recording: that error
        is raised.
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
    path: Path
    read_at: tuple[int, int, int] | None = None  # its time, size and inode at the last reading
    count: int = 0  # presses read, valid or not
    last: str | None = None  # hash of the last press; None if it is invalid
    failed_at: float | None = None  # time of the first failure since the last reading
    reported: bool = False  # whether the failure was

    def press_name(self, index: int) -> str:
        return f"{self.path.name}, press {index + 1}"

    def check(self, count: int, presses: Mapping[int, Press]) -> None:
        """Refuse a file that was replaced: it has fewer presses than before, or other ones."""
        if count < self.count:
            raise RecordingError(
                f"recording '{self.path}' has {count} presses and had {self.count}: it was "
                "replaced by another. Start another run for it."
            )
        again = presses.get(self.count - 1)
        if self.last is not None and (again is None or digest(again) != self.last):
            raise RecordingError(
                f"{self.press_name(self.count - 1)} changed since it was read: the recording was "
                "replaced. Start another run for it."
            )


def replay(
    recording: Recording, target: str | Path, pause_seconds: float, stop: Event | None = None
) -> int:
    """Write a recording's presses into a growing one, with pauses (s) before each but the first.

    Presses that the target holds already are not written again. Setting `stop` ends the replay.
    The number of presses in the target is returned.
    """
    if not pause_seconds >= 0:
        raise ConfigError(f"pause_seconds={pause_seconds}: give a time of at least 0 s.")
    target, stop = Path(target), stop or Event()
    done = _count_replayed(recording, target) if target.exists() else 0
    for index in range(done, len(recording.presses)):
        if index > done and stop.wait(pause_seconds):
            return index
        if index == 0:
            replace(recording, presses=recording.presses[:1], check_units=False).save(target)
        else:
            append_press(target, recording.presses[index])
    compact(target)
    return len(recording.presses)


def _count_replayed(recording: Recording, target: Path) -> int:
    """Number of the recording's presses that the target holds."""
    replayed = Recording.load(target, check_units=False)
    pairs = zip(replayed.presses, recording.presses, strict=False)
    if (
        replayed.mesh.content_hash() != recording.mesh.content_hash()
        or replayed.material != recording.material
        or len(replayed.presses) > len(recording.presses)
        or any(digest(old) != digest(new) for old, new in pairs)
    ):
        raise RecordingError(
            f"'{target}' holds presses of another recording than the replayed one; choose "
            "another run_dir."
        )
    return len(replayed.presses)
