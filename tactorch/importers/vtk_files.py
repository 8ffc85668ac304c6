"""Points, triangles and fields of VTK files (.vtu, .vtk and .vtp)."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from math import prod
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from tactorch.budget import check_memory, check_stored, read_content
from tactorch.errors import FileError
from tactorch.files import require_file
from tactorch.mesh.formats.cells import Cells
from tactorch.mesh.formats.vtk import read_xml
from tactorch.mesh.io import reading

SUFFIXES = (".vtu", ".vtk", ".vtp")
_EXPANSION = 8  # bytes of memory for each of a file, in meshio
_HEADER = re.compile(
    rb"^[ \t]*(DIMENSIONS|POINTS|CELLS|CELL_TYPES|[XYZ]_COORDINATES)"
    rb"((?:[ \t]+\d{1,18})+)", re.MULTILINE | re.IGNORECASE
)  # fmt: skip
_POINT = 400  # bytes in meshio for each point of a grid that DIMENSIONS states, with its cells
#: Names that a field may have, in lower case without other characters.
NAMES = {
    "displacement": ("u", "disp", "displ", "displacement", "displacements", "displacementvector"),
    "force": ("f", "force", "forces", "nodalforce", "nodalforces", "externalforce", "load"),
    "traction": ("t", "traction", "tractions", "tractionvector", "surfacetraction"),
    "pressure": ("p", "pressure", "contactpressure"),
}


@dataclass(frozen=True, eq=False)
class VtkFile:
    """Content of a file."""

    path: Path
    points: Float[np.ndarray, "n 3"]  # in the unit of the file
    tets: Int[np.ndarray, "m 4"]  # none in a file of a surface
    triangles: Int[np.ndarray, "k 3"]
    fields: Mapping[str, np.ndarray]  # values at the points
    cell_fields: tuple[str, ...] = ()  # names of fields of the cells

    def __post_init__(self) -> None:
        places = np.asarray(self.points, dtype=np.float64)
        object.__setattr__(self, "points", places)
        if places.ndim != 2 or places.shape[1] != 3 or not np.isfinite(places).all():
            raise FileError(
                f"'{self.path}' has points that are not three finite numbers; repair it."
            )
        for cells in (self.tets, self.triangles):
            if cells.size and not 0 <= cells.min() <= cells.max() < len(places):
                raise FileError(
                    f"'{self.path}' has cells of points that do not exist; is it complete?"
                )

    def field(self, what: str, name: str | None, width: int) -> np.ndarray | None:
        """Return the field of a quantity of `NAMES` at the points; None where there is none.

        Without its name it is the one that has a name of the quantity.
        """
        if name is None:
            found = [n for n in self.fields if re.sub("[^a-z]", "", n.lower()) in NAMES[what]]
            if not found:
                return None
            if len(found) > 1:
                raise FileError(
                    f"'{self.path}' has several fields that may be the {what}: {', '.join(found)}; "
                    f"choose one by format.{what}."
                )
            name = found[0]
        if name not in self.fields:
            raise FileError(
                f"'{self.path}' has no field {name!r} at points; {self.listing()} Choose another "
                f"by format.{what}."
            )
        values = np.asarray(self.fields[name])
        if values.dtype.kind not in "fiu" or values.size != width * len(self.points):
            raise FileError(
                f"'{self.path}': the field {name!r} has the shape {values.shape}; {what} needs "
                f"{width} number{'s' if width > 1 else ''} at each of {len(self.points)} points."
            )
        return values.astype(np.float64).reshape((-1, width) if width > 1 else -1)

    def listing(self) -> str:
        """Return the names of the fields, as a sentence."""
        points = ", ".join(self.fields) or "none"
        cells = f", of cells, which are not read: {', '.join(self.cell_fields)}"
        return f"its fields are {points}{cells if self.cell_fields else ''}."


def read_vtk(path: str | Path) -> VtkFile:
    """Read a file."""
    source = require_file(path, "VTK file")
    suffix = source.suffix.lower()
    if suffix == ".vtk":
        import meshio

        _check_legacy(source)
        with reading(source, "vtk"):
            content = meshio.vtk.read(str(source))
        cells = [Cells(block.type, block.data.astype(np.int64)) for block in content.cells]
        points, fields, of_cells = content.points, content.point_data, content.cell_data
    else:
        with reading(source, suffix[1:]):
            xml = read_xml(source)
        points, cells, fields, of_cells = xml.points, xml.cells, xml.fields, xml.cell_fields
    if not len(points):
        raise FileError(f"'{source}' contains no points: it is empty, or not of the format.")
    tets, three, four = (
        np.concatenate([np.zeros((0, n), np.int64), *(c.nodes for c in cells if c.kind == kind)])
        for kind, n in (("tetra", 4), ("triangle", 3), ("quad", 4))
    )
    halves = four[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)  # of quadrangles
    triangles = np.vstack((three, halves))
    return VtkFile(source, points, tets, triangles, dict(fields), tuple(of_cells))


def _check_legacy(source: Path) -> None:
    """Refuse a file (.vtk) that states more than it holds, or than may be in memory."""
    for key, words in _HEADER.findall(read_content(source, _EXPANSION)):
        numbers, name = [int(word) for word in words.split()], key.decode().upper()
        claim = f"{name} {' '.join(map(str, numbers))}"
        if name == "DIMENSIONS":
            check_memory(source, claim, _POINT * prod(numbers))
        else:
            check_stored(source, claim, max(numbers))
