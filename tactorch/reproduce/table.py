"""Tables as CSV and as Markdown."""

import csv
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tactorch.files import atomic_path


@dataclass
class Table:
    """Rows of values under names; None is an empty cell.

    Attributes:
        columns: Their names, with units.
        digits: Decimals of the numbers of each column; 4 where there are none given.
        rows: One list of values a row.
    """

    columns: Sequence[str]
    digits: Sequence[int | None] = ()
    rows: list[list[Any]] = field(default_factory=list)

    def add(self, *values: Any) -> None:
        """Add a row, as long as there are columns."""
        if len(values) != len(self.columns):
            raise ValueError(f"{len(values)} values for {len(self.columns)} columns")
        self.rows.append(list(values))

    def write_csv(self, path: Path) -> Path:
        """Write with all digits."""
        with atomic_path(path) as temporary, open(temporary, "w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(self.columns)
            writer.writerows(["" if v is None else v for v in row] for row in self.rows)
        return path

    def markdown(self) -> str:
        """Return the table as Markdown."""
        lines = [self.columns, ["---"] * len(self.columns)]
        lines += [[self._shown(v, i) for i, v in enumerate(row)] for row in self.rows]
        return "\n".join(f"| {' | '.join(line)} |" for line in lines)

    def _shown(self, value: Any, column: int) -> str:
        if value is None:
            return ""
        if isinstance(value, float):
            digits = self.digits[column] if column < len(self.digits) else None
            return f"{value:.{4 if digits is None else digits}f}"
        return str(value)
