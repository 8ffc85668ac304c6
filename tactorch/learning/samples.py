"""Samples of a dataset as tensors, for user-defined networks."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.utils.data import Dataset

from tactorch.errors import ConfigError
from tactorch.generation import Sample, SampleSet
from tactorch.mesh import TetMesh, VoxelGrid
from tactorch.touch import Touch

Item = dict[str, Any]
#: Masks of `collate_touch`, and a tensor whose first dimension each describes.
MASKS = {"node_mask": "points", "element_mask": "tets", "press_mask": "forces"}
_TOUCH_NUMBERS = (
    "markers_px", "rest_markers_px", "gel_points", "gel_displacement", "gel_forces", "poses",
    "first_poses", "mm_per_px",
)  # fmt: skip


class TouchDataset(Dataset[Item]):
    """The samples of a dataset of `tactorch generate` as tensors.

    A sample is a dictionary; n nodes, m elements, k presses and v voxels along each axis:

    | key | shape | value |
    |---|---|---|
    | `index`, `object` | () | numbers of sample and object |
    | `label` | | class of the object, a string |
    | `points` | (n, 3) | rest positions of the nodes, mm |
    | `tets` | (m, 4) | nodes of the elements |
    | `forces` | (k, n, 3) | forces on the nodes, N |
    | `displacement` | (k, n, 3) | measured displacement, mm; 0 where not observed |
    | `observed` | (k, n, 3) | whether it was observed |
    | `noise_mm` | (k,) | standard deviation of the displacement; 0 without noise |
    | `youngs` | (m,) | true Young's modulus, MPa |
    | `reconstruction` | (m,) | reconstructed modulus, MPa; where the dataset has it |
    | `voxel_youngs` | (v, v, v) | true modulus at the voxels of the bounding box, MPa; 0 outside |
    | `voxel_inside` | (v, v, v) | whether the centre of a voxel is inside the body |

    Samples with a tactile sensor (`tactorch generate dataset=touch`) have, of images of h rows and
    w columns, p markers and g nodes of the gel's face:

    | key | shape | value |
    |---|---|---|
    | `images` | (k, 3, h, w) | red, green and blue, uint8 |
    | `reference` | (3, h, w) | image without contact, uint8 |
    | `height_mm` | (k, h, w) | z of the gel's face relative to rest; where the dataset has it |
    | `markers_px`, `rest_markers_px` | (k, p, 2), (p, 2) | column and row of the markers |
    | `marker_visible` | (k, p) | whether a marker is in the image |
    | `gel_points` | (g, 3) | nodes of the gel's face at rest, mm |
    | `gel_displacement` | (k, g, 3) | their displacement, mm |
    | `gel_forces` | (k, g, 3) | forces of the body on them, N |
    | `gel_force` | (k, 3) | their sum, N |
    | `poses`, `first_poses` | (k, 4, 4) | T_object_sensor, and the same at first touch, mm |
    | `place` | (k,) | number of the pressed place |
    | `mm_per_px` | (2,) | size of a pixel along x and y, mm |

    The gel is in the sensor frame, whose z axis points to the body. `points` and `forces` are in
    the frame of the object: `forces.sum(1)` is minus `gel_force`, turned by `poses[:, :3, :3]`.

    Floating-point numbers are float32. `collate_touch` makes batches of different meshes.
    Split datasets by `object`: presses of one object are alike.

    Args:
        folder: Folder of the dataset, or the dataset.
        voxels: Number of voxels along each axis; None without voxels.
        transform: Function of a sample, applied to each.

    Raises:
        ConfigError: `voxels` is below 1.
        FileError: See `SampleSet`.
    """

    def __init__(
        self,
        folder: str | Path | SampleSet,
        *,
        voxels: int | None = None,
        transform: Callable[[Item], Any] | None = None,
    ) -> None:
        if voxels is not None and voxels < 1:
            raise ConfigError(f"voxels={voxels}: give at least 1, or None for none.")
        self.samples = folder if isinstance(folder, SampleSet) else SampleSet(folder)
        self._voxels, self._transform = voxels, transform
        self._grids: dict[TetMesh, VoxelGrid] = {}

    def __len__(self) -> int:
        return len(self.samples)

    def __getitem__(self, row: int) -> Any:
        """Return the sample of a row, from 0 to `len(self) - 1`.

        Raises:
            IndexError: There is no such row.
            FileError: Its shard is missing or damaged.
        """
        if not -len(self) <= row < len(self):
            raise IndexError(f"row {row} of a dataset of {len(self)} samples")
        item = self._item(self.samples[self.samples.indices[row]])
        return item if self._transform is None else self._transform(item)

    def _item(self, sample: Sample) -> Item:
        recording = sample.recording
        mesh, presses = recording.mesh, recording.presses
        observed = np.stack([press.observed for press in presses])
        displacement = np.stack([press.displacement for press in presses])
        item = {
            "index": torch.tensor(sample.index),
            "object": torch.tensor(sample.object),
            "label": sample.label,
            "points": _floats(mesh.points),
            "tets": torch.from_numpy(mesh.tets.copy()),
            "forces": _floats(np.stack([press.forces for press in presses])),
            "displacement": _floats(np.where(observed, displacement, 0.0)),
            "observed": torch.from_numpy(observed),
            "noise_mm": _floats(np.array([press.noise_mm or 0.0 for press in presses])),
            "youngs": _floats(sample.truth),
        }
        if sample.reconstruction is not None:
            item["reconstruction"] = _floats(sample.reconstruction)
        if sample.touch is not None:
            item |= _touch_fields(sample.touch)
        if self._voxels is not None:
            item |= self._voxel_fields(mesh, sample.truth)
        return item

    def _voxel_fields(self, mesh: TetMesh, youngs: Float[np.ndarray, " m"]) -> Item:
        assert self._voxels is not None
        if mesh not in self._grids:
            self._grids = {mesh: VoxelGrid(mesh, self._voxels)}  # samples often share their mesh
        grid = self._grids[mesh]
        inside = torch.from_numpy(grid.inside)
        return {"voxel_youngs": _floats(grid.fill(youngs)) * inside, "voxel_inside": inside}


def collate_touch(items: Sequence[Item]) -> Item:
    """Return a batch of samples of `TouchDataset`, for `torch.utils.data.DataLoader`.

    Tensors get a first dimension for the samples. Where their shapes differ, they are filled up
    with zeros; `node_mask` (samples, nodes), `element_mask` and `press_mask` tell the real entries
    (`marker_visible` is false for presses that were filled up).
    Strings are lists. A key that not all samples have is left out.
    """
    keys = [key for key in items[0] if all(key in item for item in items)]
    batch: Item = {key: _stacked([item[key] for item in items]) for key in keys}
    for mask, key in MASKS.items():
        counts = torch.tensor([len(item[key]) for item in items])
        batch[mask] = torch.arange(int(counts.max())) < counts[:, None]
    return batch


def _touch_fields(touch: Touch) -> Item:
    item = {
        "images": torch.from_numpy(touch.images).movedim(-1, 1).contiguous(),
        "reference": torch.from_numpy(touch.reference).movedim(-1, 0).contiguous(),
        "marker_visible": torch.from_numpy(touch.marker_visible),
        "gel_force": _floats(touch.total_force),
        "place": torch.from_numpy(touch.place),
    }
    item |= {name: _floats(getattr(touch, name)) for name in _TOUCH_NUMBERS}
    return item if touch.height_mm is None else {**item, "height_mm": _floats(touch.height_mm)}


def _stacked(values: list[Any]) -> Any:
    if not isinstance(values[0], Tensor):
        return values
    shape = torch.tensor([value.shape for value in values]).amax(dim=0).tolist()
    batch = values[0].new_zeros((len(values), *shape))
    for place, value in zip(batch, values, strict=True):
        place[tuple(slice(size) for size in value.shape)] = value
    return batch


def _floats(values: Float[np.ndarray, "..."]) -> Float[Tensor, "..."]:
    return torch.from_numpy(np.asarray(values, dtype=np.float32))
