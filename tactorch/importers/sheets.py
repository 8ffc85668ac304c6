"""Tables in CSV and Parquet files: columns by name, with errors that name file and row."""

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from jaxtyping import Float

from tactorch.budget import TEXT, check_memory, read_content
from tactorch.errors import ConfigError, FileError
from tactorch.files import require_file

SUFFIXES = (".csv", ".txt", ".tsv", ".parquet")
_DELIMITERS = ",;\t"
_BYTES_PER_CELL = 64  # of a number of Python in a list
_MISSING = ("", "nan", "na", "null", "none")


@dataclass(frozen=True, eq=False)
class Sheet:
    """A table."""

    path: Path
    columns: dict[str, Sequence[Any]]  # cells, text or numbers
    lines: Sequence[str]  # what messages call each row

    def numbers(self, name: str, *, finite: bool = True) -> Float[np.ndarray, " rows"]:
        """Return a column of numbers, NaN where a cell is empty."""
        values = np.array([self._number(name, i) for i in range(len(self.lines))])
        if finite and np.isinf(values).any():
            self._refuse(name, int(np.isinf(values).argmax()))
        return values

    def texts(self, name: str) -> list[str]:
        """Return a column of text, "" where a cell is empty; whole numbers have no decimals."""
        return [_as_text(cell) for cell in self.columns[name]]

    def _number(self, name: str, row: int) -> float:
        cell = self.columns[name][row]
        if cell is None or (isinstance(cell, str) and cell.strip().lower() in _MISSING):
            return float("nan")
        try:
            return float(cell)
        except (TypeError, ValueError):
            self._refuse(name, row)

    def _refuse(self, name: str, row: int) -> NoReturn:
        raise FileError(
            f"'{self.path}' {self.lines[row]}, column {name!r}, has {self.columns[name][row]!r}, "
            "which is not a finite number; repair it, or leave the cell empty."
        )


def read_sheet(path: str | Path, what: str = "table of presses") -> Sheet:
    """Read a table with a line of names: text with commas, semicolons or tabs, or Parquet.

    Lines that are empty or start with # are ignored. Messages name the expected content `what`.
    """
    source = require_file(path, what)
    sheet = _parquet(source) if source.suffix.lower() == ".parquet" else _text(source)
    if not len(sheet.lines):
        raise FileError(f"'{source}' has no rows; a {what} has a line for each sample or point.")
    return sheet


def _text(source: Path) -> Sheet:
    try:
        content = read_content(source, TEXT).decode("utf-8-sig")
        lines = [
            (number, line)
            for number, line in enumerate(content.splitlines(), start=1)
            if line.strip() and not line.lstrip().startswith("#")
        ]
        if not lines:
            raise FileError(f"'{source}' is empty; a table has a line of names, then numbers.")
        delimiter = max(_DELIMITERS, key=lines[0][1].count)
        rows = list(csv.reader([line for _, line in lines], delimiter=delimiter, strict=True))
    except (UnicodeDecodeError, csv.Error) as error:
        raise FileError(f"'{source}' is not a table of text: {error}; save it as CSV.") from error
    names = [name.strip() for name in rows[0]]
    _check_names(source, names)
    for (number, _), row in zip(lines[1:], rows[1:], strict=False):
        if len(row) != len(names):
            raise FileError(
                f"'{source}' line {number} has {len(row)} cells and the line of names"
                f" {len(names)}; is the file cut short?"
            )
    cells = list(zip(*rows[1:], strict=True)) or [()] * len(names)
    return Sheet(
        source,
        dict(zip(names, cells, strict=True)),
        [f"line {number}" for number, _ in lines[1:]],
    )


def _parquet(source: Path) -> Sheet:
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError as error:
        raise ConfigError(
            f"'{source}' needs pyarrow: pip install 'tactorch[tables]', or save it as CSV."
        ) from error
    try:
        file = parquet.ParquetFile(source, read_dictionary=_text_columns(source))
        _check_rows(source, file.metadata.num_rows, file.metadata.num_columns)
        table = file.read()
    except (pyarrow.ArrowException, OSError, ValueError) as error:
        raise FileError(f"'{source}' cannot be read as Parquet: {error}.") from error
    _check_names(source, table.column_names)
    columns = {name: _cells(table.column(name)) for name in table.column_names}
    return Sheet(source, columns, [f"row {i}" for i in range(table.num_rows)])


def _text_columns(source: Path) -> list[str]:
    """Return the columns that are not of numbers; their repeated values are stored once."""
    from pyarrow import parquet, types

    schema = parquet.read_schema(source)
    nested = next((f.name for f in schema if types.is_nested(f.type)), None)
    if nested is not None:
        raise FileError(f"'{source}' has a list or table in each row of {nested!r}; remove it.")
    return [f.name for f in schema if types.is_string(f.type) or types.is_binary(f.type)]


def _cells(column: Any) -> list[Any]:
    """Return the cells of a column; equal texts that the file has once are one object."""
    cells: list[Any] = []
    for chunk in column.chunks:
        if not hasattr(chunk, "dictionary"):
            cells += chunk.to_pylist()
            continue
        values = chunk.dictionary.to_pylist()
        cells += [None if i is None else values[i] for i in chunk.indices.to_pylist()]
    return cells


def _check_rows(source: Path, rows: int, columns: int) -> None:
    claim = f"{rows} rows of {columns} columns"
    check_memory(source, claim, rows * columns * _BYTES_PER_CELL)


def _as_text(cell: Any) -> str:
    if cell is None or cell != cell:  # NaN stands for an empty cell, too
        return ""
    if isinstance(cell, float) and cell.is_integer():
        return str(int(cell))
    return str(cell).strip()


def _check_names(source: Path, names: list[str]) -> None:
    twice = next((name for name in names if name and names.count(name) > 1), None)
    if twice is not None:
        raise FileError(f"'{source}' has two columns {twice!r}; rename or remove one.")
