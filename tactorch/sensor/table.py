"""Tables in CSV files that people and other programs write: read, or refused by line and column."""

import csv
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from tactorch.errors import FileError
from tactorch.files import require_file


@dataclass(frozen=True)
class Row:
    """A line of a table.

    Attributes:
        where: The file and the line, for messages.
        values: Text of each column; None where the line ends before.
    """

    where: str
    values: Mapping[str, str | None]

    def text(self, column: str) -> str:
        """Return what a column says.

        Raises:
            FileError: It is empty.
        """
        value = self.values[column]
        if value is None or not value.strip():
            raise FileError(f"{self.where}: {column} is missing.")
        return value.strip()

    def number(self, column: str) -> float:
        """Return the number in a column.

        Raises:
            FileError: There is none.
        """
        try:
            return float(self.text(column))
        except ValueError as error:
            raise FileError(f"{self.where}: {error}; {column} must be a number.") from error


def rows_of(
    path: str | Path,
    what: str,
    columns: Sequence[str],
    also_called: Mapping[str, str] | None = None,
    *,
    growing: bool = False,
) -> Iterator[Row]:
    """Yield the lines of a CSV file that has some columns.

    Args:
        path: The file.
        what: It is, for messages.
        columns: That it must have.
        also_called: Other people's names of columns, and ours.
        growing: Whether somebody still writes it; then a last line without an end is left out.

    Raises:
        FileError: The file is missing, no text, or lacks a column.
    """
    file, names = require_file(path, what), also_called or {}
    try:
        # Spreadsheets begin files with a mark that is no part of the first column's name.
        with open(file, newline="", encoding="utf-8-sig") as text:
            lines = csv.DictReader(_whole(text) if growing else text)
            header = [names.get(name, name).strip() for name in lines.fieldnames or []]
            missing = [name for name in columns if name not in header]
            if missing:
                raise FileError(
                    f"{what} '{path}' lacks the column {missing[0]}; it needs"
                    f" {', '.join(columns)}, divided by commas."
                )
            lines.fieldnames = header
            for values in lines:
                yield Row(f"{what} '{path}', line {lines.line_num}", values)
    except (UnicodeDecodeError, csv.Error) as error:
        raise FileError(
            f"{what} '{path}' is no text that can be read ({error}); save it as CSV in UTF-8."
        ) from error


def _whole(lines: Iterable[str]) -> Iterator[str]:
    return (line for line in lines if line.endswith(("\n", "\r")))
