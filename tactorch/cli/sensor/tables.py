"""Tables and arrays of what was measured, whole or absent."""

import csv
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tactorch.files import atomic_path


def write_table(path: Path, header: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Write a CSV file; what is None or not a number stays empty."""
    with atomic_path(path) as temporary, open(temporary, "w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(header)
        table.writerows([_cell(value) for value in row] for row in rows)


def write_arrays(path: Path, **arrays: Any) -> None:
    """Write an npz file; what is None is left out."""
    given = {name: values for name, values in arrays.items() if values is not None}
    with atomic_path(path) as temporary, open(temporary, "wb") as file:
        np.savez_compressed(file, **given)


def _cell(value: Any) -> Any:
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return ""
    return f"{value:.6g}" if isinstance(value, float) else value
