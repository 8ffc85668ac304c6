"""Recordings on disk: one HDF5 file (`tactorch.recording.schema`), of unknown origin when read."""

import json
import math
from bisect import bisect_right
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cached_property
from io import BytesIO
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tactorch.config import to_mapping
from tactorch.errors import ConfigError, MeshError, RecordingError
from tactorch.hdf5 import Hdf5Reader, open_hdf5, write_array, write_attributes, write_json
from tactorch.mesh import TetMesh
from tactorch.mesh.geometry import frozen
from tactorch.recording import schema
from tactorch.recording.material import MaterialSpec
from tactorch.recording.press import Press, constant_field
from tactorch.recording.readings import (
    ForceReading,
    GelReading,
    PressErrors,
    ProbePose,
    SurfaceReading,
)
from tactorch.recording.tail import PressTail

if TYPE_CHECKING:
    import h5py

_READINGS = {
    "force": ForceReading, "surface": SurfaceReading, "errors": PressErrors, "gel": GelReading,
}  # fmt: skip
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
        self._stacks: dict[int, Callable[[int], Press]] = {}
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
        self.group("presses")
        held = self._firsts[-1]
        if not 0 <= count <= held:
            raise self.error(
                f"declares {count} presses (attribute 'count' of 'presses') and holds {held}; "
                "the file is incomplete: write it again"
            )
        return count

    @cached_property
    def _firsts(self) -> list[int]:
        """Number of the first press of each group, and their number in all."""
        firsts = [0]
        while self.has(path := _path(firsts[-1])):
            stacked = self._is_stacked(path)
            size = len(self.array(f"{path}/step", "i", (None,))) if stacked else 1
            if size == 0:
                raise self.error(f"dataset '{path}/step' is empty; write the recording again")
            firsts.append(firsts[-1] + size)
        return firsts

    def _is_stacked(self, path: str) -> bool:
        return self.version >= schema.STACKED_VERSION and self.has(f"{path}/step")

    def directions(self) -> list[np.ndarray] | None:
        """Read the directions of the presses that HDF5 holds, (3,); None where one has none."""
        found: list[np.ndarray] = []
        for first in self._firsts[:-1]:
            path, lead = _path(first), (None,) * self._is_stacked(_path(first))
            if not self.has(f"{path}/direction"):
                return None
            found.extend(self.array(f"{path}/direction", "f", (*lead, 3)).reshape(-1, 3))
        return found

    def press(self, index: int) -> Press:
        """Read and check a press by its number from 0."""
        n_points = self.mesh().n_points
        if self.tail is None or index < self.tail.first:
            first = self._firsts[bisect_right(self._firsts, index) - 1]
            if first not in self._stacks:
                path = _path(first)
                if not self._is_stacked(path):
                    return _read_press(self, path, n_points, self._shared)
                self._stacks[first] = _read_stack(self, path, n_points)
            return self._stacks[first](index - first)
        import h5py

        image = BytesIO(self.tail.image(index - self.tail.first))
        with h5py.File(image, "r") as file:
            source = f"{self.source}, press {index + 1}"
            reader = Hdf5Reader(file, source, "recording", "append_press", RecordingError)
            return _read_press(reader, "/", n_points, self._shared)


def _path(first: int) -> str:
    """Return the group of presses, by the number of the first one."""
    return f"presses/{first:04d}"


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
    values = _read_arrays(reader, path)
    values |= {key: reader.attribute(path, key, t) for key, t in (("name", str), ("step", int))}
    for group, key in ((path, "noise_mm"), (f"{path}/probe", "deviation_mm")):
        if reader.has(group) and key in reader.group(group).attrs:
            name = key if group == path else f"probe/{key}"
            values[name] = reader.attribute(group, key, float)
    return _make_press(reader, path, _read_nodal(reader, path, n_points, shared), values)


def _read_stack(reader: Hdf5Reader, path: str, n_points: int) -> Callable[[int], Press]:
    """Read presses by one probe, with the same nodal fields, that share a group.

    The function that is returned checks one of them, by its number in the group.
    """
    steps = reader.array(f"{path}/step", "i", (None,)).tolist()
    lead = (len(steps),)
    names = reader.json(f"{path}/names", list)
    if len(names) != len(steps) or not all(isinstance(name, str) for name in names):
        raise reader.error(f"dataset '{path}/names' is not a list of {len(steps)} texts")
    noise = reader.array(f"{path}/noise_mm", "f", lead).tolist()
    deviations = reader.array(f"{path}/probe/deviation_mm", "f", lead).tolist()
    noise = [None if math.isnan(value) else value for value in noise]
    known = {"name": names, "step": steps, "noise_mm": noise, "probe/deviation_mm": deviations}
    values = {**_read_arrays(reader, path, lead), **known}
    nodal = _read_nodal(reader, path, n_points, {})
    return lambda index: _make_press(reader, path, nodal, {k: v[index] for k, v in values.items()})


def _read_nodal(
    reader: Hdf5Reader, path: str, n_points: int, shared: dict[str, np.ndarray]
) -> dict[str, Any]:
    """Read the nodal fields of a group, and its probe."""
    fields: dict[str, Any] = {}
    if reader.has(f"{path}/probe"):
        fields["probe"] = _read_probe(reader, f"{path}/probe")
    for field in schema.PRESS_ARRAYS:
        kind = "b" if field in schema.PRESS_MASKS else "f"
        if fields.get("probe") and not reader.has(f"{path}/{field}"):
            fields[field] = constant_field(field, n_points)
        else:
            array = reader.array(f"{path}/{field}", kind, (n_points, 3))
            fields[field] = _shared(shared, field, array)
    if reader.has(f"{path}/weights"):
        fields["weights"] = reader.array(f"{path}/weights", "f", (n_points, 3))
    return fields


