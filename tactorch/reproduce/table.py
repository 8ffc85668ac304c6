"""Tables in CSV and Markdown."""

import csv
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tactorch.files import atomic_path


@dataclass
class Table:
    """Table; None is an empty cell.

    Attributes:
        columns: Names of the columns with units.
        digits: Number of decimals of each column in Markdown; 4 if None.
        rows: Values of each row.
    """

    columns: Sequence[str]
    digits: Sequence[int | None] = ()
    rows: list[list[Any]] = field(default_factory=list)

    def add(self, *values: Any) -> None:
        """Append a row with one value per column."""
        if len(values) != len(self.columns):
            raise ValueError(f"{len(values)} values for {len(self.columns)} columns")
        self.rows.append(list(values))

    def write_csv(self, path: Path) -> Path:
        """Write the table with all digits and return the path."""
        with atomic_path(path) as temporary, open(temporary, "w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(self.columns)
            writer.writerows(["" if v is None else v for v in row] for row in self.rows)
        return path

    def markdown(self) -> str:
        """Return the table as Markdown."""
        lines = [self.columns, ["---"] * len(self.columns)]
        lines += [[self._format(v, i) for i, v in enumerate(row)] for row in self.rows]
        return "\n".join(f"| {' | '.join(line)} |" for line in lines)

    def _format(self, value: Any, column: int) -> str:
        if value is None:
            return ""
        if isinstance(value, float):
            digits = self.digits[column] if column < len(self.digits) else None
            return f"{value:.{4 if digits is None else digits}f}"
        return str(value)
