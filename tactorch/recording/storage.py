"""Recordings on disk: one HDF5 file (`tactorch.recording.schema`), of unknown origin when read."""

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tactorch.config import to_mapping
from tactorch.errors import ConfigError, MeshError, RecordingError
from tactorch.hdf5 import Hdf5Reader, open_hdf5, write_array, write_attributes, write_json
from tactorch.mesh import TetMesh
from tactorch.recording import schema
from tactorch.recording.material import MaterialSpec
from tactorch.recording.press import Press
from tactorch.recording.readings import ForceReading, PressErrors, ProbePose, SurfaceReading
from tactorch.recording.tail import PressTail

if TYPE_CHECKING:
    import h5py

_READINGS = {"force": ForceReading, "surface": SurfaceReading, "errors": PressErrors}
_WRITER = "Recording.save"
_LAYOUT = f"{_WRITER} (layout: tactorch.recording.schema)"


class RecordingReader(Hdf5Reader):
    """Reads the parts of one recording from a file or group; `mesh` is given if known already.

    `tail` holds the presses that were appended to a file; it is None where its version has none.
    """

    def __init__(self, root: "h5py.Group", source: Path | str, mesh: TetMesh | None = None) -> None:
        super().__init__(root, source, "recording", _LAYOUT, RecordingError)
        self._mesh = mesh
        self._shared: dict[str, np.ndarray] = {}
        self.version = self.check_format(
            schema.FORMAT, schema.VERSION, f"give the file that {_WRITER} wrote"
        )
        units = self.attribute("/", "units", str)
        if units != schema.UNITS:
            raise self.error(
                f"is in units {units!r}; {schema.UNITS!r} is needed: convert the values"
            )
        growing = self.version in schema.GROWING_VERSIONS
        self.tail = PressTail(root.file, source, self._count_stored()) if growing else None

    def fields(self, presses: Sequence[Press] | None = None) -> dict[str, Any]:
        """Read the arguments of `Recording`; `presses` replace those in the file."""
        n, m = self.mesh().n_points, self.mesh().n_tets
        if presses is None:
            presses = [self.press(index) for index in range(self.count())]
        optional = {"truth": (m,), "reference": (m,), "unloaded": (None, n, 3)}
        return {
            "mesh": self.mesh(),
            "presses": tuple(presses),
            "material": self.material(),
            "provenance": self.json("provenance"),
            "density": self.density(),
            "gravity": self.gravity(),
            **{k: self.array(k, "f", shape) for k, shape in optional.items() if self.has(k)},
        }

    def mesh(self) -> TetMesh:
        """Read the mesh, once."""
        if self._mesh is None:
            points = self.array("mesh/points", "f", (None, 3))
            tets = self.array("mesh/tets", "i", (None, 4))
            has_regions = self.has("mesh/regions")
            regions = self.array("mesh/regions", "i", (len(tets),)) if has_regions else None
            try:
                self._mesh = TetMesh.create(points, tets, repair=False, regions=regions)
            except MeshError as error:
                raise self.error(f"dataset 'mesh' is not a valid mesh: {error}") from error
        return self._mesh

    def material(self) -> MaterialSpec:
        """Read the constitutive law."""
        name = self.attribute("material", "name", str)
        poisson = self.attribute("material", "poisson", float)
        text = self.attribute("material", "parameters", str)
        try:
            return MaterialSpec(name, poisson, self.parse_json("material/parameters", text))
        except RecordingError as error:
            raise self.error(f"'material' is not valid: {error}") from error

    def density(self) -> float | None:
        """Read the mass density, tonne/mm^3; None where weight is not modelled."""
        return self.attribute("/", "density", float) if "density" in self.root.attrs else None

    def gravity(self) -> np.ndarray:
        """Read the acceleration of gravity, (3,), mm/s^2."""
        return self.array("gravity", "f", (3,))

    def count(self) -> int:
        """Return the number of presses."""
        return self._count_stored() + len(self.tail or ())

    def _count_stored(self) -> int:
        """Number of presses in HDF5; a file that declares more than it holds is refused."""
        count: int = self.attribute("presses", "count", int)
        groups = len(self.group("presses"))
        if not 0 <= count <= groups:
            raise self.error(
                f"declares {count} presses (attribute 'count' of 'presses') and holds {groups}; "
                "the file is incomplete: write it again"
            )
        return count

    def press(self, index: int) -> Press:
        """Read and check a press by its number from 0."""
        if self.tail is None or index < self.tail.first:
            n_points = self.mesh().n_points
            return _read_press(self, f"presses/{index:04d}", n_points, self._shared)
        import h5py

        image = BytesIO(self.tail.image(index - self.tail.first))
        with h5py.File(image, "r") as file:
            source = f"{self.source}, press {index + 1}"
            reader = Hdf5Reader(file, source, "recording", "append_press", RecordingError)
            return _read_press(reader, "/", self.mesh().n_points, self._shared)


def _shared(known: dict[str, np.ndarray], field: str, array: np.ndarray) -> np.ndarray:
    """Return the array of the press before, where this one has the same values."""
    last = known.get(field)
    if last is not None and np.array_equal(last, array, equal_nan=True):
        return last
    array.setflags(write=False)
    known[field] = array
    return array


