"""Recordings that grow: presses are appended one by one, and read while more are to come.

A press is appended to the end of the file in one write, with a checksum. A reader sees it whole or
not at all, and a writer that is killed leaves the presses before it. When the appended part is
larger than the rest, the file is written again as a whole, so that n presses take time and space
proportional to n. One process may write at a time.
"""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tactorch.errors import FileError, RecordingError
from tactorch.files import write_file
from tactorch.hdf5 import hdf5_image, write_attributes
from tactorch.recording.press import Press
from tactorch.recording.recording import Recording
from tactorch.recording.schema import (
    ERRORS_VERSION,
    PRESS_ARRAYS,
    written_version,
)
from tactorch.recording.storage import (
    RecordingReader,
    least_version,
    open_recording,
    write_press,
)
from tactorch.recording.tail import tail_record

if TYPE_CHECKING:
    import h5py

_MAX_SMALL_TAIL_BYTES = 1 << 20  # a smaller tail is never merged into the HDF5 part


@dataclass(frozen=True, eq=False)
class RecordingContents:
    """Content of a recording that may still grow."""

    recording: Recording | None  # the object with its valid presses; None where no press is valid
    presses: Mapping[int, Press]  # the valid presses that were read, by number from 0
    faults: Mapping[int, str]  # message for each invalid press, by number
    count: int  # presses in the file, valid or not


class OtherObjectError(RecordingError):
    """A recording is of another object than before."""


def append_press(path: str | Path, press: Press) -> int:
    """Append a press to a recording, wholly or not at all.

    The first press is saved with the recording: `Recording(mesh, (press,), material).save(path)`.

    Returns:
        Number of the press, from 0.

    Raises:
        FileError: The file is missing, damaged, or cannot be written.
        RecordingError: The file is no recording, or the press does not fit its object.
    """
    with open_recording(path) as reader:
        count, tail = reader.count(), reader.tail
        Recording(**reader.fields(presses=(press,)), check_units=False)
        image = hdf5_image(lambda file: write_press(file, press))
        record, least = tail_record(count, image), least_version(press)
        if (
            tail is None
            or least > reader.version
            or tail.end - tail.begin + len(record) > max(tail.begin, _MAX_SMALL_TAIL_BYTES)
        ):
            write_file(path, _whole_image(reader, [image], least=least, growing=True))
            return count
    _write_at(Path(path), tail.end, record)
    return count


def compact(path: str | Path) -> None:
    """Write a recording that has grown as a plain HDF5 file; no press is to follow.

    Other programs then see all its presses.
    """
    with open_recording(path) as reader:
        if reader.tail is None:
            return
        image = _whole_image(reader)
    write_file(path, image)


def read_presses(
    path: str | Path, *, after: int = 0, check_units: bool = True, known: Recording | None = None
) -> RecordingContents:
    """Read the presses of a recording that may still grow; invalid presses are left out.

    Args:
        path: The HDF5 file.
        after: Number of presses that are known and not read.
        check_units: See `Recording`. Magnitudes are checked together with those of `known`: a light
            press after a firm one is no wrong unit.
        known: What was read before, of the same object.

    Returns:
        The presses, and a message for each invalid one.

    Raises:
        FileError: The file is missing, truncated or not HDF5: it may still be being written.
        RecordingError: The file is no recording, or its object is not valid.
        OtherObjectError: Its object is not the known one.
    """
    with open_recording(path) as reader:
        count = reader.count()
        if known is not None:
            _check_same(reader, known)
        presses, faults = {}, {}
        for index in range(after, count):
            try:
                presses[index] = reader.press(index)
            except (RecordingError, FileError) as error:
                faults[index] = _reason(reader, error)
        recording, invalid = _with_presses(reader, known, presses, check_units)
    faults |= {index: _reason(reader, error) for index, error in invalid.items()}
    presses = {index: press for index, press in presses.items() if index not in invalid}
    return RecordingContents(recording, presses, faults, count)


