"""A calibration on disk: `calib.npz`, arrays and one text in JSON, nothing that runs when read."""

import json
import zipfile
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError, FileError
from tactorch.files import atomic_path, require_file
from tactorch.sensor.calibration.change import change
from tactorch.sensor.calibration.fit import seen_slopes
from tactorch.sensor.calibration.maps import SlopeMap, make_map
from tactorch.sensor.description import pixel_size
from tactorch.sensor.frames import Image
from tactorch.sensor.markers import MarkerLook
from tactorch.versions import versions

FORMAT, VERSION = "tactorch-calibration", 1
_PREFIX = "map/"
_MAX_BYTES = 500_000_000  # of the unpacked arrays


@dataclass(frozen=True, eq=False)
class Calibration:
    """A sensor that can tell slopes from colours.

    Attributes:
        map: From colours and places to slopes.
        reference: The gel without contact, as calibrated.
        mm_per_px: Size of a pixel along x and y, mm.
        look: How markers look; None where there are none.
        facts: What it was made of and how good it is, as plain values.
    """

    map: SlopeMap
    reference: Image
    mm_per_px: tuple[float, float]
    look: MarkerLook | None = None
    facts: dict[str, Any] = field(default_factory=dict)

    def slopes(self, image: Image, reference: Image | None = None) -> Float[np.ndarray, "h w 2"]:
        """Return dz/dx and dz/dy of the gel's face in an image.

        Args:
            image: Rectified.
            reference: Of the gel without contact on that day; None for the calibration's own.

        Raises:
            ConfigError: The image has another size than the reference, or than calibrated for.
        """
        if image.shape != self.reference.shape:
            raise ConfigError(
                f"the image has shape {image.shape}, but the sensor was calibrated with"
                f" {self.reference.shape}; give rectified images of that sensor, or calibrate"
                " again."
            )
        still = self.reference if reference is None else reference
        return seen_slopes(self.map, change(image, still, self.look))


def save_calibration(calibration: Calibration, path: str | Path) -> None:
    """Write a calibration.

    Raises:
        FileError: The file cannot be written.
    """
    look = None if calibration.look is None else asdict(calibration.look)
    text = {
        "format": FORMAT,
        "version": VERSION,
        "map": calibration.map.name,
        "mm_per_px": list(calibration.mm_per_px),
        "look": look,
        "facts": calibration.facts,
        "versions": versions(),
    }
    arrays: dict[str, Any] = {"reference": calibration.reference}
    arrays |= {_PREFIX + name: values for name, values in calibration.map.arrays().items()}
    with atomic_path(path) as temporary, open(temporary, "wb") as file:
        np.savez_compressed(file, about=np.array(json.dumps(text)), **arrays)


def load_calibration(path: str | Path) -> Calibration:
    """Read a calibration.

    Raises:
        FileError: The file is missing, damaged, of another kind or of a later version.
    """
    file = require_file(path, "calibration")
    try:
        with zipfile.ZipFile(file) as archive:
            size = sum(part.file_size for part in archive.infolist())
        if size > _MAX_BYTES:
            raise ValueError(f"its arrays have {size} bytes, more than {_MAX_BYTES}")
        with np.load(file, allow_pickle=False) as found:
            content = {name: found[name] for name in found.files}
        about = json.loads(str(content.pop("about")))
        if about["format"] != FORMAT:
            raise ValueError(f"its format is {about['format']}")
        if about["version"] != VERSION:
            raise FileError(
                f"calibration '{path}' is of version {about['version']}, this tactorch reads"
                f" {VERSION}; calibrate again."
            )
        if not isinstance(about["facts"], dict):
            raise ValueError("its facts are not a table")
        found_map = make_map(about["map"])
        _check_arrays(content)
        found_map.restore({k[len(_PREFIX) :]: v for k, v in content.items() if k != "reference"})
        look = None if about["look"] is None else MarkerLook(**about["look"])
        scale = pixel_size("mm_per_px", about["mm_per_px"])
        return Calibration(found_map, content["reference"], scale, look, about["facts"])
    except FileError:
        raise
    except Exception as error:  # what a damaged archive leads to has no common base
        reason = " ".join(str(error).split())[:120]
        raise FileError(
            f"calibration '{path}' cannot be read ({reason}); it is damaged or another file."
            " Calibrate again."
        ) from error


def _check_arrays(content: dict[str, np.ndarray]) -> None:
    reference = content["reference"]
    if reference.dtype != np.uint8 or reference.ndim != 3 or reference.shape[2] != 3:
        raise ValueError(f"its reference is no image but {reference.shape} of {reference.dtype}")
    for name, values in content.items():
        if not np.isfinite(values).all():
            raise ValueError(f"its {name} is not finite")
