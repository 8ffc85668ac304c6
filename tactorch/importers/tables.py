"""Tables of numbers in CSV files, with errors that name file, line and column."""

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from tactorch.errors import FileError
from tactorch.files import require_file


def read_table(
    path: str | Path, what: str, required: Sequence[str], optional: Sequence[str] = ()
) -> dict[str, Float[np.ndarray, " rows"]]:
    """Read columns of a CSV file whose first line names them.

    Empty cells are NaN. Other columns are ignored; of the optional ones all or none are read.

    Raises:
        FileError: the file is missing, is not text, has no rows, lacks a column or names one twice,
            or a cell is not a number.
    """
    source = require_file(path, what)
    try:
        with source.open(encoding="utf-8-sig", newline="") as file:
            rows = list(csv.reader(file))
    except (UnicodeDecodeError, csv.Error) as error:
        raise FileError(f"'{source}' is not a CSV file: {error}; give numbers as text.") from error
    if not rows:
        raise FileError(f"'{source}' is empty; {what} has a line of names, then numbers.")
    names = [name.strip() for name in rows[0]]
    missing = [name for name in required if name not in names]
    if missing:
        raise FileError(
            f"'{source}' lacks the column {missing[0]!r}; its columns are {', '.join(names)}. "
            f"{what} needs {', '.join(required)}, with commas between them."
        )
    wanted = [*required, *(optional if set(optional) <= set(names) else ())]
    twice = next((name for name in wanted if names.count(name) > 1), None)
    if twice is not None:
        raise FileError(f"'{source}' has two columns {twice!r}; rename or remove one.")
    if len(rows) < 2:
        raise FileError(f"'{source}' has no rows; {what} has a line for each sample.")
    columns = [names.index(name) for name in wanted]
    values = np.array([
        [_number(source, line, row, column, names) for column in columns]
        for line, row in enumerate(rows[1:], start=2)
        if row
    ])  # fmt: skip
    return dict(zip(wanted, np.ascontiguousarray(values.T), strict=True))


def _number(source: Path, line: int, row: list[str], column: int, names: list[str]) -> float:
    if len(row) != len(names):
        raise FileError(
            f"'{source}' line {line} has {len(row)} cells and the first line {len(names)}; is the "
            "file cut short?"
        )
    cell = row[column].strip()
    try:
        return float(cell) if cell else float("nan")
    except ValueError:
        raise FileError(
            f"'{source}' line {line}, column {names[column]!r}, has {cell!r}, which is not a "
            "number; repair it, or leave the row out."
        ) from None
