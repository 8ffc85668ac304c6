"""Reading of segmentations in DICOM (through highdicom)."""

import importlib.util
import warnings
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from tactorch.errors import ConfigError, FileError

# SOP classes: Segmentation Storage, Label Map Segmentation Storage.
_SEGMENTATIONS = ("1.2.840.10008.5.1.4.1.1.66.4", "1.2.840.10008.5.1.4.1.1.66.7")


def read_segmentation(
    source: Path,
) -> tuple[Int[np.ndarray, "i j k"], Float[np.ndarray, "4 4"], dict[int, str]]:
    """Read the segment of each voxel, the affine matrix in mm, and the names of the segments.

    The matrix leads to patient coordinates (left, posterior, superior).
    """
    if importlib.util.find_spec("highdicom") is None:
        raise ConfigError(
            "Reading DICOM segmentations needs highdicom: pip install 'tactorch[volumes]'."
        )
    import highdicom as hd
    import pydicom

    try:
        with warnings.catch_warnings(action="ignore"):
            dataset = pydicom.dcmread(source)
            if dataset.get("SOPClassUID") not in _SEGMENTATIONS:
                kind = dataset.get("Modality", "unknown")
                raise FileError(
                    f"'{source}' is DICOM of modality {kind}, not a segmentation (SEG); give the "
                    "segmentation of the images."
                )
            segments = hd.seg.Segmentation.from_dataset(dataset, copy=False)
            volume = segments.get_volume(combine_segments=True)
            names = {
                int(number): str(segments.get_segment_description(number).segment_label)
                for number in segments.segment_numbers
            }
            return volume.array.astype(np.int32), np.array(volume.affine, dtype=float), names
    except FileError:
        raise
    except Exception as error:  # errors of damaged files have no common base
        reason = " ".join(str(error).split()) or type(error).__name__
        hint = (
            " Export segments that do not overlap."
            if "overlap" in reason.lower()
            else " Is the file complete?"
        )
        raise FileError(
            f"'{source}' cannot be read as a DICOM segmentation: {reason}.{hint}"
        ) from error
