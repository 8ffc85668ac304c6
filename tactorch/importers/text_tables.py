"""Numbers in text files, read strictly: errors name file, line and remedy."""

import math
from pathlib import Path

import numpy as np
from jaxtyping import Float

from tactorch.errors import FileError
from tactorch.files import require_file


def read_numbers(path: str | Path, what: str, count: int, reason: str) -> Float[np.ndarray, " k"]:
    """Read exactly `count` finite numbers, separated by white space or line ends.

    Messages name the expected content `what`, and the `reason` for the count.
    """
    source = require_file(path, what)
    values = [
        _number(token, source, number)
        for number, line in enumerate(_lines(source), start=1)
        for token in line.split()
    ]
    if len(values) != count:
        raise FileError(
            f"'{source}' holds {len(values)} numbers; {what} needs {count} ({reason}). "
            "Is it cut short, or of another mesh?"
        )
    return np.array(values, dtype=np.float64)


def read_diagonal(path: str | Path, what: str, size: int) -> Float[np.ndarray, " k"]:
    """Read the diagonal of a matrix of `size` rows given as lines of `row col value`, from 0.

    Entries off the diagonal, given twice or negative are refused; the others are 0.
    """
    source = require_file(path, what)
    diagonal = np.zeros(size)
    line_of: dict[int, int] = {}
    for number, line in enumerate(_lines(source), start=1):
        if not line.strip():
            continue
        row, value = _entry(line, source, number, size)
        if row in line_of:
            raise FileError(
                f"'{source}' line {number} repeats degree of freedom {row} of line {line_of[row]}; "
                "keep one of the two"
            )
        line_of[row] = number
        diagonal[row] = value
    return diagonal


def _lines(source: Path) -> list[str]:
    try:
        return source.read_text(encoding="utf-8").splitlines()
    except UnicodeDecodeError as error:
        raise FileError(f"'{source}' is not a text file: {error}; give numbers as text") from error


def _entry(line: str, source: Path, number: int, size: int) -> tuple[int, float]:
    tokens = line.split()
    where = f"'{source}' line {number}"
    if len(tokens) != 3:
        raise FileError(f"{where} is {line.strip()!r}; 'row col value' is needed")
    row, column, value = (_number(token, source, number) for token in tokens)
    for index in (row, column):
        if index != int(index) or not 0 <= index < size:
            raise FileError(
                f"{where} names degree of freedom {tokens[0]} {tokens[1]}, but the mesh has "
                f"{size} (0 to {size - 1}: x y z of node 0, of node 1, ...). Is the file of "
                "another mesh, or counted from 1?"
            )
    if row != column:
        raise FileError(
            f"{where} is off the diagonal ({tokens[0]}, {tokens[1]}); only the diagonal has a "
            "meaning here: each degree of freedom on its own"
        )
    if value < 0:
        raise FileError(f"{where} has the negative value {tokens[2]}; give one of at least 0")
    return int(row), value


def _number(token: str, source: Path, line: int) -> float:
    try:
        value = float(token)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise FileError(
            f"'{source}' line {line} has {token!r}, which is not a finite number; "
            "repair the line, or leave out the press it belongs to"
        )
    return value
