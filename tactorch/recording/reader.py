"""Reading a recording out of an open HDF5 file, believing nothing that it says."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tactorch.errors import MeshError, RecordingError
from tactorch.mesh import TetMesh
from tactorch.recording.material import MaterialSpec
from tactorch.recording.press import Press
from tactorch.recording.recording import Recording
from tactorch.recording.schema import (
    FORMAT,
    PRESS_ARRAYS,
    PRESS_MASKS,
    PRESS_OPTIONAL,
    UNITS,
    VERSION,
)

if TYPE_CHECKING:
    import h5py


class Reader:
    """Reads one open file, or a group of one; complaints name the file and the dataset."""

    def __init__(
        self, file: "h5py.Group", source: Path | str, known: TetMesh | None = None
    ) -> None:
        """Take what to read; a mesh that is `known` to be the file's is not read again."""
        self.file = file
        self.source = source
        self.known = known

    def recording(self, check_units: bool, presses: Sequence[Press] | None = None) -> Recording:
        """Read and check everything; the file's own presses only where none are given."""
        count = self.count()
        mesh = self.mesh()
        material = self.material()
        if presses is None:
            presses = [self.press(index, mesh.n_points) for index in range(count)]
        provenance = self._json("provenance", self._text("provenance"))
        moduli = {
            name: self._array(name, "f", (mesh.n_tets,)) if name in self.file else None
            for name in ("truth", "reference")
        }
        n = mesh.n_points
        unloaded = self._array("unloaded", "f", (None, n, 3)) if "unloaded" in self.file else None
        try:
            return Recording(
                mesh,
                tuple(presses),
                material,
                **moduli,
                provenance=provenance,
                density=self.density(),
                gravity=self.gravity(),
                unloaded=unloaded,
                check_units=check_units,
            )
        except RecordingError as error:
            raise self._error(f"does not hold together: {error}") from error

    def _check_format(self) -> None:
        kind = self._attribute("/", "format", str) if "format" in self.file.attrs else None
        if kind != FORMAT:
            raise self._error(
                f"has format {kind!r} where {FORMAT!r} is expected; it is HDF5, but not a "
                "recording of tactorch: give the file that Recording.save wrote"
            )
        version = self._attribute("/", "version", int)
        if version > VERSION:
            raise self._error(
                f"has version {version}, and this tactorch reads up to {VERSION}; upgrade tactorch"
            )
        if version < 1:
            raise self._error(f"has version {version}, which never existed; write it again")
        units = self._attribute("/", "units", str)
        if units != UNITS:
            raise self._error(f"is in units {units!r}; {UNITS!r} is needed: convert the values")

    def mesh(self) -> TetMesh:
        """Read the mesh."""
        if self.known is not None:
            return self.known
        points = self._array("mesh/points", "f", (None, 3))
        tets = self._array("mesh/tets", "i", (None, 4))
        try:
            return TetMesh.create(points, tets, repair=False)
        except MeshError as error:
            raise self._error(f"dataset 'mesh' is not a sound mesh: {error}") from error

    def material(self) -> MaterialSpec:
        """Read the constitutive law."""
        name = self._attribute("material", "name", str)
        poisson = self._attribute("material", "poisson", float)
        text = self._attribute("material", "parameters", str)
        try:
            return MaterialSpec(name, poisson, self._json("material/parameters", text))
        except RecordingError as error:
            raise self._error(f"'material' is not sound: {error}") from error

    def density(self) -> float | None:
        """Read the mass density, tonne/mm^3; None where weight plays no part."""
        return self._attribute("/", "density", float) if "density" in self.file.attrs else None

    def gravity(self) -> np.ndarray:
        """Read the acceleration of gravity, mm/s^2."""
        return self._array("gravity", "f", (3,))

    def count(self) -> int:
        """Return the number of presses; a file that declares more than it holds is refused."""
        self._check_format()
        count, groups = self._attribute("presses", "count", int), len(self.file["presses"])
        if not 0 <= count <= groups:
            raise self._error(
                f"declares {count} presses (attribute 'count' of 'presses') and holds {groups}; "
                "the file is incomplete: write it again"
            )
        return count

    def press(self, index: int, n_points: int) -> Press:
        """Read and check a press by its number from 0."""
        path = f"presses/{index:04d}"
        fields: dict[str, Any] = {}
        for field in PRESS_ARRAYS:
            kind = "b" if field in PRESS_MASKS else "f"
            fields[field] = self._array(f"{path}/{field}", kind, (n_points, 3))
        for field, shape in PRESS_OPTIONAL.items():
            if f"{path}/{field}" in self.file:
                wanted = tuple(n_points if size is None else size for size in shape)
                fields[field] = self._array(f"{path}/{field}", "f", wanted)
        fields["name"] = self._attribute(path, "name", str)
        fields["step"] = self._attribute(path, "step", int)
        if "noise_mm" in self.file[path].attrs:
            fields["noise_mm"] = self._attribute(path, "noise_mm", float)
        try:
            return Press(**fields)
        except RecordingError as error:
            raise self._error(f"'{path}' is not sound: {error}") from error

    def _array(self, name: str, kind: str, shape: tuple[int | None, ...]) -> np.ndarray:
        """Read a dataset; kind: f real, i integer, b mask of 0 and 1."""
        dataset = self._dataset(name)
        allowed = {"f": ("f", "float64"), "i": ("iu", "int64"), "b": ("ub", "uint8")}[kind]
        if dataset.dtype.kind not in allowed[0]:
            raise self._error(
                f"dataset '{name}' has dtype {dataset.dtype}; {allowed[1]} is needed: "
                "write the recording again with Recording.save"
            )
        self._check_shape(name, dataset.shape, shape)
        array = self._values(name, dataset)
        if kind == "b" and (array > 1).any():
            raise self._error(f"dataset '{name}' is a mask but holds values other than 0 and 1")
        return array.astype({"f": np.float64, "i": np.int64, "b": np.bool_}[kind])

    def _dataset(self, name: str) -> "h5py.Dataset":
        import h5py

        found = self.file.get(name)
        if not isinstance(found, h5py.Dataset):
            raise self._error(
                f"lacks dataset '{name}'; the file is incomplete: write the recording again with "
                "Recording.save (layout: tactorch.recording.schema)"
            )
        return found

    def _values(self, name: str, dataset: "h5py.Dataset") -> Any:
        try:
            return dataset[()]
        except OSError as error:
            raise self._error(
                f"dataset '{name}' is damaged ({error}); copy the file again from its source"
            ) from error

    def _check_shape(
        self, name: str, have: tuple[int, ...] | None, want: tuple[int | None, ...]
    ) -> None:
        # A dataset without extent has no shape at all.
        sizes = have or ()
        fits = len(sizes) == len(want) and all(
            size in (None, found) for size, found in zip(want, sizes, strict=True)
        )
        if not fits:
            wanted = ", ".join("any" if size is None else str(size) for size in want)
            raise self._error(
                f"dataset '{name}' has shape {have}; ({wanted}) is needed. Is it of another mesh?"
            )

    def _text(self, name: str) -> str:
        value = self._values(name, self._dataset(name))
        if not isinstance(value, bytes):
            raise self._error(f"dataset '{name}' is not text; write the recording again")
        return value.decode("utf-8")

    def _json(self, name: str, text: str) -> dict[str, Any]:
        try:
            value = json.loads(text)
        except json.JSONDecodeError as error:
            raise self._error(
                f"'{name}' is not JSON: {error}; write the recording again"
            ) from error
        if not isinstance(value, dict):
            raise self._error(f"'{name}' is {text[:40]!r}; a JSON object is needed")
        return value

    def _attribute(self, group: str, name: str, kind: type) -> Any:
        if group != "/" and group not in self.file:
            raise self._error(f"lacks group '{group}'; the file is incomplete: write it again")
        attributes = (self.file if group == "/" else self.file[group]).attrs
        if name not in attributes:
            raise self._error(f"lacks attribute '{name}' of '{group}'; write the recording again")
        value = attributes[name]
        if isinstance(value, bytes):
            value = value.decode("utf-8")
        accepted = {int: (np.integer, int), float: (np.floating, float), str: (str,)}[kind]
        if not isinstance(value, accepted):
            raise self._error(
                f"attribute '{name}' of '{group}' is {value!r}; {kind.__name__} is needed"
            )
        return kind(value)

    def _error(self, complaint: str) -> RecordingError:
        return RecordingError(f"recording '{self.source}' {complaint}")
