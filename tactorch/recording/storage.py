"""Recordings on disk: one HDF5 file (`tactorch.recording.schema`), written whole or not at all."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tactorch.errors import FileError, RecordingError
from tactorch.files import atomic_path, require_file
from tactorch.recording.press import Press
from tactorch.recording.reader import Reader
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

# From HDF5 1.10 on, the file's own structure carries checksums too, so that damage is noticed.
LIBVER = ("v110", "v110")


def save_recording(recording: Recording, path: str | Path) -> None:
    """Write `recording` to `path`; an interrupted call leaves what was there before.

    Raises:
        FileError: The file cannot be written.
    """
    import h5py

    try:
        with atomic_path(path) as temporary, h5py.File(temporary, "w", libver=LIBVER) as file:
            write_recording(file, recording)
    except ValueError as error:
        raise FileError(
            f"cannot write recording '{path}': {error}; leave out text that HDF5 cannot hold, such "
            "as a name with a NUL in it"
        ) from error


def write_recording(file: "h5py.Group", recording: Recording) -> None:
    """Write a recording into a file or a group of one."""
    mark(file, "format", FORMAT)
    mark(file, "version", VERSION)
    mark(file, "units", UNITS)
    if recording.density is not None:
        mark(file, "density", recording.density)
    mesh = recording.mesh
    put(file, "mesh/points", mesh.points.astype("<f8"))
    put(file, "mesh/tets", mesh.tets.astype("<i8"))
    material = file.create_group("material")
    mark(material, "name", recording.material.name)
    mark(material, "poisson", recording.material.poisson)
    mark(material, "parameters", json.dumps(recording.material.parameters))
    put(file, "gravity", recording.gravity)
    file["provenance"] = fixed_text(json.dumps(recording.provenance))
    for name in ("truth", "reference", "unloaded"):
        if getattr(recording, name) is not None:
            put(file, name, getattr(recording, name))
    presses = file.create_group("presses")
    mark(presses, "count", len(recording.presses))
    for index, press in enumerate(recording.presses):
        write_press(presses.create_group(f"{index:04d}"), press)


def write_press(group: "h5py.Group", press: Press) -> None:
    """Write a press into a group of its own."""
    mark(group, "name", press.name)
    mark(group, "step", press.step)
    if press.noise_mm is not None:
        mark(group, "noise_mm", press.noise_mm)
    for field in PRESS_ARRAYS:
        array = getattr(press, field)
        put(group, field, array.astype(np.uint8) if field in PRESS_MASKS else array)
    for field in PRESS_OPTIONAL:
        if getattr(press, field) is not None:
            put(group, field, getattr(press, field))


def mark(group: "h5py.Group", name: str, value: str | int | float) -> None:
    """Set an attribute, text in fixed length."""
    group.attrs[name] = fixed_text(value) if isinstance(value, str) else value


def fixed_text(text: str) -> np.ndarray:
    """Return `text` as HDF5 text of fixed length.

    Text of variable length lies in a heap without checksums, and a damaged heap can hang HDF5.
    """
    import h5py

    if "\0" in text:
        raise ValueError(f"text with a NUL in it: {text!r}")
    content = text.encode("utf-8")
    return np.array(content, dtype=h5py.string_dtype("utf-8", max(1, len(content))))


def put(group: "h5py.Group", name: str, array: np.ndarray) -> None:
    """Write an array, compressed and with a checksum."""
    # gzip carries a checksum, which reading verifies.
    group.create_dataset(name, data=array, compression="gzip", compression_opts=4, shuffle=True)


def load_recording(path: str | Path, *, check_units: bool = True) -> Recording:
    """Read the recording at `path`.

    Raises:
        FileError: The file is missing, truncated or not HDF5.
        RecordingError: A dataset is missing, damaged, of the wrong type or shape, or implausible.
    """
    with open_recording(path) as (file, source), reading(source):
        return Reader(file, source).recording(check_units)


@contextmanager
def open_recording(path: str | Path) -> Iterator[tuple["h5py.File", Path]]:
    """Open the file of a recording to read.

    Raises:
        FileError: The file is missing, truncated or not HDF5.
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
        yield file, source


@contextmanager
def reading(source: Path) -> Iterator[None]:
    """Turn what a damaged file leads to into a `FileError`."""
    try:
        yield
    except (RecordingError, FileError):
        raise
    # What h5py raises on a damaged file has no common base.
    except Exception as error:
        raise FileError(
            f"recording '{source}' is damaged ({error}); copy it again from its source"
        ) from error
