"""HDF5 files: written whole or not at all, and read as data of unknown origin.

`Hdf5Reader` refuses whatever makes HDF5 read other files (external links, external raw storage,
virtual datasets), links within the file, and sizes that the file does not hold.
"""

import io
import json
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tactorch.budget import DEFLATE, TEXT, check_memory
from tactorch.errors import FileError, TactorchError
from tactorch.files import parse_json, require_file, write_file

if TYPE_CHECKING:
    import h5py

# From HDF5 1.10 on, the structure of the file has checksums, so that damage is noticed.
LIBVER = ("v110", "v110")
_MAX_UNSTORED_BYTES = 1 << 24  # of values that were never written
# Accepted kinds of a dataset, type named in messages, and type of the array returned.
_KINDS: dict[str, tuple[str, str, type]] = {
    "f": ("f", "float64", np.float64),
    "i": ("iu", "int64", np.int64),
    "b": ("ub", "uint8", np.bool_),
}
_ACCEPTED = {int: (np.integer, int), float: (np.floating, float), str: (str,)}


def hdf5_image(write: Callable[["h5py.File"], None], image: bytes = b"") -> bytes:
    """Return the content of a new HDF5 file, or of the changed file `image`.

    The file is made in memory: HDF5 reports a full disk from the destructors of its objects too,
    and leaves half a file.
    """
    import h5py

    memory = io.BytesIO(image)
    with h5py.File(memory, "r+" if image else "w", libver=LIBVER) as file:
        write(file)
    return memory.getvalue()


def write_hdf5(path: str | Path, write: Callable[["h5py.File"], None]) -> None:
    """Write an HDF5 file, whole or not at all."""
    write_file(path, hdf5_image(write))


def write_attributes(group: "h5py.Group", **values: str | int | float) -> None:
    """Set attributes, text in fixed length."""
    for name, value in values.items():
        group.attrs[name] = fixed_text(value) if isinstance(value, str) else value


def write_array(group: "h5py.Group", name: str, array: np.ndarray) -> None:
    """Write an array with gzip, whose checksum is verified on reading."""
    group.create_dataset(name, data=array, compression="gzip", compression_opts=4, shuffle=True)


def write_json(group: "h5py.Group", name: str, value: Any) -> None:
    """Write plain values as JSON text, with a checksum: HDF5 has none for text."""
    text = json.dumps(value)
    group[name] = fixed_text(text)
    write_attributes(group[name], sha256=sha256(text.encode()).hexdigest())


def fixed_text(text: str) -> np.ndarray:
    """Return `text`, which must not contain a NUL, as HDF5 text of fixed length.

    HDF5 keeps text of variable length in a heap without checksums, and hangs where that is damaged.
    """
    import h5py

    if "\0" in text:
        raise ValueError(f"text with a NUL in it: {text!r}")
    content = text.encode("utf-8")
    return np.array(content, dtype=h5py.string_dtype("utf-8", max(1, len(content))))


@contextmanager
def open_hdf5(path: str | Path, what: str, remedy: str) -> Iterator["h5py.File"]:
    """Open an HDF5 file for reading; errors of a damaged file, inside too, become `FileError`.

    Messages name the expected content `what`, and `remedy` where the file is not HDF5.
    """
    import h5py

    source = require_file(path, what)
    if not h5py.is_hdf5(source):
        raise FileError(f"'{source}' is not an HDF5 file, so not a {what}; {remedy}")
    try:
        file = h5py.File(source, "r")
    except (OSError, RuntimeError, ValueError) as error:
        raise FileError(
            f"{what} '{source}' is damaged or cut short ({error}); copy it again from its source"
        ) from error
    with file:
        try:
            yield file
        except TactorchError:
            raise
        # What h5py raises on a damaged file has no common base.
        except Exception as error:
            raise FileError(
                f"{what} '{source}' is damaged ({error}); copy it again from its source"
            ) from error


