"""Recordings on disk: one HDF5 file (`tactorch.recording.schema`)."""

import json
import logging
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tactorch.errors import FileError
from tactorch.hdf5 import open_hdf5, write_array, write_attribute, write_hdf5, write_json
from tactorch.recording.press import Press
from tactorch.recording.reader import RecordingReader
from tactorch.recording.schema import (
    FORMAT,
    GROWING,
    PRESS_ARRAYS,
    PRESS_MASKS,
    PRESS_OPTIONAL,
    SAVED,
    UNITS,
)
from tactorch.recording.tail import PressTail

if TYPE_CHECKING:
    import h5py

_log = logging.getLogger(__name__)


class FileReader(RecordingReader):
    """Reads the recording of a file, with the presses that were appended to it.

    `tail` holds the appended presses; it is None where the file's version has none.
    """

    def __init__(self, file: "h5py.File", source: Path) -> None:
        super().__init__(file, source)
        self._stored = super().count()
        growing = self.attribute("/", "version", int) >= GROWING
        self.tail = PressTail(file, source, self._stored) if growing else None

    def count(self) -> int:
        """Return the number of presses."""
        return self._stored + len(self.tail or ())

    def press(self, index: int) -> Press:
        """Read and check a press by its number from 0."""
        if self.tail is None or index < self._stored:
            return super().press(index)
        return self.tail.press(index - self._stored, self.mesh().n_points)


@contextmanager
def open_recording(path: str | Path) -> Iterator[FileReader]:
    """Open a recording for reading."""
    remedy = "give the file that Recording.save wrote, or import foreign data first"
    with open_hdf5(path, "recording", remedy) as file:
        yield FileReader(file, Path(path))


def load_fields(path: str | Path) -> tuple[FileReader, dict[str, Any]]:
    """Read the arguments of `Recording` from a file; returned with the reader, for its errors."""
    with open_recording(path) as reader:
        if reader.tail is not None and not reader.tail.complete:
            _log.warning(
                "'%s' ends in an incomplete press, which is ignored: its writer was interrupted, or"
                " the file was cut short.", path,
            )  # fmt: skip
        return reader, reader.fields()


def save_fields(path: str | Path, fields: Mapping[str, Any]) -> None:
    """Write the fields of a `Recording` to a file, whole or not at all."""
    try:
        write_hdf5(path, lambda file: write_recording(file, fields))
    except ValueError as error:
        raise FileError(
            f"cannot write recording '{path}': {error}; leave out text that HDF5 cannot hold, such "
            "as a name with a NUL in it"
        ) from error


def write_recording(group: "h5py.Group", fields: Mapping[str, Any]) -> None:
    """Write the fields of a `Recording` into a file or group."""
    write_attribute(group, "format", FORMAT)
    write_attribute(group, "version", SAVED)
    write_attribute(group, "units", UNITS)
    if fields["density"] is not None:
        write_attribute(group, "density", fields["density"])
    write_array(group, "mesh/points", fields["mesh"].points.astype("<f8"))
    write_array(group, "mesh/tets", fields["mesh"].tets.astype("<i8"))
    material = group.create_group("material")
    write_attribute(material, "name", fields["material"].name)
    write_attribute(material, "poisson", fields["material"].poisson)
    write_attribute(material, "parameters", json.dumps(fields["material"].parameters))
    write_array(group, "gravity", fields["gravity"])
    write_json(group, "provenance", fields["provenance"])
    for name in ("truth", "reference", "unloaded"):
        if fields[name] is not None:
            write_array(group, name, fields[name])
    presses = group.create_group("presses")
    write_attribute(presses, "count", len(fields["presses"]))
    for index, press in enumerate(fields["presses"]):
        write_press(presses.create_group(f"{index:04d}"), press)


def write_press(group: "h5py.Group", press: Press) -> None:
    """Write a press into an empty group or file."""
    write_attribute(group, "name", press.name)
    write_attribute(group, "step", press.step)
    if press.noise_mm is not None:
        write_attribute(group, "noise_mm", press.noise_mm)
    for field in PRESS_ARRAYS:
        array = getattr(press, field)
        write_array(group, field, array.astype(np.uint8) if field in PRESS_MASKS else array)
    for field in PRESS_OPTIONAL:
        if getattr(press, field) is not None:
            write_array(group, field, getattr(press, field))
