"""Messages to the run's log file and to the terminal."""

import io
import logging
import sys
from typing import Any

from tactorch.cli.tables import Table, draw, is_rich
from tactorch.errors import FileError
from tactorch.text import printable

log = logging.getLogger("tactorch")


class RunLog(logging.FileHandler):
    """Log file of a run. A command fails where the file cannot be written, as on a full disk."""

    _failed = False

    def _open(self) -> Any:
        # Unbuffered: a buffer would be written again when the process ends.
        file = open(self.baseFilename, f"{self.mode}b", buffering=0)  # noqa: SIM115
        return io.TextIOWrapper(file, self.encoding, self.errors, write_through=True)

    def handleError(self, record: logging.LogRecord) -> None:
        """Raise the first error of the file; further messages are dropped.

        Raises:
            FileError: the file cannot be written.
        """
        error = sys.exc_info()[1]
        if not isinstance(error, OSError):
            super().handleError(record)
        elif not self._failed:
            self._failed = True
            raise FileError(
                f"cannot write '{self.baseFilename}': {error}; check the folder, its permissions "
                "and the free space, or choose another run_dir."
            ) from error


def to_log_file(message: str, error: bool = False) -> None:
    """Write to the run's log file only; errors with their traceback."""
    level = logging.ERROR if error else logging.INFO
    record = logging.LogRecord(
        "tactorch", level, "", 0, message, None, sys.exc_info() if error else None
    )
    for handler in logging.getLogger().handlers:
        if isinstance(handler, logging.FileHandler):
            handler.handle(record)


def log_text(text: str, *tables: Table) -> None:
    """Log a text that has tables in it, as their `text`; at a terminal they are drawn."""
    text = printable(text)
    if not is_rich():
        log.info("%s", text)
        return
    to_log_file(text)
    for table in tables:
        before, _, text = text.partition(table.text())
        if before.strip():
            print(before.rstrip("\n"))
        draw(table)
    if text:
        print(text.removeprefix("\n"))
