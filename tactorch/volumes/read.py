"""Reading of labelled volumes: NIfTI, NRRD, MetaImage, segmentations in DICOM, arrays of NumPy.

| file | labels | place of the voxels |
|---|---|---|
| .nii, .nii.gz | 3-D, whole numbers | sform, else qform, else the voxel sizes; axes right, anterior, superior |
| DICOM segmentation | numbers of the segments | patient coordinates; axes left, posterior, superior |
| .nrrd, .nhdr, .seg.nrrd, .mha, .mhd | 3-D, whole numbers; numbers of the segments | `space directions`, `TransformMatrix` and the spacing; axes left, posterior, superior |
| .npz | array `labels` | `affine` (4, 4) in mm, or `spacing_mm` (3,) with `origin_mm` (3,) |
| .npy | the array | the setting `spacing_mm`, the first voxel at 0 |
"""  # noqa: E501

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from tactorch.budget import read_content
from tactorch.errors import ConfigError, FileError, TactorchError
from tactorch.files import as_array, read_arrays, require_file
from tactorch.volumes.medical import LABEL_BYTES, read_nifti, read_segmentation
from tactorch.volumes.nrrd import SUFFIXES, read_nrrd
from tactorch.volumes.volume import LabelVolume

_log = logging.getLogger(__name__)
LengthUnit = Literal["um", "mm", "cm", "m"]
MM_PER_UNIT = {"um": 1e-3, "mm": 1.0, "cm": 10.0, "m": 1e3}
_READERS = {"nifti": read_nifti, "nrrd": read_nrrd, "dicom": read_segmentation}
_MAX_LABEL = 2**31 - 1
_DICOM_MAGIC = slice(128, 132)


def read_volume(
    path: str | Path,
    *,
    unit: LengthUnit | None = None,
    spacing_mm: Sequence[float] | None = None,
) -> LabelVolume:
    """Read a labelled volume; see the module's docstring for the formats.

    Args:
        path: The file.
        unit: Unit of the lengths in the file; None for that which it states, or else mm.
        spacing_mm: Edge lengths of the voxels, for arrays whose file does not state them, mm.

    Raises:
        ConfigError: The spacing is missing, or given for a file that states it; a package to read
            the format is not installed.
        FileError: The file is missing, of no known format or damaged; the array is not of three
            axes, or not of whole numbers; the voxels have no volume; the unit is not known.
    """
    source = require_file(path, "volume of labels")
    kind = _kind(source)
    if kind in _READERS:
        if spacing_mm is not None:
            raise ConfigError(f"spacing_mm is given, but '{source}' states it; leave it out.")
        values, affine, file_unit, names = _READERS[kind](source)
        labels = as_labels(values, source)
    else:
        (labels, affine), file_unit, names = _read_arrays(source, kind, spacing_mm), "mm", {}
    if unit is not None and unit != file_unit:
        _log.info("'%s': lengths are read in %s instead of %s.", source, unit, file_unit)
    used = unit or file_unit
    if used not in MM_PER_UNIT:
        known = "|".join(MM_PER_UNIT)
        raise FileError(f"'{source}' states its lengths in {used}; give their unit (unit={known}).")
    scale = np.diag([MM_PER_UNIT[used]] * 3 + [1.0])
    return LabelVolume(labels, scale @ affine, names, str(source), used)


def _kind(source: Path) -> str:
    name = source.name.lower()
    if name.endswith((".nii", ".nii.gz")):
        return "nifti"
    if name.endswith((".npy", ".npz")):
        return name[-3:]
    if source.suffix.lower() in SUFFIXES:
        return "nrrd"
    with source.open("rb") as file:
        if file.read(132)[_DICOM_MAGIC] == b"DICM":
            return "dicom"
    raise FileError(
        f"'{source}' is no volume of labels that can be read; give NIfTI (.nii, .nii.gz), NRRD "
        "(.nrrd), MetaImage (.mha, .mhd), a DICOM segmentation, .npz or .npy."
    )


