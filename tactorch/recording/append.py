"""Recordings that grow: a press is appended as a whole, and read while more are to come.

The file of a growing recording is an ordinary recording at every moment. A press is added to a
copy beside it, which then takes its place in one step: a reader sees the file with the press or
without it, never half of it, and a writer that is killed leaves what was there. One process writes
at a time. Appending copies the file, so it takes longer the longer the recording is; a session of
thousands of presses is better kept as one file a press, in a folder.
"""

import shutil
from collections.abc import Mapping
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path

import numpy as np

from tactorch.errors import FileError, RecordingError
from tactorch.files import atomic_path
from tactorch.recording.press import Press
from tactorch.recording.reader import Reader
from tactorch.recording.recording import Recording
from tactorch.recording.schema import PRESS_ARRAYS, PRESS_OPTIONAL
from tactorch.recording.storage import LIBVER, mark, open_recording, reading, write_press


@dataclass(frozen=True, eq=False)
class Contents:
    """What a recording holds now, press by press.

    Attributes:
        about: The object, with the sound presses; None where no press is sound.
        presses: The sound presses, by number from 0.
        faults: What is wrong with each of the others, by number.
        count: How many presses there are, sound or not, known or not.
    """

    about: Recording | None
    presses: Mapping[int, Press]
    faults: Mapping[int, str]
    count: int


class OtherObjectError(RecordingError):
    """A recording is of another object than before."""


def append_press(path: str | Path, press: Press) -> int:
    """Add a press to the recording at `path`, wholly or not at all; returns its number from 0.

    The first press is saved as a recording of its own: `Recording(mesh, (press,), material)`.

    Raises:
        FileError: The file is missing, damaged, or cannot be replaced.
        RecordingError: It is no recording, or the press does not fit its object.
    """
    with open_recording(path) as (file, source), reading(source):
        reader = Reader(file, source)
        count, mesh = reader.count(), reader.mesh()
        press.validate(mesh.n_points)
        reader.recording(check_units=False, presses=(press,))  # is it loaded, and held?
    import h5py

    with atomic_path(path) as temporary:
        shutil.copyfile(source, temporary)
        with h5py.File(temporary, "r+", libver=LIBVER) as file:
            write_press(file["presses"].create_group(f"{count:04d}"), press)
            mark(file["presses"], "count", count + 1)
    return count


def read_presses(
    path: str | Path, *, after: int = 0, check_units: bool = True, known: Recording | None = None
) -> Contents:
    """Read what a growing recording holds, a broken press being no reason to refuse the others.

    Args:
        path: The HDF5 file.
        after: How many presses are known and need not be read.
        check_units: As of `Recording`. Magnitudes of a press are judged together with `known`'s,
            for a light touch is no wrong unit after a firm one.
        known: What was read before, of the same object, to check new presses beside.

    Raises:
        FileError: The file is missing, cut short or not HDF5: it may still be being written.
        RecordingError: The file is no recording, or its object is not sound.
        OtherObjectError: Its object is not the known one.
    """
    with open_recording(path) as (file, source), reading(source):
        reader = Reader(file, source)
        count, mesh = reader.count(), reader.mesh()
        if known is not None:
            _check_same(reader, known)
        about, presses, faults = known, {}, {}
        for index in range(after, count):
            try:
                press = reader.press(index, mesh.n_points)
                about = _joined(reader, about, press, check_units)
            except (RecordingError, FileError) as error:
                faults[index] = _short(error, source)
            else:
                presses[index] = press
    return Contents(about, presses, faults, count)


def digest(press: Press) -> str:
    """Return what tells a press from others: the hash of its values."""
    found = sha256(repr((press.noise_mm, press.step)).encode())
    for name in (*PRESS_ARRAYS, *PRESS_OPTIONAL):
        array = getattr(press, name)
        found.update(b"-" if array is None else np.ascontiguousarray(array).tobytes())
    return found.hexdigest()[:16]


def _check_same(reader: Reader, known: Recording) -> None:
    mesh, material = reader.mesh(), reader.material()
    if mesh.content_hash() != known.mesh.content_hash():
        raise OtherObjectError(
            f"recording '{reader.source}' is of another object than the presses before: its mesh "
            f"has {mesh.n_points} nodes and {mesh.n_tets} elements, theirs {known.mesh.n_points} "
            f"and {known.mesh.n_tets}, or others. Start another run for it."
        )
    if material != known.material:
        raise OtherObjectError(
            f"recording '{reader.source}' has another material than the presses before: "
            f"{material}, not {known.material}. Start another run for it."
        )
    weights = {"density": (reader.density(), known.density)}
    weights |= {"gravity": (reader.gravity().tolist(), known.gravity.tolist())}
    for name, (value, before) in weights.items():
        if value != before:
            raise OtherObjectError(
                f"recording '{reader.source}' has {name}={value}, the presses before {before}: "
                "weight is the same for all presses of a run. Start another run for it."
            )


def _joined(reader: Reader, about: Recording | None, press: Press, check_units: bool) -> Recording:
    """The object with the presses so far and this one, checked."""
    if about is None:
        return reader.recording(check_units, (press,))
    return replace(about, presses=(*about.presses, press), check_units=check_units)


def _short(error: Exception, source: Path) -> str:
    """A complaint without the file's name, which the reader of it knows."""
    text = str(error).removeprefix(f"recording '{source}' ")
    return text.removeprefix("does not hold together: ")
