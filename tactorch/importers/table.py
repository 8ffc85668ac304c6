"""Displacements and forces at points, as a table or a folder of tables.

A row is a point of a press: a node of the mesh or any point of its surface. See
`tactorch.importers.quantities` for the columns and their units. Several presses are distinguished
by the column `press`, or have one file each, in a folder. Displacements of nodes are data of these
nodes; those of other points, and those along a normal, are readings at the nearest points of the
surface. Forces at other points are divided among the nodes of their triangle.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from tactorch.config import option
from tactorch.errors import ConfigError, FileError
from tactorch.importers.points import PointData, PointOptions, press_files
from tactorch.importers.quantities import UNITS, vector
from tactorch.importers.sheets import SUFFIXES, Sheet, read_sheet
from tactorch.mesh import read_mesh
from tactorch.recording import Recording


@dataclass(frozen=True, kw_only=True)
class TableOptions(PointOptions):
    """Read displacements and forces at points from CSV or Parquet (see the module's docstring)."""

    mesh: Path | None = option(None, "Mesh of the object at rest; required")
    columns: Mapping[str, str] | None = option(
        None, "Columns of quantities that have other names, such as {ux: disp_x}"
    )
    units: Mapping[str, str] | None = option(
        None, "Units of quantities that no suffix of the name states, such as {ux: m}"
    )
    first_node: int = option(0, "Number of the first node", ge=0, le=1)

    def __call__(self, *, path: str | Path) -> Recording:
        """Read a file or a folder; see `import_table`."""
        if self.mesh is None:
            raise ConfigError("format.mesh is required: the mesh of the object at rest.")
        mesh = read_mesh(self.mesh, self.unit, drop_unreferenced=False)
        files = press_files(Path(path), SUFFIXES, "table")
        presses = [data for file in files for data in self._read(read_sheet(file), len(files) > 1)]
        names = Counter(data.name for data in presses)
        twice = next((name for name, count in names.items() if count > 1), None)
        if twice is not None:
            raise FileError(f"'{path}' has the press '{twice}' in two files; rename one.")
        return self.record(mesh, presses, path, "table")

    def _read(self, sheet: Sheet, in_folder: bool) -> list[PointData]:
        """Return the presses of a table."""
        found = sheet.assigned(self.columns, self.units, UNITS)
        quantities = {
            name: factor * sheet.numbers(column)
            for name, (column, factor) in found.items()
            if name != "press"
        }
        _check_columns(sheet, quantities)
        names = sheet.texts(found["press"][0]) if "press" in found else None
        if names is None:
            groups = {sheet.path.stem: np.arange(len(sheet.lines))}
        else:
            numbers = {name: number for number, name in enumerate(dict.fromkeys(names))}
            of_row = np.array([numbers[name] for name in names])
            ends = np.cumsum(np.bincount(of_row))[:-1]
            rows_of = np.split(np.argsort(of_row, kind="stable"), ends)
            groups = dict(zip(numbers, rows_of, strict=True))
            if "" in groups:
                raise FileError(
                    f"'{sheet.path}' {sheet.lines[groups[''][0]]} names no press; fill in the "
                    "column 'press'."
                )
            if in_folder:
                groups = {f"{sheet.path.stem} {name}": rows for name, rows in groups.items()}
        return [self._data(sheet, name, rows, quantities) for name, rows in groups.items()]

    def _data(
        self,
        sheet: Sheet,
        name: str,
        rows: Int[np.ndarray, " r"],
        quantities: dict[str, Float[np.ndarray, " rows"]],
    ) -> PointData:
        def one(quantity: str) -> np.ndarray:
            values = quantities.get(quantity)
            return np.full(len(rows), np.nan) if values is None else values[rows]

        def three(letter: str) -> np.ndarray:
            return np.column_stack([one(component) for component in vector(letter)])

        def where(row: int) -> str:
            return f"'{sheet.path}' {sheet.lines[rows[row]]}"

        node, step = one("node"), one("step")
        wrong = np.isfinite(node) & ((node != np.round(node)) | (node < self.first_node))
        if wrong.any():
            row = int(wrong.argmax())
            raise FileError(
                f"{where(row)} names node {node[row]:g}; nodes are whole numbers from "
                f"{self.first_node} (format.first_node)."
            )
        steps = np.unique(step[np.isfinite(step)])
        if len(steps) > 1 or (steps != np.round(steps)).any() or (steps < 0).any():
            shown = ", ".join(f"{s:g}" for s in steps)
            raise FileError(
                f"'{sheet.path}': press '{name}' has the steps {shown}; give one whole number from"
                " 0."
            )
        return PointData(
            name=name,
            where=where,
            nodes=np.where(np.isfinite(node), node - self.first_node, -1).astype(np.int64),
            points=three(""),
            displacement=three("u"),
            along_normal=one("u_n"),
            normals=three("n"),
            forces=three("f"),
            tractions=three("t"),
            pressure=one("p"),
            areas=one("area"),
            noise=one("noise"),
            fixed=three("fixed_") if any(q in quantities for q in vector("fixed_")) else None,
            springs=three("spring_") if any(q in quantities for q in vector("spring_")) else None,
            step=int(steps[0]) if len(steps) else 0,
        )


def import_table(path: str | Path, *, mesh: str | Path, **options: Any) -> Recording:
    """Read displacements and forces at points (see the module's docstring).

    Args:
        path: CSV or Parquet file, or a folder of them.
        mesh: Mesh of the object at rest.
        options: Further settings, see `TableOptions`.

    Returns:
        A recording with presses in the order in which they appear, files by their names.

    Raises:
        ConfigError: A setting is not valid, or Parquet is read without pyarrow.
        FileError: A file cannot be used; names file, row or column, and remedy.
        MeshError: The mesh cannot be used.
        RecordingError: The files do not make a valid recording.
    """
    return TableOptions(mesh=Path(mesh), **options)(path=path)


def _check_columns(sheet: Sheet, quantities: dict[str, np.ndarray]) -> None:
    """Refuse a table without a place, a displacement or a load."""
    position = [name for name in vector("") if name in quantities]
    if "node" not in quantities and len(position) < 3:
        lacks = [name for name in vector("") if name not in position]
        raise FileError(
            f"'{sheet.path}' has no column 'node' and lacks {', '.join(lacks)}; its columns are "
            f"{', '.join(sheet.columns)}. Rename them, or state them by format.columns."
        )
    needed = {
        "displacement (ux, uy, uz, u_n)": (*vector("u"), "u_n"),
        "force (fx, fy, fz, tx, ty, tz, p)": (*vector("f"), *vector("t"), "p"),
    }
    for what, names in needed.items():
        if not any(name in quantities for name in names):
            raise FileError(
                f"'{sheet.path}' has no column of a {what}; its columns are "
                f"{', '.join(sheet.columns)}. Rename them, or state them by format.columns."
            )
