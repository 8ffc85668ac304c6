"""Reading of CSV tables; error messages name the file, the line and the column."""

import csv
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from tactorch.budget import check_memory
from tactorch.errors import FileError
from tactorch.files import require_file

_EXPANSION = 4.0  # bytes of numbers for each byte of text


class Row(NamedTuple):
    """A line of a table: the file and line, for messages, and the text of each column."""

    location: str
    values: Mapping[str, str | None]

    def text(self, column: str) -> str:
        """Return the text in a column; raise `FileError` if it is empty."""
        value = self.values[column]
        if value is None or not value.strip():
            raise FileError(f"{self.location}: {column} is missing.")
        return value.strip()

    def number(self, column: str) -> float:
        """Return the number in a column; raise `FileError` if there is none."""
        try:
            return float(self.text(column))
        except ValueError as error:
            raise FileError(f"{self.location}: {error}; {column} must be a number.") from error


def read_rows(
    path: str | Path,
    kind: str,
    columns: Sequence[str],
    aliases: Mapping[str, str] | None = None,
    *,
    growing: bool = False,
) -> Iterator[Row]:
    """Yield the lines of a CSV file with the required columns.

    `aliases` are required names by alternative name. The unterminated last line of a file to which
    another program still appends lines (`growing`) is ignored. A file that is missing, too large
    or not text, or that lacks a column, raises `FileError`.
    """
    file, what = require_file(path, kind), f"{kind} '{path}'"
    size = file.stat().st_size
    check_memory(what, f"its content of {size} bytes", _EXPANSION * size)
    try:
        # Spreadsheets start files with a byte order mark.
        with open(file, newline="", encoding="utf-8-sig") as text:
            terminated = (line for line in text if line.endswith(("\n", "\r")))
            lines = csv.DictReader(terminated if growing else text)
            header = [(aliases or {}).get(name, name).strip() for name in lines.fieldnames or []]
            missing = [name for name in columns if name not in header]
            if missing:
                raise FileError(
                    f"{what} lacks the column {missing[0]}; it needs {', '.join(columns)},"
                    " separated by commas."
                )
            lines.fieldnames = header
            for values in lines:
                yield Row(f"{what}, line {lines.line_num}", values)
    except (UnicodeDecodeError, csv.Error) as error:
        reason = f"{what} is not readable text ({error})"
        raise FileError(f"{reason}; save it as CSV in UTF-8.") from error