def _reason(reader: RecordingReader, error: Exception) -> str:
    return str(error).removeprefix(f"recording '{reader.source}' ")


def _with_presses(
    reader: RecordingReader,
    known: Recording | None,
    presses: Mapping[int, Press],
    check_units: bool,
) -> tuple[Recording | None, dict[int, RecordingError]]:
    """Return the recording with further presses, and why some do not fit the others."""

    def add(recording: Recording | None, added: Sequence[Press]) -> Recording:
        if recording is None:
            return Recording(**reader.fields(added), check_units=check_units)
        return replace(recording, presses=(*recording.presses, *added), check_units=check_units)

    if not presses:
        return known, {}
    try:
        return add(known, list(presses.values())), {}
    except RecordingError:  # of one of them: find it
        recording, invalid = known, {}
    for index, press in presses.items():
        try:
            recording = add(recording, [press])
        except RecordingError as error:
            invalid[index] = error
    return recording, invalid


def digest(press: Press) -> str:
    """Return a hash of all values of a press but its name."""
    result = sha256(repr((press.noise_mm, press.step)).encode())
    for name in (*PRESS_ARRAYS, "weights", "direction"):
        array = getattr(press, name)
        result.update(b"-" if array is None else np.ascontiguousarray(array).tobytes())
    result.update(press.readings_bytes())
    return result.hexdigest()[:16]


def _whole_image(
    reader: RecordingReader,
    added: Sequence[bytes] = (),
    *,
    least: int = 0,
    growing: bool = False,
) -> bytes:
    """Return the content of a file with the presses of the tail, and of other images, in HDF5."""
    import h5py

    tail = reader.tail
    stored = Path(reader.source).read_bytes() if tail is None else tail.hdf5_part()
    images = [*(tail.image(index) for index in range(len(tail))), *added] if tail else added
    count = reader.count() + len(added)
    # Without checksums in the file's structure its end is not known, and there is no tail.
    version = written_version(
        regions=reader.has("mesh/regions"),
        # Versions differ by one where presses are appended.
        least=max(least, reader.version // 2 * 2 if reader.version >= ERRORS_VERSION else 0),
        growing=growing and stored[8] in (2, 3),
    )

    def change(file: "h5py.File") -> None:
        for index, image in enumerate(images, start=count - len(images)):
            with h5py.File(BytesIO(image), "r") as part:
                part.copy("/", file["presses"], name=f"{index:04d}")
        write_attributes(file["presses"], count=count)
        write_attributes(file, version=version)

    return hdf5_image(change, stored)


def _write_at(path: Path, end: int, record: bytes) -> None:
    """Write a record at the end of the whole ones; an incomplete record there is overwritten."""
    try:
        with open(path, "r+b", buffering=0) as file:
            file.truncate(end)
            file.seek(end)
            try:
                remaining = memoryview(record)
                while remaining:
                    remaining = remaining[file.write(remaining) :]
                os.fsync(file.fileno())
            except OSError:
                file.truncate(end)
                raise
    except OSError as error:
        raise FileError(
            f"cannot write '{path}': {error}; check its permissions and the free space. Earlier "
            "presses are kept."
        ) from error


def _check_same(reader: RecordingReader, known: Recording) -> None:
    mesh, material = reader.mesh(), reader.material()
    if mesh.content_hash() != known.mesh.content_hash():
        raise OtherObjectError(
            f"recording '{reader.source}' is of another object than the presses before: its mesh "
            f"has {mesh.n_points} nodes and {mesh.n_tets} elements, theirs {known.mesh.n_points} "
            f"and {known.mesh.n_tets}, or others. Start another run for it."
        )
    density = reader.density(), known.density
    gravity = reader.gravity().tolist(), known.gravity.tolist()
    pairs = {"material": (material, known.material), "density": density, "gravity": gravity}
    for name, (value, before) in pairs.items():
        if value != before:
            raise OtherObjectError(
                f"recording '{reader.source}' has {name}={value}, the presses before {before}: it"
                " is the same for all presses of a run. Start another run for it."
            )