def _read_press(
    reader: Hdf5Reader, path: str, n_points: int, shared: dict[str, np.ndarray]
) -> Press:
    """Read and check the press in the group `path`; `shared` has the arrays of the one before."""
    fields: dict[str, Any] = {}
    by_probe = reader.has(f"{path}/probe")
    for field, constant in schema.PRESS_ARRAYS.items():
        kind = "b" if field in schema.PRESS_MASKS else "f"
        if by_probe and not reader.has(f"{path}/{field}"):
            fields[field] = np.broadcast_to(np.array(constant), (n_points, 3))
        else:
            array = reader.array(f"{path}/{field}", kind, (n_points, 3))
            fields[field] = _shared(shared, field, array)
    for field, shape in schema.PRESS_OPTIONAL.items():
        if reader.has(f"{path}/{field}"):
            wanted = tuple(n_points if size is None else size for size in shape)
            fields[field] = reader.array(f"{path}/{field}", "f", wanted)
    fields["name"] = reader.attribute(path, "name", str)
    fields["step"] = reader.attribute(path, "step", int)
    if "noise_mm" in reader.group(path).attrs:
        fields["noise_mm"] = reader.attribute(path, "noise_mm", float)
    try:
        return Press(**fields, **_read_readings(reader, path))
    except RecordingError as error:
        raise reader.error(f"'{path}' is not valid: {error}") from error


def _read_readings(reader: Hdf5Reader, path: str) -> dict[str, Any]:
    """Read the probe of the press in the group `path`, and its readings."""
    fields: dict[str, Any] = {}
    for name, kind in _READINGS.items():
        if reader.has(f"{path}/{name}"):
            shapes = schema.PRESS_READINGS[name].items()
            fields[name] = kind(
                **{
                    key: reader.array(f"{path}/{name}/{key}", "i" if key == "nodes" else "f", shape)
                    for key, shape in shapes
                }
            )
    group = f"{path}/probe"
    if reader.has(group):
        fields["probe"] = ProbePose(
            _read_probe(reader, group),
            reader.array(f"{group}/position_mm", "f", (3,)),
            reader.array(f"{group}/rotation", "f", (3, 3)),
            reader.attribute(group, "deviation_mm", float)
            if "deviation_mm" in reader.group(group).attrs
            else 0.0,
        )
    return fields


def _read_probe(reader: Hdf5Reader, group: str) -> Any:
    from tactorch.fem.contact import PROBES

    name, text = (reader.attribute(group, key, str) for key in ("name", "sizes"))
    sizes = reader.parse_json(f"{group}/sizes", text)
    try:
        return PROBES[name].from_mapping(sizes)
    except ConfigError as error:
        raise reader.error(f"'{group}' is not a probe: {error}") from error


@contextmanager
def open_recording(path: str | Path) -> Iterator[RecordingReader]:
    """Open a recording for reading."""
    remedy = "give the file that Recording.save wrote, or import foreign data first"
    with open_hdf5(path, "recording", remedy) as file:
        yield RecordingReader(file, path)


def write_recording(group: "h5py.Group", fields: Mapping[str, Any]) -> None:
    """Write the fields of a `Recording` into a file or group."""
    errors = any(press.errors is not None for press in fields["presses"])
    regions = fields["mesh"].regions
    version = schema.written_version(regions=regions is not None, errors=errors)
    write_attributes(group, format=schema.FORMAT, version=version, units=schema.UNITS)
    if fields["density"] is not None:
        write_attributes(group, density=fields["density"])
    write_array(group, "mesh/points", fields["mesh"].points.astype("<f8"))
    write_array(group, "mesh/tets", fields["mesh"].tets.astype("<i8"))
    if regions is not None:
        write_array(group, "mesh/regions", regions.astype("<i8"))
    material = group.create_group("material")
    law: MaterialSpec = fields["material"]
    parameters = json.dumps(law.parameters)
    write_attributes(material, name=law.name, poisson=law.poisson, parameters=parameters)
    write_array(group, "gravity", fields["gravity"])
    write_json(group, "provenance", fields["provenance"])
    for name in ("truth", "reference", "unloaded"):
        if fields[name] is not None:
            write_array(group, name, fields[name])
    presses = group.create_group("presses")
    write_attributes(presses, count=len(fields["presses"]))
    for index, press in enumerate(fields["presses"]):
        write_press(presses.create_group(f"{index:04d}"), press)


def write_press(group: "h5py.Group", press: Press) -> None:
    """Write a press into an empty group or file."""
    write_attributes(group, name=press.name, step=press.step)
    if press.noise_mm is not None:
        write_attributes(group, noise_mm=press.noise_mm)
    for field, constant in schema.PRESS_ARRAYS.items():
        array = getattr(press, field)
        everywhere = np.broadcast_to(np.array(constant), array.shape)
        if press.probe is not None and np.array_equal(array, everywhere, equal_nan=True):
            continue
        write_array(group, field, array.astype(np.uint8) if field in schema.PRESS_MASKS else array)
    for field in schema.PRESS_OPTIONAL:
        if getattr(press, field) is not None:
            write_array(group, field, getattr(press, field))
    for name in _READINGS:
        if (reading := getattr(press, name)) is not None:
            for field in schema.PRESS_READINGS[name]:
                write_array(group, f"{name}/{field}", getattr(reading, field))
    if press.probe is not None:
        _write_probe(group.create_group("probe"), press.probe)


def _write_probe(group: "h5py.Group", pose: ProbePose) -> None:
    from tactorch.fem.contact import PROBES

    name = PROBES.name_of(type(pose.probe))
    write_attributes(group, name=name, sizes=json.dumps(to_mapping(pose.probe)))
    if pose.deviation_mm:
        write_attributes(group, deviation_mm=float(pose.deviation_mm))
    write_array(group, "position_mm", pose.position_mm)
    write_array(group, "rotation", pose.rotation)
