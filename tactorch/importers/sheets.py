"""Tables in CSV and Parquet files: columns by name, with errors that name file and row."""

import csv
import logging
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from jaxtyping import Float

from tactorch.budget import TEXT, check_memory, read_content
from tactorch.errors import ConfigError, FileError
from tactorch.files import require_file
from tactorch.importers.quantities import SUFFIXES as UNITS
from tactorch.importers.quantities import assign, clean

_log = logging.getLogger(__name__)
SUFFIXES = (".csv", ".txt", ".tsv", ".parquet")
_DELIMITERS = ",;\t"
_COMMENTS = ("#", "%", "//", "sep=", '"sep=')  # the last ones of Excel
_UTF_16 = re.compile(rb"\xff\xfe[^\0]\0|\xfe\xff\0[^\0]")  # its mark and a letter
_MAX_ABOVE = 100  # lines above the names
_MAX_CELL = 1000  # characters; arrays of text are as wide as the longest
_BYTES_PER_CELL = 64  # of a number of Python in a list
_MISSING = ("", "-", "nan", "na", "n/a", "null", "none")


@dataclass(frozen=True, eq=False)
class Sheet:
    """A table."""

    path: Path
    columns: dict[str, Sequence[Any]]  # cells, text or numbers
    lines: Sequence[str]  # what messages call each row

    def numbers(self, name: str, *, finite: bool = True) -> Float[np.ndarray, " rows"]:
        """Return a column of numbers, NaN where a cell is empty."""
        try:
            values = np.array(self.columns[name]).astype(np.float64)
        except ValueError:  # an empty cell, a decimal comma, or no number
            values = np.array([self._number(name, i) for i in range(len(self.lines))])
        if finite and np.isinf(values).any():
            self._refuse(name, int(np.isinf(values).argmax()))
        return values

    def texts(self, name: str) -> list[str]:
        """Return a column of text, "" where a cell is empty; whole numbers have no decimals."""
        return [_as_text(cell) for cell in self.columns[name]]

    def assigned(
        self,
        columns: Mapping[str, str] | None,
        units: Mapping[str, str] | None,
        known: Mapping[str, Mapping[str, float]],
        required: Mapping[str, str] | None = None,
        what: str = "",
    ) -> dict[str, tuple[str, float]]:
        """Return the column and the factor of each quantity, see `assign`.

        `required` has the usual columns of those that `what` needs. Errors name the file.
        """
        try:
            found = assign(list(self.columns), columns or {}, units or {}, known)
        except ConfigError as error:
            raise ConfigError(f"'{self.path}': {error}") from error
        missing = next((name for name in required or {} if name not in found), None)
        if required and missing is not None:
            raise FileError(
                f"'{self.path}' lacks the column {required[missing]!r}; its columns are "
                f"{', '.join(self.columns)}. A {what} needs {', '.join(required.values())}; other "
                f"names are stated as in format.columns={{{missing}: NAME}}."
            )
        return found

    def _number(self, name: str, row: int) -> float:
        cell = self.columns[name][row]
        if cell is None or (isinstance(cell, str) and cell.strip().lower() in _MISSING):
            return float("nan")
        try:
            return float(_with_point(cell))
        except (TypeError, ValueError):
            self._refuse(name, row)

    def _refuse(self, name: str, row: int) -> NoReturn:
        raise FileError(
            f"'{self.path}' {self.lines[row]}, column {name!r}, has {self.columns[name][row]!r}, "
            "which is not a finite number; repair it, or leave the cell empty."
        )


def read_sheet(path: str | Path, what: str = "table of presses") -> Sheet:
    """Read a table with a line of names: text with commas, semicolons, tabs or spaces, or Parquet.

    Lines that are empty or start with #, % or // are ignored, except names in the last of them
    above the numbers, and rows that all start with #. Lines above the names are skipped. Units may
    be in a second line. Decimals may have commas. Rows may have numbers without a name before them.
    Lines of names within the table, as after a restart of a logger, are left out. Messages name the
    expected content `what`.
    """
    source = require_file(path, what)
    sheet = _parquet(source) if source.suffix.lower() == ".parquet" else _text(source)
    if not len(sheet.lines):
        raise FileError(f"'{source}' has no rows; a {what} has a line for each sample or point.")
    _check_cells(sheet)
    return sheet


def _check_cells(sheet: Sheet) -> None:
    """Refuse text that is too long for a number or a name."""
    for name, cells in sheet.columns.items():
        for line, cell in zip(sheet.lines, cells, strict=True):
            if isinstance(cell, str) and len(cell) > _MAX_CELL:
                raise FileError(
                    f"'{sheet.path}' {line}, column {name[:20]!r}, has {len(cell)} characters, more"
                    f" than {_MAX_CELL}; shorten them."
                )