def as_labels(values: np.ndarray, source: Path) -> Int[np.ndarray, "i j k"]:
    """Return an array of a file as labels."""
    array = np.asarray(values)
    while array.ndim > 3 and array.shape[-1] == 1:
        array = array[..., 0]
    if array.ndim != 3:
        raise FileError(
            f"'{source}' has an array of shape {array.shape}; a volume of labels has three axes. "
            "Save one of its volumes, with one label for each voxel."
        )
    if not array.size:
        raise FileError(f"'{source}' has no voxel: its shape is {array.shape}.")
    if array.dtype.kind not in "biuf":
        raise FileError(f"'{source}' holds {array.dtype}; labels are whole numbers.")
    labels = np.empty(array.shape, np.int32)
    for part, kept in zip(array, labels, strict=True):  # slices, as copies of all take much memory
        kept[...] = _whole(part, source)
    return labels


def _whole(part: np.ndarray, source: Path) -> np.ndarray:
    """Return a slice of whole numbers, or raise `FileError`."""
    if part.dtype.kind == "f" and not (whole := part == np.round(part)).all():
        raise FileError(
            f"'{source}' has voxels that are not whole numbers, such as {part[~whole].flat[0]:g}: "
            "an image or a probability instead of labels. Give the segmentation, without "
            "interpolation."
        )
    if float(np.abs([part.min(), part.max()]).max()) > _MAX_LABEL:
        raise FileError(f"'{source}' has labels above {_MAX_LABEL}; number them from 1.")
    return part


def _read_arrays(
    source: Path, kind: str, spacing_mm: Sequence[float] | None
) -> tuple[Int[np.ndarray, "i j k"], Float[np.ndarray, "4 4"]]:
    """Read an array of labels and the place of its voxels from .npz or .npy."""
    if kind == "npy":
        try:
            arrays = {"labels": as_array(read_content(source, 1 + LABEL_BYTES))}
        except TactorchError:
            raise
        except Exception as error:  # errors of damaged files have no common base
            raise FileError(
                f"'{source}' cannot be read ({error}); write it again with numpy.save."
            ) from error
    else:
        remedy = "write it again with numpy.savez."
        arrays = read_arrays(source, "volume of labels", remedy, 1 + LABEL_BYTES)
    if "labels" not in arrays:
        held = ", ".join(arrays) or "nothing"
        raise FileError(f"'{source}' has no array 'labels'; it has {held}.")
    labels = as_labels(arrays["labels"], source)
    if spacing_mm is not None and not {"affine", "spacing_mm"}.isdisjoint(arrays):
        raise ConfigError(f"spacing_mm is given, but '{source}' states it; leave it out.")
    if "affine" in arrays:
        return labels, _numbers(arrays, "affine", (4, 4), source)
    sizes: Sequence[float] | np.ndarray | None = spacing_mm
    if "spacing_mm" in arrays:
        sizes = _numbers(arrays, "spacing_mm", (3,), source)
        if not (sizes > 0.0).all():
            raise FileError(
                f"'{source}': spacing_mm is {sizes.tolist()}; give positive edge lengths, so that "
                "voxels have a volume, and the array affine for axes that are reversed."
            )
    if sizes is None:
        raise ConfigError(
            f"'{source}' does not state the size of its voxels; give spacing_mm=[X,Y,Z]."
        )
    affine = np.diag([*sizes, 1.0])
    if "origin_mm" in arrays:
        affine[:3, 3] = _numbers(arrays, "origin_mm", (3,), source)
    return labels, affine


def _numbers(
    arrays: dict[str, np.ndarray], name: str, shape: tuple[int, ...], source: Path
) -> Float[np.ndarray, "..."]:
    array = arrays[name]
    if array.shape != shape or array.dtype.kind not in "iuf":
        raise FileError(
            f"'{source}': {name} is {array.dtype} of shape {array.shape}; give numbers of shape "
            f"{shape}."
        )
    return array.astype(np.float64)
