"""Reading of NIfTI files and of segmentations in DICOM (through nibabel and highdicom)."""

import gzip
import importlib.util
import logging
import math
import struct
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from tactorch.budget import DEFLATE, check_deflated, check_memory, check_stored, gunzip
from tactorch.errors import ConfigError, FileError, TactorchError
from tactorch.volumes.volume import Content

_log = logging.getLogger(__name__)
#: Bytes of a label in memory.
LABEL_BYTES = 4
_MAX_APART = 0.5  # of the places of a voxel by sform and qform, in voxels
_UNITS = {"mm": "mm", "meter": "m", "micron": "um", "unknown": "mm"}
# SOP classes: Segmentation Storage, Label Map Segmentation Storage.
_SEGMENTATIONS = ("1.2.840.10008.5.1.4.1.1.66.4", "1.2.840.10008.5.1.4.1.1.66.7")


def read_nifti(source: Path) -> Content:
    """Read a NIfTI file, which has no names of labels."""
    if importlib.util.find_spec("nibabel") is None:
        raise ConfigError("Reading NIfTI needs nibabel: pip install 'tactorch[volumes]'.")

    try:
        image: Any = _open_nifti(source)
        # nibabel takes 1 for a size of 0; an sform does not use it.
        with image.file_map["image"].get_prepare_fileobj("rb") as file:
            stored = type(image.header).from_fileobj(file, check=False)
        sizes = np.abs(stored["pixdim"][1:4])
        # With the header's scaling: labels stored as bytes may have a slope.
        values = np.asarray(image.dataobj)
        affine = np.asarray(image.affine, dtype=np.float64)
        unit = str(image.header.get_xyzt_units()[0])
        forms = {key: int(image.header[f"{key}_code"]) for key in ("sform", "qform")}
        apart = _apart(image) if all(forms.values()) else 0.0
    except TactorchError:
        raise
    except Exception as error:  # errors of damaged files have no common base
        raise FileError(
            f"'{source}' cannot be read as NIfTI: {_reason(error)}. Is the file complete, and of"
            " the format its suffix says?"
        ) from error
    if not forms["sform"] and not (sizes > 0.0).all():
        shown = " x ".join(f"{size:.3g}" for size in sizes)
        raise FileError(
            f"'{source}': voxels of {shown} mm have no volume; write the file again with the "
            "spacing of the voxels."
        )
    if unit == "unknown":
        _log.info("'%s' states no unit of length: mm is taken.", source)
    if apart > _MAX_APART:
        _log.warning(
            "'%s': sform and qform differ by up to %.2g voxels; sform is taken.", source, apart
        )
    if not any(forms.values()):
        _log.warning(
            "'%s' has neither sform nor qform: the body has its voxel sizes, but no orientation.",
            source,
        )
    return values, affine, _UNITS.get(unit, "mm"), {}


def _open_nifti(source: Path) -> Any:
    """Open a file whose voxels it holds, and which fit into the memory."""
    import nibabel as nib

    is_packed = source.name.lower().endswith(".gz")
    with gzip.open(source) if is_packed else source.open("rb") as file:
        start = file.read(540)
    is_second = start[:4] in (struct.pack("<i", 540), struct.pack(">i", 540))
    kind: Any = nib.Nifti2Image if is_second else nib.Nifti1Image
    header = kind.header_class(start[: kind.header_class.sizeof_hdr], check=False)
    voxels, item = math.prod(map(int, header.get_data_shape())), header.get_data_dtype().itemsize
    claim = f"voxels of shape {header.get_data_shape()} and {header.get_data_dtype()}"
    content = voxels * item + max(int(header["vox_offset"]), 0)
    check_stored(source, claim, content / (DEFLATE if is_packed else 1))
    scaled = 8 if header.get_slope_inter() != (None, None) else 0
    kept = voxels * (item + scaled + LABEL_BYTES)
    check_memory(source, claim, kept + content * is_packed)
    if not is_packed:
        return nib.load(source)
    return kind.from_stream(gunzip(source, kept))


def read_segmentation(source: Path) -> Content:
    """Read a segmentation in DICOM, in patient coordinates (left, posterior, superior)."""
    if importlib.util.find_spec("highdicom") is None:
        raise ConfigError(
            "Reading DICOM segmentations needs highdicom: pip install 'tactorch[volumes]'."
        )
    import highdicom as hd
    import pydicom

    try:
        with warnings.catch_warnings(action="ignore"):
            _check_deflated(source)
            dataset = pydicom.dcmread(source)
            if dataset.get("SOPClassUID") not in _SEGMENTATIONS:
                kind = dataset.get("Modality", "unknown")
                raise FileError(
                    f"'{source}' is DICOM of modality {kind}, not a segmentation (SEG); give the "
                    "segmentation of the images."
                )
            segments = hd.seg.Segmentation.from_dataset(dataset, copy=False)
            if (geometry := segments.get_volume_geometry()) is not None:  # else an error follows
                shape = tuple(map(int, geometry.spatial_shape))
                needed = 2 * LABEL_BYTES * math.prod(shape) + source.stat().st_size
                check_memory(source, f"a volume of {shape} voxels", needed)
            volume = segments.get_volume(combine_segments=True)
            names = {
                int(number): str(segments.get_segment_description(number).segment_label)
                for number in segments.segment_numbers
            }
            affine = np.array(volume.affine, dtype=float)
            return volume.array.astype(np.int32), affine, "mm", names
    except TactorchError:
        raise
    except Exception as error:  # errors of damaged files have no common base
        reason = _reason(error)
        hint = (
            " Export segments that do not overlap."
            if "overlap" in reason.lower()
            else " Is the file complete?"
        )
        raise FileError(
            f"'{source}' cannot be read as a DICOM segmentation: {reason}.{hint}"
        ) from error


def _check_deflated(source: Path) -> None:
    """Refuse a compressed data set that pydicom would unpack into too much memory."""
    from pydicom import filereader, uid

    with source.open("rb") as file:
        filereader.read_preamble(file, force=False)
        meta = filereader._read_file_meta_info(file)
        if meta.get("TransferSyntaxUID") == uid.DeflatedExplicitVRLittleEndian:
            check_deflated(source, file)


def _apart(image: Any) -> float:
    """Return the largest distance of a corner's places by sform and qform, in voxels."""
    corners = np.indices((2, 2, 2)).reshape(3, -1).T * (np.array(image.shape[:3]) - 1)
    sform, qform = image.get_sform(), image.get_qform()
    difference = corners @ (sform - qform)[:3, :3].T + (sform - qform)[:3, 3]
    sizes = np.linalg.norm(sform[:3, :3], axis=0)
    return float(np.linalg.norm(difference, axis=1).max() / max(sizes.min(), 1e-300))


def _reason(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__