class Hdf5Reader:
    """Reads checked values from an open file or group.

    Errors, of class `error`, name the file `source`, its expected content `what`, the function
    `writer` that writes such files, and the dataset. The memory for all datasets that are read is
    limited.
    """

    def __init__(
        self,
        root: "h5py.Group",
        source: Path | str,
        what: str,
        writer: str,
        error: type[TactorchError] = FileError,
    ) -> None:
        self.root, self.source = root, source
        self._what, self._writer, self._error_class = what, writer, error
        self._read_bytes = 0

    def check_format(self, name: str, version: int, remedy: str) -> int:
        """Return the version of the file; refuse another format, and versions that are later."""
        kind = self.attribute("/", "format", str) if "format" in self.root.attrs else None
        if kind != name:
            raise self.error(
                f"has format {kind!r} where {name!r} is expected; it is HDF5, but not a "
                f"{self._what} of tactorch: {remedy}"
            )
        stored: int = self.attribute("/", "version", int)
        if stored > version:
            raise self.error(
                f"has version {stored}, and this tactorch reads up to {version}; upgrade tactorch"
            )
        if stored < 1:
            raise self.error(f"has version {stored}, which never existed; write it again")
        return stored

    def has(self, name: str) -> bool:
        """Return whether the file holds a dataset or group."""
        return self._find(name) is not None

    def group(self, name: str) -> "h5py.Group":
        """Return a group; "/" is the root."""
        import h5py

        found = self._find(name)
        if not isinstance(found, h5py.Group):
            raise self.error(f"lacks group '{name}'; the file is incomplete: write it again")
        return found

    def array(self, name: str, kind: str, shape: tuple[int | None, ...]) -> np.ndarray:
        """Read a numeric dataset of a required shape; None stands for any length.

        `kind` is "f" for real numbers, "i" for integers, "b" for a mask of 0 and 1; the array
        returned is of float64, int64 or bool.
        """
        dataset = self._dataset(name)
        kinds, stored, returned = _KINDS[kind]
        if dataset.dtype.kind not in kinds:
            raise self.error(
                f"dataset '{name}' has dtype {dataset.dtype}; {stored} is needed: "
                f"write the {self._what} again with {self._writer}"
            )
        sizes = dataset.shape or ()  # None for a dataset without extent
        if len(sizes) != len(shape) or any(
            wanted not in (None, actual) for wanted, actual in zip(shape, sizes, strict=True)
        ):
            text = ", ".join("any" if size is None else str(size) for size in shape)
            raise self.error(
                f"dataset '{name}' has shape {dataset.shape}; ({text}) is needed. Is it of another"
                " mesh?"
            )
        array = self._values(name, dataset, returned)
        if kind == "b" and (array > 1).any():
            raise self.error(f"dataset '{name}' is a mask but holds values other than 0 and 1")
        return np.asarray(array.astype(returned, copy=False))

    def json(self, name: str, kind: type = dict) -> Any:
        """Read a dataset of JSON text, and compare it with its checksum where it has one."""
        dataset = self._dataset(name)
        value = self._values(name, dataset, bytes)
        if not isinstance(value, bytes):
            raise self.error(
                f"dataset '{name}' is not text; write the {self._what} again with {self._writer}"
            )
        if "sha256" in dataset.attrs and sha256(value).hexdigest() != self._text(dataset, "sha256"):
            raise self.error(
                f"dataset '{name}' is damaged (its checksum differs); copy the file again from its "
                "source"
            )
        return self.parse_json(name, value.decode("utf-8"), kind)

    def parse_json(self, name: str, text: str, kind: type = dict) -> Any:
        """Return the value, of type `kind` (dict or list), of the JSON text called `name`."""
        try:
            value = parse_json(text, f"'{name}' of {self._what} '{self.source}'", self._error_class)
        except ValueError as error:
            raise self.error(
                f"'{name}' is not JSON: {error}; write the {self._what} again"
            ) from error
        if not isinstance(value, kind):
            wanted = "object" if kind is dict else "list"
            raise self.error(f"'{name}' is {text[:40]!r}; a JSON {wanted} is needed")
        return value

    def attribute(self, group: str, name: str, kind: type) -> Any:
        """Read an attribute of a group; `kind` is int, float or str."""
        owner = self.group(group)
        if name not in owner.attrs:
            raise self.error(f"lacks attribute '{name}' of '{group}'; write the {self._what} again")
        stored = owner.attrs.get_id(name)
        value = self._text(owner, name) if stored.shape == () else stored.shape
        if not isinstance(value, _ACCEPTED[kind]):
            raise self.error(
                f"attribute '{name}' of '{group}' is {value!r}; {kind.__name__} is needed"
            )
        return kind(value)

    def error(self, complaint: str) -> TactorchError:
        """Return an error about the file."""
        return self._error_class(f"{self._what} '{self.source}' {complaint}")

    @staticmethod
    def _text(owner: Any, name: str) -> Any:
        value = owner.attrs[name]
        return value.decode("utf-8") if isinstance(value, bytes) else value

    def _find(self, name: str) -> Any:
        """Return the object at a path, or None; every step must be a hard link."""
        import h5py

        node, passed = self.root, ""
        for part in filter(None, name.split("/")):
            passed = f"{passed}/{part}" if passed else part
            try:
                link = node.get(part, getlink=True) if isinstance(node, h5py.Group) else None
            except TypeError:  # a kind of link that h5py does not know
                link = part
            if link is None:
                return None
            if not isinstance(link, h5py.HardLink):
                kind = "an external link" if isinstance(link, h5py.ExternalLink) else "a link"
                raise self.error(
                    f"'{passed}' is {kind}, which may lead to other files and is not followed; "
                    "copy what it points to into the file"
                )
            node = node[part]
        return node

    def _dataset(self, name: str) -> "h5py.Dataset":
        import h5py

        dataset = self._find(name)
        if not isinstance(dataset, h5py.Dataset):
            raise self.error(
                f"lacks dataset '{name}'; the file is incomplete: write the {self._what} again "
                f"with {self._writer}"
            )
        if dataset.is_virtual or dataset.id.get_create_plist().get_external_count():
            kind = "a virtual dataset" if dataset.is_virtual else "stored outside the file"
            raise self.error(
                f"dataset '{name}' is {kind}, so its values come from other files, which are not "
                "read; copy them into the file"
            )
        return dataset

    def _check_size(self, name: str, dataset: "h5py.Dataset", returned: type) -> None:
        """Refuse a shape that the file does not hold, or that does not fit into the memory."""
        count, item = math.prod(dataset.shape or ()), dataset.dtype.itemsize
        declared = item * max(count, math.prod(dataset.chunks or ()))
        stored = dataset.id.get_storage_size()
        if declared > _MAX_UNSTORED_BYTES + DEFLATE * stored:
            raise self.error(
                f"dataset '{name}' has shape {dataset.shape}, {declared:.3g} bytes, of which the "
                f"file holds {stored}: the shape is wrong, or the values were never written"
            )
        if returned is bytes:
            needed = declared * TEXT
        else:
            kept = np.dtype(returned)
            needed = declared + (0 if kept == dataset.dtype else count * kept.itemsize)
        self._read_bytes += needed
        claim = f"dataset '{name}' of shape {dataset.shape} and {dataset.dtype}"
        others = self._read_bytes - needed
        claim += f" with others of {others:.3g} bytes" if others else ""
        source = f"{self._what} '{self.source}'"
        check_memory(source, claim, self._read_bytes, self._error_class)

    def _values(self, name: str, dataset: "h5py.Dataset", returned: type) -> Any:
        self._check_size(name, dataset, returned)
        try:
            return dataset[()]
        except (OSError, MemoryError) as error:
            raise self.error(
                f"dataset '{name}' is damaged ({error}); copy the file again from its source"
            ) from error
