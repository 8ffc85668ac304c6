"""Recordings on disk: one HDF5 file, written whole or not at all.

Layout, version 1 (n nodes, m elements; arrays row by row, gzip with checksums; text is UTF-8 of
fixed length; the structure is that of HDF5 1.10, with checksums):

| path | type | unit |
|---|---|---|
| / `format` | attribute, "tactorch-recording" | |
| / `version` | attribute, 1 | |
| / `units` | attribute, "mm, N, MPa, tonne/mm^3" | |
| / `density` | attribute, float64; absent where weight plays no part | tonne/mm^3 |
| /mesh/points | float64 (n, 3) | mm |
| /mesh/tets | int64 (m, 4) | |
| /material `name`, `poisson` | attributes | |
| /material `parameters` | attribute, JSON object of numbers | |
| /gravity | float64 (3,) | mm/s^2 |
| /provenance | text, JSON object | |
| /truth, /reference | float64 (m,), each may be absent | MPa |
| /presses `count` | attribute | |
| /presses/0000 `name`, `step` | attributes | |
| /presses/0000 `noise_mm` | attribute, float64; absent where unknown | mm |
| /presses/0000/forces | float64 (n, 3) | N |
| /presses/0000/observed | uint8 (n, 3), 0 or 1 | |
| /presses/0000/displacement | float64 (n, 3), NaN where not observed | mm |
| /presses/0000/springs | float64 (n, 3) | N/mm |
| /presses/0000/fixed | uint8 (n, 3), 0 or 1 | |
| /presses/0000/prescribed | float64 (n, 3) | mm |
| /presses/0000/weights | float64 (n, 3), may be absent | |
| /presses/0000/direction | float64 (3,), may be absent | |

A reader refuses a version above its own. Whoever changes the layout raises `VERSION` and teaches
`load_recording` the older ones.
"""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tactorch.errors import FileError, MeshError, RecordingError
from tactorch.files import atomic_path, require_file
from tactorch.mesh import TetMesh
from tactorch.recording.material import MaterialSpec
from tactorch.recording.press import Press
from tactorch.recording.recording import Recording

if TYPE_CHECKING:
    import h5py

FORMAT = "tactorch-recording"
VERSION = 1
UNITS = "mm, N, MPa, tonne/mm^3"
# From HDF5 1.10 on, the file's own structure carries checksums too, so that damage is noticed.
_LIBVER = ("v110", "v110")
_PRESS_ARRAYS = ("forces", "observed", "displacement", "springs", "fixed", "prescribed")
_PRESS_MASKS = ("observed", "fixed")
_PRESS_OPTIONAL = {"weights": (None, 3), "direction": (3,)}


def save_recording(recording: Recording, path: str | Path) -> None:
    """Write `recording` to `path`; an interrupted call leaves what was there before.

    Raises:
        FileError: The file cannot be written.
    """
    import h5py

    try:
        with atomic_path(path) as temporary, h5py.File(temporary, "w", libver=_LIBVER) as file:
            _write(file, recording)
    # ValueError: text that HDF5 cannot hold, such as a name with a NUL in it.
    except (OSError, ValueError) as error:
        raise FileError(
            f"cannot write recording '{path}': {error}; check the folder, its permissions and "
            "the free space"
        ) from error


def _write(file: "h5py.File", recording: Recording) -> None:
    _mark(file, "format", FORMAT)
    _mark(file, "version", VERSION)
    _mark(file, "units", UNITS)
    if recording.density is not None:
        _mark(file, "density", recording.density)
    mesh = recording.mesh
    _put(file, "mesh/points", mesh.points.astype("<f8"))
    _put(file, "mesh/tets", mesh.tets.astype("<i8"))
    material = file.create_group("material")
    _mark(material, "name", recording.material.name)
    _mark(material, "poisson", recording.material.poisson)
    _mark(material, "parameters", json.dumps(recording.material.parameters))
    _put(file, "gravity", recording.gravity)
    file["provenance"] = _fixed_text(json.dumps(recording.provenance))
    for name in ("truth", "reference"):
        if getattr(recording, name) is not None:
            _put(file, name, getattr(recording, name))
    presses = file.create_group("presses")
    _mark(presses, "count", len(recording.presses))
    for index, press in enumerate(recording.presses):
        _write_press(presses.create_group(f"{index:04d}"), press)


def _write_press(group: "h5py.Group", press: Press) -> None:
    _mark(group, "name", press.name)
    _mark(group, "step", press.step)
    if press.noise_mm is not None:
        _mark(group, "noise_mm", press.noise_mm)
    for field in _PRESS_ARRAYS:
        array = getattr(press, field)
        _put(group, field, array.astype(np.uint8) if field in _PRESS_MASKS else array)
    for field in _PRESS_OPTIONAL:
        if getattr(press, field) is not None:
            _put(group, field, getattr(press, field))


