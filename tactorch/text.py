"""Text that comes from files, made safe to print.

Names of presses, runs and materials are data that people exchange. Terminals act on control
characters, and bidirectional marks reorder what a reader sees, so that both are printed as escapes.
"""

import logging
import re

_CONTROL = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]"
)
MAX_NAME_LENGTH = 80


def printable(text: str) -> str:
    r"""Replace control characters and bidirectional marks by escapes such as `\x1b`.

    Newlines and tabs stay. A terminal, an SVG file or a log can hold the result.
    """
    return _CONTROL.sub(lambda match: ascii(match[0])[1:-1], text)


def one_line(text: str, max_length: int = MAX_NAME_LENGTH) -> str:
    """Return `printable` text on one line, with single spaces, shortened with an ellipsis."""
    line = printable(" ".join(text.split()))
    return line if len(line) <= max_length else f"{line[: max_length - 1]}…"


class PrintableFormatter(logging.Formatter):
    """Formatter of log records whose messages may hold text from files."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the formatted record as `printable` text."""
        return printable(super().format(record))