def _read_arrays(reader: Hdf5Reader, path: str, lead: tuple[int, ...] = ()) -> dict[str, Any]:
    """Read the other arrays of a group by name, with first axes of the lengths `lead`."""
    found = {}
    for name, shape in schema.PRESS_VALUES.items():
        first, _, key = name.rpartition("/")
        least = name if name in schema.OPTIONAL_VALUES else first or key
        if reader.has(f"{path}/{least}"):
            kind = "i" if key == "nodes" else "f"
            found[name] = frozen(reader.array(f"{path}/{name}", kind, (*lead, *shape)))
    return found


def _make_press(
    reader: Hdf5Reader, path: str, nodal: Mapping[str, Any], values: Mapping[str, Any]
) -> Press:
    """Return the press of nodal fields and probe, and of its other values by name."""
    parts: dict[str, dict[str, Any]] = {}
    for name, value in values.items():
        first, _, key = name.rpartition("/")
        parts.setdefault(first, {})[key] = value
    fields = {**nodal, **parts.pop("")}
    try:
        if "probe" in nodal:
            fields["probe"] = ProbePose(nodal["probe"], **parts.pop("probe"))
        for name, part in parts.items():
            fields[name] = _READINGS[name](**part)
        return Press(**fields)
    except RecordingError as error:
        raise reader.error(f"'{path}' is not valid: {error}") from error


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
    regions, groups = fields["mesh"].regions, _groups(fields["presses"])
    least = max(map(least_version, fields["presses"]), default=0)
    if len(groups) < len(fields["presses"]):
        least = max(least, schema.STACKED_VERSION)
    version = schema.written_version(regions=regions is not None, least=least)
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
    first = 0
    for same in groups:
        write = write_press if len(same) == 1 else _write_stack
        write(presses.create_group(f"{first:04d}"), *same)
        first += len(same)


def _groups(presses: Sequence[Press]) -> list[list[Press]]:
    """Return the presses of each group."""

    def layout(numbered: tuple[int, Press]) -> Any:
        index, press = numbered
        if press.probe is None:
            return index
        arrays = [(name, array.shape) for name, array in _arrays(press).items()]
        return repr(press.probe.probe), arrays, [a.tobytes() for a in _nodal(press).values()]

    return [[press for _, press in same] for _, same in groupby(enumerate(presses), layout)]


def least_version(press: Press) -> int:
    """Return the lowest version of a file whose readers know the content of a press."""
    if press.gel is not None:
        return schema.GRASP_VERSION if press.gel.is_grasp else schema.GEL_VERSION
    return 0 if press.errors is None else schema.ERRORS_VERSION


def write_press(group: "h5py.Group", press: Press) -> None:
    """Write a press into an empty group or file."""
    write_attributes(group, name=press.name, step=press.step)
    if press.noise_mm is not None:
        write_attributes(group, noise_mm=press.noise_mm)
    for name, array in {**_nodal(press), **_arrays(press)}.items():
        write_array(group, name, array)
    if press.probe is not None:
        _write_probe(group["probe"], press.probe)
        if press.probe.deviation_mm:
            write_attributes(group["probe"], deviation_mm=float(press.probe.deviation_mm))


def _write_stack(group: "h5py.Group", *presses: Press) -> None:
    """Write presses by one probe, with the same nodal fields, into an empty group."""
    poses = [press.probe for press in presses if press.probe is not None]
    write_json(group, "names", [press.name for press in presses])
    write_array(group, "step", np.array([press.step for press in presses]))
    noise = [np.nan if press.noise_mm is None else press.noise_mm for press in presses]
    write_array(group, "noise_mm", np.array(noise))
    for name, array in _nodal(presses[0]).items():
        write_array(group, name, array)
    each = [_arrays(press) for press in presses]
    for name in each[0]:
        write_array(group, name, np.stack([arrays[name] for arrays in each]))
    deviations = np.array([pose.deviation_mm for pose in poses])
    write_array(group, "probe/deviation_mm", deviations)
    _write_probe(group["probe"], poses[0])


def _nodal(press: Press) -> dict[str, np.ndarray]:
    """Return the nodal fields that are stored."""
    stored = {}
    for name in schema.PRESS_ARRAYS:
        array = getattr(press, name)
        everywhere = constant_field(name, len(array))
        constant = array is everywhere or np.array_equal(array, everywhere, equal_nan=True)
        if press.probe is None or not constant:
            stored[name] = array.view(np.uint8) if name in schema.PRESS_MASKS else array
    return stored if press.weights is None else {**stored, "weights": press.weights}


def _arrays(press: Press) -> dict[str, np.ndarray]:
    """Return the other arrays of a press that are stored, by name."""
    owners = {"": press, "probe": press.probe}
    owners |= {name: getattr(press, name) for name in _READINGS}
    found = {}
    for name in schema.PRESS_VALUES:
        first, _, key = name.rpartition("/")
        array = getattr(owners[first], key, None)
        if array is None or (name in schema.OPTIONAL_VALUES and not np.isfinite(array).any()):
            continue
        found[name] = array
    return found


def _write_probe(group: "h5py.Group", pose: ProbePose) -> None:
    from tactorch.fem.contact import PROBES

    name = PROBES.name_of(type(pose.probe))
    write_attributes(group, name=name, sizes=json.dumps(to_mapping(pose.probe)))