def _mark(group: "h5py.Group", name: str, value: str | int | float) -> None:
    group.attrs[name] = _fixed_text(value) if isinstance(value, str) else value


def _fixed_text(text: str) -> np.ndarray:
    """Return `text` as HDF5 text of fixed length.

    Text of variable length lies in a heap without checksums, and a damaged heap can hang HDF5.
    """
    import h5py

    if "\0" in text:
        raise ValueError(f"text with a NUL in it: {text!r}")
    content = text.encode("utf-8")
    return np.array(content, dtype=h5py.string_dtype("utf-8", max(1, len(content))))


def _put(group: "h5py.Group", name: str, array: np.ndarray) -> None:
    group.create_dataset(
        name, data=array, compression="gzip", compression_opts=4, shuffle=True, fletcher32=True
    )


def load_recording(path: str | Path, *, check_units: bool = True) -> Recording:
    """Read the recording at `path`.

    Raises:
        FileError: The file is missing, truncated or not HDF5.
        RecordingError: A dataset is missing, damaged, of the wrong type or shape, or implausible.
    """
    import h5py

    source = require_file(path, "recording")
    if not h5py.is_hdf5(source):
        raise FileError(
            f"'{source}' is not an HDF5 file, so not a recording; give the file that "
            "Recording.save wrote, or import foreign data first"
        )
    try:
        file = h5py.File(source, "r")
    except OSError as error:
        raise FileError(
            f"recording '{source}' is damaged or cut short ({error}); copy it again from its source"
        ) from error
    with file:
        try:
            return _Reader(file, source).recording(check_units)
        except RecordingError:
            raise
        # What h5py raises on a damaged file has no common base.
        except Exception as error:
            raise FileError(
                f"recording '{source}' is damaged ({error}); copy it again from its source"
            ) from error


class _Reader:
    """Reads one open file; every complaint names the file and the dataset."""

    def __init__(self, file: "h5py.File", source: Path) -> None:
        self.file = file
        self.source = source

    def recording(self, check_units: bool) -> Recording:
        """Read and check everything."""
        self._check_format()
        mesh = self._mesh()
        material = self._material()
        presses = self._presses(mesh.n_points)
        provenance = self._json("provenance", self._text("provenance"))
        moduli = {
            name: self._array(name, "f", (mesh.n_tets,)) if name in self.file else None
            for name in ("truth", "reference")
        }
        density = self._attribute("/", "density", float) if "density" in self.file.attrs else None
        gravity = self._array("gravity", "f", (3,))
        try:
            return Recording(
                mesh,
                presses,
                material,
                **moduli,
                provenance=provenance,
                density=density,
                gravity=gravity,
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

    def _mesh(self) -> TetMesh:
        points = self._array("mesh/points", "f", (None, 3))
        tets = self._array("mesh/tets", "i", (None, 4))
        try:
            return TetMesh.create(points, tets, repair=False)
        except MeshError as error:
            raise self._error(f"dataset 'mesh' is not a sound mesh: {error}") from error

    def _material(self) -> MaterialSpec:
        name = self._attribute("material", "name", str)
        poisson = self._attribute("material", "poisson", float)
        text = self._attribute("material", "parameters", str)
        try:
            return MaterialSpec(name, poisson, self._json("material/parameters", text))
        except RecordingError as error:
            raise self._error(f"'material' is not sound: {error}") from error

    def _presses(self, n_points: int) -> tuple[Press, ...]:
        count = self._attribute("presses", "count", int)
        return tuple(self._press(f"presses/{index:04d}", n_points) for index in range(count))

    def _press(self, path: str, n_points: int) -> Press:
        fields: dict[str, Any] = {}
        for field in _PRESS_ARRAYS:
            kind = "b" if field in _PRESS_MASKS else "f"
            fields[field] = self._array(f"{path}/{field}", kind, (n_points, 3))
        for field, shape in _PRESS_OPTIONAL.items():
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
                "Recording.save (schema: tactorch.recording.storage)"
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
            raise self._error(f"dataset '{name}' has shape {have}; ({wanted}) is needed")

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
        if group not in self.file:
            raise self._error(f"lacks group '{group}'; the file is incomplete: write it again")
        if name not in self.file[group].attrs:
            raise self._error(f"lacks attribute '{name}' of '{group}'; write the recording again")
        value = self.file[group].attrs[name]
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
