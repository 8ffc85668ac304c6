"""What a tactile sensor measures in a sample, in HDF5; see `tactorch.generation.layout`."""

from typing import TYPE_CHECKING

import numpy as np

from tactorch.hdf5 import Hdf5Reader, write_array
from tactorch.touch import Touch

if TYPE_CHECKING:
    import h5py

_GROUP = "touch"
_IMAGES = {"images": 4, "reference": 3}  # number of dimensions
_SINGLE = {
    "markers_px": 3, "rest_markers_px": 2, "gel_points": 2, "gel_displacement": 3,
    "gel_forces": 3, "poses": 3, "first_poses": 3, "mm_per_px": 1,
}  # fmt: skip


def write_touch(group: "h5py.Group", touch: Touch) -> None:
    """Write into an empty group."""
    for name in (*_IMAGES, *_SINGLE):
        write_array(group, name, getattr(touch, name))
    write_array(group, "marker_visible", touch.marker_visible.astype(np.uint8))
    write_array(group, "place", touch.place.astype("<i8"))
    if touch.height_mm is not None:
        write_array(group, "height_mm", touch.height_mm)


def read_touch(reader: Hdf5Reader) -> Touch | None:
    """Read the touch of a sample; None where it has none.

    Raises:
        FileError: An array is missing, or has another type or another number of dimensions.
    """
    if not reader.has(_GROUP):
        return None
    images = {
        name: reader.array(f"{_GROUP}/{name}", "i", (None,) * count).astype(np.uint8)
        for name, count in _IMAGES.items()
    }
    single = {name: _single(reader, name, count) for name, count in _SINGLE.items()}
    has_heights = reader.has(f"{_GROUP}/height_mm")
    return Touch(
        **images,
        **single,
        height_mm=_single(reader, "height_mm", 3) if has_heights else None,
        marker_visible=reader.array(f"{_GROUP}/marker_visible", "b", (None, None)),
        place=reader.array(f"{_GROUP}/place", "i", (None,)),
    )


def _single(reader: Hdf5Reader, name: str, count: int) -> np.ndarray:
    return reader.array(f"{_GROUP}/{name}", "f", (None,) * count).astype(np.float32)
