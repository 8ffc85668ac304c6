"""What every command of `tactorch sensor` is given: the sensor, a reference, a calibration."""

from dataclasses import replace
from pathlib import Path

from tactorch.cli.sensor.options import CalibratedSettings, SensorSettings
from tactorch.cli.settings import log
from tactorch.errors import ConfigError
from tactorch.sensor.calibration import Calibration, load_calibration
from tactorch.sensor.description import SensorDescription, load_sensor
from tactorch.sensor.frames import Image, read_reference
from tactorch.sensor.markers import MarkerAppearance


def sensor_of(cfg: SensorSettings) -> SensorDescription:
    """Return the sensor's description, with the scale of the settings where they have one."""
    sensor = load_sensor(str(cfg.sensor))
    scale = getattr(cfg, "mm_per_px", None)
    return sensor if scale is None else replace(sensor, mm_per_px=scale)


def reference_of(reference: int | Path, frames: int, sensor: SensorDescription) -> Image:
    """Return the image of the gel without contact, an average of so many frames."""
    return read_reference(reference, sensor, frames)


def look_of(sensor: SensorDescription, diameter_px: float | None = None) -> MarkerAppearance | None:
    """Return how markers look; None where the sensor has none."""
    if diameter_px is not None:
        return MarkerAppearance(float(diameter_px))
    if sensor.markers is None:
        return None
    x, y = map(float, sensor.mm_per_px)
    return MarkerAppearance(float(sensor.markers.diameter_mm) / (x * y) ** 0.5)


def calibrated(cfg: CalibratedSettings) -> tuple[SensorDescription, Calibration]:
    """Read sensor and calibration; the scale is that of the calibration.

    A calibration made without markers serves a gel with markers, which are then masked.

    Raises:
        ConfigError: The calibration is of images of another size.
    """
    sensor, calibration = sensor_of(cfg), load_calibration(str(cfg.calibration))
    shape = calibration.reference.shape[:2]
    if shape != sensor.shape:
        raise ConfigError(
            f"calibration '{cfg.calibration}' is of images of {shape[1]} x {shape[0]} px, but"
            f" sensor '{sensor.name}' has {sensor.shape[1]} x {sensor.shape[0]}; give the sensor"
            " that was calibrated."
        )
    if tuple(sensor.mm_per_px) != calibration.mm_per_px:
        log.info("scale: %.5g x %.5g mm per px, as calibrated", *calibration.mm_per_px)
        sensor = replace(sensor, mm_per_px=calibration.mm_per_px)
    if calibration.markers is None:
        calibration = replace(calibration, markers=look_of(sensor))
    return sensor, calibration
