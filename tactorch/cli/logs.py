"""Messages to the run's log file and to the terminal."""

import logging
import sys

from tactorch.cli.tables import Table, draw, is_rich
from tactorch.text import printable

log = logging.getLogger("tactorch")


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
