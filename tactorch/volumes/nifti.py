"""Reading of NIfTI files (through nibabel)."""

import importlib.util
import logging
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError, FileError
from tactorch.volumes.volume import MAX_VOXELS

_log = logging.getLogger(__name__)
_UNITS = {"mm": "mm", "meter": "m", "micron": "um", "unknown": "mm"}


def read_nifti(source: Path) -> tuple[np.ndarray, Float[np.ndarray, "4 4"], str]:
    """Read the array of a file, its affine matrix, and the unit of the matrix ("um", "mm", "m").

    Raises:
        ConfigError: nibabel is not installed.
        FileError: The file is damaged, no NIfTI file, or too large.
    """
    if importlib.util.find_spec("nibabel") is None:
        raise ConfigError("Reading NIfTI needs nibabel: pip install 'tactorch[volumes]'.")
    import nibabel as nib

    try:
        image: Any = nib.load(source)
        shape = image.shape
        if np.prod(shape, dtype=float) > MAX_VOXELS:
            raise ValueError(f"{shape} are more than {MAX_VOXELS:.0e} voxels")
        # With the header's scaling: labels stored as bytes may have a slope.
        values = np.asarray(image.dataobj)
        affine = np.asarray(image.affine, dtype=np.float64)
        unit = str(image.header.get_xyzt_units()[0])
        codes = [int(image.header[key]) for key in ("sform_code", "qform_code")]
    except Exception as error:  # errors of damaged files have no common base
        reason = " ".join(str(error).split()) or type(error).__name__
        raise FileError(
            f"'{source}' cannot be read as NIfTI: {reason}. Is the file complete, and of the "
            "format its suffix says?"
        ) from error
    if unit == "unknown":
        _log.info("'%s' states no unit of length: mm is taken.", source)
    if not any(codes):
        _log.warning(
            "'%s' has neither sform nor qform: the body has its voxel sizes, but no orientation.",
            source,
        )
    return values, affine, _UNITS.get(unit, "mm")
