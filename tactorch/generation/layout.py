"""Layout of a dataset on disk.

A dataset is a folder:

| file | content |
|---|---|
| recipe.json | all settings that determine the samples |
| shard-00000.h5 ... | samples, about 50 per file; written whole or not at all |
| manifest.json | written last: recipe, versions, checksums, failed samples |
| card.md, card.png | summary as text and as a figure; touch.png: what a sensor sees |
| partial/ | samples of unfinished shards, while generation runs |

In a shard (HDF5, text and arrays as in recordings):

| path | type |
|---|---|
| / `format`, `version` | attributes: "tactorch-samples", 1 |
| / `failed` | attribute, JSON object: sample number to reason |
| /samples/000012 | a recording (`tactorch.recording.schema`), and: |
| /samples/000012 `index`, `object`, `label` | attributes |
| /samples/000012 `facts`, `figures` | attributes, JSON objects |
| /samples/000012/reconstruction | float64 (m,), MPa; absent where none was made |
| /samples/000012/touch | images and forces of a sensor, see below; absent without one |
| /meshes/HASH | points and tets that samples of this mesh share |

In `touch`, of k presses, an image of h rows and w columns, p markers and g nodes of the gel's face:

| path | type | unit |
|---|---|---|
| images | uint8 (k, h, w, 3): red, green, blue | |
| reference | uint8 (h, w, 3), image without contact | |
| height_mm | float32 (k, h, w), z of the gel's face relative to rest; may be absent | mm |
| markers_px | float32 (k, p, 2), column and row of each marker | px |
| rest_markers_px | float32 (p, 2), the same without contact | px |
| marker_visible | uint8 (k, p), 1 for markers in the image | |
| gel_points | float32 (g, 3), nodes of the gel's face at rest, sensor frame | mm |
| gel_displacement | float32 (k, g, 3), sensor frame | mm |
| gel_forces | float32 (k, g, 3), of the body on the gel, sensor frame | N |
| poses | float32 (k, 4, 4), T_object_sensor | mm |
| first_poses | float32 (k, 4, 4), T_object_sensor at first touch | mm |
| place | int64 (k,), number of the pressed place | |
| mm_per_px | float32 (2,), size of a pixel along x and y | mm |

In the image, integers of column and row are at the centres of pixels. The sensor frame has its
origin at the centre of the gel's face at rest, x along columns, y along rows, z toward the body.
The forces of press i on the body are in `presses/000i/forces`: their sum is minus that of
`gel_forces`, turned by the rotation of `poses`.
"""

import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tactorch.errors import FileError
from tactorch.generation.sample import Sample
from tactorch.hdf5 import Hdf5Reader, hdf5_image, write_array, write_attributes, write_hdf5
from tactorch.recording.storage import write_recording
from tactorch.touch import Touch

if TYPE_CHECKING:
    import h5py

FORMAT = "tactorch-samples"
VERSION = 1
MANIFEST_FORMAT = "tactorch-dataset"
RECIPE, MANIFEST, PARTIAL = "recipe.json", "manifest.json", "partial"
_GROUP, _HEIGHTS = "touch", "height_mm"  # heights may be absent
#: Of the arrays of a touch: kind and number of dimensions for reading, and type in the file.
_ARRAYS: dict[str, tuple[str, int, Any]] = {
    "images": ("i", 4, np.uint8), "reference": ("i", 3, np.uint8),
    "markers_px": ("f", 3, np.float32), "rest_markers_px": ("f", 2, np.float32),
    "gel_points": ("f", 2, np.float32), "gel_displacement": ("f", 3, np.float32),
    "gel_forces": ("f", 3, np.float32), "poses": ("f", 3, np.float32),
    "first_poses": ("f", 3, np.float32), "mm_per_px": ("f", 1, np.float32),
    "marker_visible": ("b", 2, np.uint8), "place": ("i", 1, np.int64),
    _HEIGHTS: ("f", 3, np.float32),
}  # fmt: skip


def sample_name(index: int) -> str:
    """Return the name of a sample within a shard."""
    return f"{index:06d}"


def to_bytes(sample: Sample) -> bytes:
    """Return a sample as the content of a separate HDF5 file."""

    def write(file: "h5py.File") -> None:
        write_recording(file, vars(sample.recording))
        texts = {"facts": json.dumps(sample.facts), "figures": json.dumps(sample.figures)}
        texts |= {"label": sample.label, "mesh_hash": sample.recording.mesh.content_hash()}
        write_attributes(file, index=sample.index, object=sample.object, **texts)
        if sample.reconstruction is not None:
            write_array(file, "reconstruction", sample.reconstruction)
        if sample.touch is not None:
            _write_touch(file.create_group(_GROUP), sample.touch)

    return hdf5_image(write)


def write_shard(path: Path, parts: Mapping[int, bytes], failed: Mapping[int, str]) -> None:
    """Write samples to a shard, in the order of their numbers; whole or not at all."""
    import h5py

    def write(shard: "h5py.File") -> None:
        reasons = {str(index): failed[index] for index in sorted(failed)}
        write_attributes(shard, format=FORMAT, version=VERSION, failed=json.dumps(reasons))
        shard.create_group("samples")
        shard.create_group("meshes")
        for index in sorted(parts):
            with h5py.File(io.BytesIO(parts[index]), "r") as part:
                _copy(part, shard, sample_name(index))

    write_hdf5(path, write)


def _write_touch(group: "h5py.Group", touch: Touch) -> None:
    for name, (_, _, stored) in _ARRAYS.items():
        if (values := getattr(touch, name)) is not None:
            write_array(group, name, values.astype(stored))


def _copy(part: "h5py.File", shard: "h5py.File", name: str) -> None:
    group = shard["samples"].create_group(name)
    group.attrs.update(part.attrs)
    for key in part:
        if key != "mesh":
            part.copy(key, group)
    mesh = part.attrs["mesh_hash"].decode()
    if mesh not in shard["meshes"]:
        part.copy("mesh", shard["meshes"], name=mesh)
    group["mesh"] = shard["meshes"][mesh]


def damaged(path: Path, reason: Any) -> FileError:
    """Return the error for a shard that cannot be read."""
    return FileError(
        f"shard '{path}' is damaged ({reason}); delete it and generate again: only its samples are"
        " made again."
    )


def read_touch(reader: Hdf5Reader) -> Touch | None:
    """Read the touch of a sample; None where it has none.

    Raises:
        FileError: An array is missing, or has another type or another number of dimensions.
    """
    if not reader.has(_GROUP):
        return None
    arrays: dict[str, Any] = {_HEIGHTS: None}
    for name, (kind, count, stored) in _ARRAYS.items():
        path = f"{_GROUP}/{name}"
        if name != _HEIGHTS or reader.has(path):
            values = reader.array(path, kind, (None,) * count)
            arrays[name] = values if kind == "b" else values.astype(stored)
    return Touch(**arrays)