def _text(source: Path) -> Sheet:
    try:
        content = read_content(source, TEXT)
        texts = content.decode("utf-16" if _UTF_16.match(content) else "utf-8-sig").splitlines()
        stripped = ((n, text.strip(" ")) for n, text in enumerate(texts, start=1) if text)
        numbered = [(n, text) for n, text in stripped if text.strip()]
        lines = [(n, t) for n, t in numbered if not t.startswith(_COMMENTS)]
        if len(lines) == 1:  # names of probes such as #1
            lines += [(n, t) for n, t in numbered if n > lines[0][0] and t.startswith("#")]
        if not lines:
            raise FileError(f"'{source}' is empty; a table has a line of names, then numbers.")
        at = numbered.index(lines[0])
        if at and any(map(_is_number, re.split(r"[;,\s]+", lines[0][1]))):
            lines.insert(0, (numbered[at - 1][0], numbered[at - 1][1].lstrip("#%/ ")))
        lines = lines[_find_names([text for _, text in lines]) :]
        rows = _split([text for _, text in lines])
    except (UnicodeDecodeError, csv.Error) as error:
        raise FileError(
            f"'{source}' is not a table of text: {error}; save it as CSV in UTF-8."
        ) from error
    numbers = [number for number, _ in lines]
    return _table(source, list(zip(numbers, rows, strict=True)))


def _find_names(lines: list[str]) -> int:
    """Return the first line with as many cells as that in the middle, which are mostly numbers.

    It is the first of all where none is such, or has numbers.
    """
    for i, line in enumerate(lines[:_MAX_ABOVE]):
        names, cells = _split([line, lines[len(lines) // 2]])
        filled = sum(map(bool, names))
        fits = 1 < sum(map(bool, cells)) <= filled + 1
        if fits and 2 * sum(map(_is_number, cells)) >= sum(map(bool, cells)) and filled > 1:
            return 0 if any(map(_is_number, names)) else i
    return 0


def _split(lines: list[str]) -> list[list[str]]:
    """Return the cells of lines, by the delimiter that the first has most often, else spaces."""
    delimiter = max(_DELIMITERS, key=lines[0].count)
    delimiter = delimiter if delimiter in lines[0] else " "
    reader = csv.reader(lines, delimiter=delimiter, strict=True, skipinitialspace=True)
    return [[cell.strip() for cell in row] for row in reader]


def _table(source: Path, numbered: list[tuple[int, list[str]]]) -> Sheet:
    """Return the sheet of a line of names and the cells of numbered lines below it."""
    (at, header), *rows = numbered
    names, count, heads = header, len(rows), [header]
    units = [clean(cell) for cell in rows[0][1]] if rows else []
    if any(unit in UNITS for unit in units) and not any(map(_is_number, rows[0][1])):
        names = [_with_unit(*pair) for pair in zip(names, units, strict=False)]
        count, heads = count - 1, [header, rows[0][1]]
    rows = [(number, row) for number, row in rows if row not in heads]
    if len(rows) < count:
        _log.info("'%s': %d lines repeat the names or units.", source, count - len(rows))
    extra = [row[0] for _, row in rows if len(row) == len(names) + 1 and row[-1]]
    if rows and extra == [str(i + 1) for i in range(len(rows))]:
        names = ["", *names]  # R writes numbers of the rows without a name
    _check_names(source, names)
    cells = []
    for number, row in rows:
        if len(row) < len(names) or any(row[len(names) :]):
            raise FileError(
                f"'{source}' line {number} has {len(row)} cells and the line of names (line {at})"
                f" {len(names)}; is the file cut short, or are there spaces in names?"
            )
        cells.append(row[: len(names)])
    columns = list(zip(*cells, strict=True)) or [()] * len(names)
    lines = [f"line {number}" for number, _ in rows]
    return Sheet(source, dict(zip(names, columns, strict=True)), lines)


def _with_unit(name: str, unit: str) -> str:
    """Return the name of a column with the unit that is stated below it."""
    return name if not unit or clean(name).endswith(f"_{unit}") else f"{name} [{unit}]"


def _with_point(cell: Any) -> Any:
    """Return a cell with a decimal point instead of a comma."""
    if isinstance(cell, str) and cell.count(",") == 1 and "." not in cell:
        return cell.replace(",", ".")
    return cell


def _is_number(cell: str) -> bool:
    try:
        float(_with_point(cell))
    except ValueError:
        return False
    return True


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
        rows, columns = file.metadata.num_rows, file.metadata.num_columns
        claim = f"{rows} rows of {columns} columns"
        check_memory(source, claim, rows * columns * _BYTES_PER_CELL)
        table = file.read()
    except (pyarrow.ArrowException, OSError, ValueError) as error:
        raise FileError(f"'{source}' cannot be read as Parquet: {error}.") from error
    _check_names(source, table.column_names)
    cells: dict[str, Sequence[Any]] = {n: _cells(table.column(n)) for n in table.column_names}
    return Sheet(source, cells, [f"row {i}" for i in range(rows)])


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


def _as_text(cell: Any) -> str:
    if cell is None or cell != cell:  # NaN stands for an empty cell, too
        return ""
    if isinstance(cell, float) and cell.is_integer():
        return str(int(cell))
    return str(cell).strip()


def _check_names(source: Path, names: list[str]) -> None:
    twice = next((name for name, count in Counter(names).items() if name and count > 1), None)
    if twice is not None:
        raise FileError(f"'{source}' has two columns {twice!r}; rename or remove one.")
