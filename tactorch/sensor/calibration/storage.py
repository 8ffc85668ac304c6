"""Calibrations and their files: npz archives of arrays and JSON text, without executable code."""

import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from jaxtyping import Float

from tactorch.config import to_mapping
from tactorch.errors import ConfigError, FileError
from tactorch.files import read_arrays, write_arrays
from tactorch.sensor.calibration.maps import SENSOR_MAPS, SlopeMap, change_and_light, map_slopes
from tactorch.sensor.depth import MIN_SLOPE, HeightMap, reconstruct_height
from tactorch.sensor.description import check_pixel_size
from tactorch.sensor.frames import Image
from tactorch.sensor.light import LightChange
from tactorch.sensor.markers import MarkerAppearance
from tactorch.versions import versions

if TYPE_CHECKING:
    from tactorch.sensor.camera.light_fit import LightFit

#: Way from an image to a height.
DepthMethod = Literal["lookup", "fit"]
FORMAT, VERSION = "tactorch-calibration", 1
_PREFIX, _CAMERA = "map/", "camera/"
_REMEDY = "it is damaged or another file. Calibrate again."
_FORMER_NAMES = {"smallest": "min_area", "largest": "max_area"}


@dataclass(frozen=True, eq=False)
class Calibration:
    """Calibration of a sensor's colors.

    Attributes:
        map: Map from colors and positions to slopes.
        reference: Image of the gel without contact.
        mm_per_px: Size of a pixel along x and y, mm.
        markers: Appearance of markers; None without markers.
        facts: Origin and accuracy, as plain values.
        light: Light and colour response of the differentiable camera, for heights by fitting;
            None without.
    """

    map: SlopeMap
    reference: Image
    mm_per_px: tuple[float, float]
    markers: MarkerAppearance | None = None
    facts: dict[str, Any] = field(default_factory=dict)
    light: "LightFit | None" = None

    @property
    def map_name(self) -> str:
        """Name of the map."""
        return SENSOR_MAPS.name_of(type(self.map.options))

    def slopes(self, image: Image, reference: Image | None = None) -> Float[np.ndarray, "h w 2"]:
        """Return dz/dx and dz/dy of the gel's face in a rectified image.

        `reference` shows the gel without contact on that day; None for the calibration's.
        """
        return map_slopes(self.map, self._change(image, reference)[0])

    def _change(
        self, image: Image, reference: Image | None
    ) -> tuple[Float[np.ndarray, "h w 3"], LightChange]:
        if image.shape != self.reference.shape:
            raise ConfigError(
                f"the image has shape {image.shape}, but the sensor was calibrated with"
                f" {self.reference.shape}; give rectified images of that sensor, or calibrate"
                " again."
            )
        unloaded = self.reference if reference is None else reference
        return change_and_light(image, unloaded, self.markers)

    def height(
        self,
        image: Image,
        reference: Image | None = None,
        *,
        depth: DepthMethod = "lookup",
        min_slope: float = MIN_SLOPE,
        mm_per_px: tuple[float, float] | None = None,
    ) -> HeightMap:
        """Return the height of the gel's face in a rectified image.

        Args:
            image: Rectified image.
            reference: Image of the gel without contact on that day; None for the calibration's.
            depth: `lookup` integrates the slopes of the map; `fit` then fits the rendered colours,
                see `fit_height`.
            min_slope: Slope above which the face is deformed.
            mm_per_px: Size of a pixel along x and y, mm; None for that of the calibration.

        Raises:
            ConfigError: The image has another size, or the calibration has no light for `fit`.
            ConvergenceError: The linear solver does not converge.
        """
        size = mm_per_px or self.mm_per_px
        change, light = self._change(image, reference)
        slopes = map_slopes(self.map, change)
        height = replace(reconstruct_height(slopes, size, min_slope), light=light)
        if depth == "lookup":
            return height
        if self.light is None:
            raise ConfigError(
                "depth=fit takes a calibration with the light of the sensor; calibrate again with"
                " camera=true, or use depth=lookup."
            )
        from tactorch.sensor.camera.height import fit_height  # imports kornia

        camera = self.light
        return fit_height(change, camera.shading, camera.deviation, slopes, height, size)


def save_calibration(calibration: Calibration, path: str | Path) -> None:
    """Write a calibration."""
    markers = calibration.markers
    text = {
        "format": FORMAT,
        "version": VERSION,
        "map": {"name": calibration.map_name, **to_mapping(calibration.map.options)},
        "mm_per_px": list(calibration.mm_per_px),
        "look": None if markers is None else to_mapping(markers),
        "facts": calibration.facts,
        "versions": versions(),
    }
    arrays = {_PREFIX + name: values for name, values in calibration.map.arrays().items()}
    if calibration.light is not None:
        from tactorch.sensor.calibration.camera import light_arrays

        light = light_arrays(calibration.light)
        arrays |= {_CAMERA + name: values for name, values in light.items()}
    about = np.array(json.dumps(text))
    write_arrays(
        path, {"about": about, "reference": calibration.reference, **arrays}, compressed=True
    )


def load_calibration(path: str | Path) -> Calibration:
    """Read a calibration."""
    arrays = read_arrays(path, "calibration", _REMEDY)
    try:
        about = json.loads(str(arrays.pop("about")))
        if about["format"] != FORMAT:
            raise ValueError(f"its format is {about['format']}")
        if about["version"] != VERSION:
            raise FileError(
                f"calibration '{path}' is of version {about['version']}, this tactorch reads"
                f" {VERSION}; calibrate again."
            )
        return _parse(about, arrays)
    except FileError:
        raise
    except Exception as error:  # errors of damaged files have no common base class
        reason = " ".join(str(error).split())[:120]
        raise FileError(f"calibration '{path}' cannot be read ({reason}); {_REMEDY}") from error


def _parse(about: dict[str, Any], arrays: dict[str, np.ndarray]) -> Calibration:
    if not isinstance(about["facts"], dict):
        raise ValueError("its facts are not a table")
    reference = arrays["reference"]
    if reference.dtype != np.uint8 or reference.ndim != 3 or reference.shape[2] != 3:
        raise ValueError(f"its reference is no image but {reference.shape} of {reference.dtype}")
    for name, values in arrays.items():
        if not np.isfinite(values).all():
            raise ValueError(f"its {name} is not finite")
    settings = about["map"]
    if str(settings.get("name", "")).startswith("mlp"):
        settings.setdefault("activation", "tanh")  # of files without this setting
    slope_map = SENSOR_MAPS.build(settings).create(0)
    slope_map.restore(_named(arrays, _PREFIX))
    light = None
    if stored := _named(arrays, _CAMERA):
        from tactorch.sensor.calibration.camera import restore_light

        light = restore_light(stored)
    x, y = map(float, about["mm_per_px"])
    check_pixel_size((x, y))
    markers = about["look"]
    if markers is not None:
        markers = MarkerAppearance(**{_FORMER_NAMES.get(k, k): v for k, v in markers.items()})
    return Calibration(slope_map, reference, (x, y), markers, about["facts"], light)


def _named(arrays: dict[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    """Return the arrays of a prefix, by the rest of their names."""
    return {k[len(prefix) :]: v for k, v in arrays.items() if k.startswith(prefix)}
