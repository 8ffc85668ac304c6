"""Where presses come from: a recording that grows, or a folder into which recordings are put.

The file system is asked again and again, which works everywhere, network drives included. A file
that cannot be read may be half written: it is tried again, and told of when that takes long.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from tactorch.errors import ConfigError, FileError, RecordingError
from tactorch.recording import Press, Recording, read_presses
from tactorch.recording.append import OtherObjectError, digest

SUFFIXES = (".h5", ".hdf5")
ProgressCallback = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Arrival:
    """A press that has come.

    Attributes:
        press: The press.
        key: File and number, which tell it from others of the run.
        mark: Hash of its values.
    """

    press: Press
    key: str
    mark: str


class Source:
    """A growing recording, or a folder of them.

    Attributes:
        about: The object, once a sound press was seen; it never changes.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        patience_seconds: float = 5.0,
        check_units: bool = True,
        tell: ProgressCallback = lambda text: None,
    ) -> None:
        """Look at nothing yet: the file or folder need not be there.

        Args:
            path: A recording (.h5), or a folder that is there already.
            patience_seconds: After which a file that cannot be read is told of.
            check_units: As of `Recording`.
            tell: Called with what is wrong with presses and files.

        Raises:
            ConfigError: the path is neither.
        """
        self.path = Path(path)
        self.about: Recording | None = None
        self._tell, self._patience, self._check_units = tell, patience_seconds, check_units
        if not self.path.is_dir() and self.path.suffix not in SUFFIXES:
            raise ConfigError(
                f"'{path}' is neither a folder nor a recording (.h5); give the file that presses "
                "are appended to, or make the folder that recordings are put into."
            )
        self._files: dict[str, _File] = {}

    def poll(self) -> list[Arrival]:
        """Return the presses that have come since the last call, in their order.

        Files of a folder are taken by name, each with its presses in turn.

        Raises:
            OtherObjectError: a recording is of another object than the presses before.
            RecordingError: presses that were read before were changed or taken away.
        """
        arrivals: list[Arrival] = []
        for path in self._paths():
            file = self._files.setdefault(path.name, _File(path))
            arrivals += self._read(file)
        return arrivals

    def _paths(self) -> list[Path]:
        if not self.path.is_dir():
            return [self.path] if self.path.is_file() else []
        found = (path for path in self.path.iterdir() if path.suffix in SUFFIXES)
        return sorted(path for path in found if not path.name.startswith("."))

    def _read(self, file: "_File") -> list[Arrival]:
        try:
            stamp = file.stamp()
            if stamp == file.read_at:
                return []
            # The last known press is read again: is it still the same file?
            contents = read_presses(
                file.path,
                after=max(file.count - 1, 0),
                check_units=self._check_units,
                known=self.about,
            )
        except OtherObjectError:
            raise
        except (FileError, RecordingError, OSError) as error:
            self._unreadable(file, str(error))
            return []
        file.read_at, file.failed_at, file.reported = stamp, None, False
        file.check(contents.count, contents.presses)
        for index, fault in contents.faults.items():
            if index >= file.count:
                self._tell(f"{file.name(index)} is passed over: {fault}")
        new = {i: press for i, press in contents.presses.items() if i >= file.count}
        file.count = contents.count
        if contents.recording is not None and new:
            before = () if self.about is None else self.about.presses
            everything = (*before, *new.values())
            self.about = replace(contents.recording, presses=everything, check_units=False)
        arrivals = [Arrival(press, file.name(i), digest(press)) for i, press in new.items()]
        file.last = (max(new), digest(new[max(new)])) if new else file.last
        return arrivals

    def _unreadable(self, file: "_File", reason: str) -> None:
        """A file that cannot be read now; told of once it stays so."""
        now = time.monotonic()
        file.failed_at = now if file.failed_at is None else file.failed_at
        if not file.reported and now - file.failed_at >= self._patience:
            file.reported = True
            self._tell(f"'{file.path}' cannot be read so far, and is tried again: {reason}")


@dataclass(eq=False)
class _File:
    """One file, and what was read of it.

    Attributes:
        path: Where it is.
        read_at: Its stamp when it was read last.
        count: How many presses were read, sound or not.
        last: Number and hash of the last sound press.
        failed_at: When reading began to fail; None while it does not.
        told: Whether that was told.
    """

    path: Path
    read_at: tuple[int, int, int] | None = None
    count: int = 0
    last: tuple[int, str] | None = None
    failed_at: float | None = None
    reported: bool = False

    def name(self, index: int) -> str:
        """What messages call a press."""
        return f"{self.path.name}, press {index + 1}"

    def stamp(self) -> tuple[int, int, int]:
        """What changes when the file does."""
        found = self.path.stat()
        return found.st_mtime_ns, found.st_size, found.st_ino

    def check(self, count: int, presses: Mapping[int, Press]) -> None:
        """Refuse a file that was replaced by another.

        Raises:
            RecordingError: it has fewer presses than before, or others.
        """
        if count < self.count:
            raise RecordingError(
                f"recording '{self.path}' has {count} presses where there were {self.count}: it "
                "was replaced by another. Start another run for it."
            )
        if self.last is None or self.last[0] != self.count - 1:
            return
        again = presses.get(self.last[0])
        if again is None or digest(again) != self.last[1]:
            raise RecordingError(
                f"{self.name(self.last[0])} is another than when it was read: the recording was "
                "replaced. Start another run for it."
            )
