"""Inputs of the commands of `tactorch sensor`: sensor, reference, calibration, processing chain."""

from dataclasses import replace
from pathlib import Path

from tactorch.cli.console import log
from tactorch.cli.sensor.options import (
    CalibratedSettings,
    ForceSettings,
    RecordSettings,
    SensorSettings,
)
from tactorch.errors import ConfigError
from tactorch.sensor.calibration import Calibration, load_calibration
from tactorch.sensor.chain import SensorChain
from tactorch.sensor.description import SensorDescription, load_sensor
from tactorch.sensor.frames import Image, read_reference
from tactorch.sensor.gel import GelModel
from tactorch.sensor.markers import MarkerAppearance


def load_sensor_settings(cfg: SensorSettings) -> SensorDescription:
    """Return the sensor description, with the scale of the settings if they have one."""
    sensor = load_sensor(str(cfg.sensor))
    scale = getattr(cfg, "mm_per_px", None)
    return sensor if scale is None else replace(sensor, mm_per_px=scale)


def load_reference(reference: int | Path, frames: int, sensor: SensorDescription) -> Image:
    """Return the image of the gel without contact, the mean of some frames."""
    return read_reference(reference, sensor, frames)


def marker_appearance(
    sensor: SensorDescription, diameter_px: float | None = None
) -> MarkerAppearance | None:
    """Return the appearance of markers; None for a sensor without markers."""
    if diameter_px is not None:
        return MarkerAppearance(diameter_px)
    if sensor.markers is None:
        return None
    x, y = sensor.mm_per_px
    return MarkerAppearance(sensor.markers.diameter_mm / (x * y) ** 0.5)


def load_calibrated(cfg: CalibratedSettings) -> tuple[SensorDescription, Calibration]:
    """Read sensor and calibration, and use the scale of the calibration.

    A calibration without markers may be used for a gel with markers, which are then masked.

    Raises:
        ConfigError: The calibration is of images of another size.
    """
    sensor, calibration = load_sensor_settings(cfg), load_calibration(str(cfg.calibration))
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
        calibration = replace(calibration, markers=marker_appearance(sensor))
    return sensor, calibration


def build_chain(
    cfg: ForceSettings | RecordSettings,
    sensor: SensorDescription,
    calibration: Calibration,
    reference: Image,
) -> SensorChain:
    """Return the processing chain of the settings, which are those of the gel and of the chain."""
    return SensorChain(sensor, calibration, reference, GelModel.build(sensor.gel, cfg), cfg)
