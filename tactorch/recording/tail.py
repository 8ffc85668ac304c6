"""Presses after the end of a recording's HDF5 part (see `tactorch.recording.schema`)."""

import os
import struct
import zlib
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING

from tactorch.errors import RecordingError

if TYPE_CHECKING:
    import h5py

_MAGIC = b"TACPRESS"
# Magic, number of the press, bytes of the image, SHA-256 of the image, CRC-32 of all that.
_FIELDS, _CRC = struct.Struct("<8sQQ32s"), struct.Struct("<I")
_HEADER_BYTES = _FIELDS.size + _CRC.size


class PressTail:
    """Presses that were appended to a recording, each as the image of an HDF5 file.

    The tail is from byte `begin`, where the HDF5 part ends, to `end`, where the last whole record
    ends; `complete` is whether nothing follows. `first` is the number of its first press.
    """

    def __init__(self, file: "h5py.File", source: Path | str, first: int) -> None:
        # The file that HDF5 has open: the one of this name may have been replaced meanwhile.
        self._descriptor: int = file.id.get_vfd_handle()
        self._source, self.first = source, first
        self._images: list[tuple[int, int, bytes]] = []
        self.begin = self.end = _hdf5_end(self._descriptor)
        size = os.fstat(self._descriptor).st_size
        while self._read_header(size):
            pass
        self.complete = self.end == size

    def __len__(self) -> int:
        return len(self._images)

    def image(self, index: int) -> bytes:
        """Return the HDF5 image of a press of the tail, by its index in the tail."""
        begin, length, digest = self._images[index]
        image = os.pread(self._descriptor, length, begin)
        if sha256(image).digest() != digest:
            raise self._error(index, "its checksum differs")
        return image

    def hdf5_part(self) -> bytes:
        """Return the HDF5 part of the file."""
        return os.pread(self._descriptor, self.begin, 0)

    def _read_header(self, size: int) -> bool:
        """Read the header of the next record; False where no whole record follows."""
        content = os.pread(self._descriptor, _HEADER_BYTES, self.end)
        # A writer that was killed leaves a part; a machine that crashed may leave zeros.
        if len(content) < _HEADER_BYTES or not any(content):
            return False
        fields, (crc,) = content[: _FIELDS.size], _CRC.unpack(content[_FIELDS.size :])
        magic, number, length, digest = _FIELDS.unpack(fields)
        count = len(self._images)
        if magic != _MAGIC or crc != zlib.crc32(fields) or number != self.first + count:
            raise self._error(count, "its header is not valid")
        begin = self.end + _HEADER_BYTES
        if begin + length > size:
            return False
        self._images.append((begin, length, digest))
        self.end = begin + length
        return True

    def _error(self, index: int, reason: str) -> RecordingError:
        return RecordingError(
            f"recording '{self._source}' is damaged at press {self.first + index + 1} "
            f"({reason}); copy it again from its source"
        )


def tail_record(number: int, image: bytes) -> bytes:
    """Return the record of a press: its number in the recording, from 0, and its HDF5 image."""
    fields = _FIELDS.pack(_MAGIC, number, len(image), sha256(image).digest())
    return fields + _CRC.pack(zlib.crc32(fields)) + image


def _hdf5_end(descriptor: int) -> int:
    """Return the end of the HDF5 part; the whole size where the file's structure has no checksums.

    HDF5 ignores what follows the end that its superblock states.
    """
    superblock = os.pread(descriptor, 48, 0)
    if superblock[:8] != b"\x89HDF\r\n\x1a\n" or superblock[8] not in (2, 3) or superblock[9] != 8:
        return os.fstat(descriptor).st_size
    return int.from_bytes(superblock[28:36], "little")
