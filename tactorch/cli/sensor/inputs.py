"""Inputs of the commands of `tactorch sensor`: sensor, calibration, frames, processing chain."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import islice, tee
from typing import TypeVar

from tactorch.cli.console import log, progress
from tactorch.cli.sensor.options import (
    CalibratedSettings,
    ForceSettings,
    RecordSettings,
    SensorSettings,
    SequenceSettings,
)
from tactorch.errors import ConfigError, FileError
from tactorch.sensor.calibration import Calibration, load_calibration
from tactorch.sensor.chain import SensorChain
from tactorch.sensor.description import SensorDescription, load_sensor
from tactorch.sensor.frames import (
    IMAGE_SUFFIXES,
    VIDEO_SUFFIXES,
    Frame,
    read_frames,
    read_reference,
    video_length,
)
from tactorch.sensor.gel import GelModel
from tactorch.sensor.markers import marker_appearance

_T = TypeVar("_T")


class FrameSequence:
    """Frames of a folder, a video, an image or a camera, and the image without contact.

    Those of a camera are stored, unless they are read only `once`. A camera that is `endless` needs
    no number of frames.
    """

    def __init__(
        self,
        cfg: SequenceSettings,
        sensor: SensorDescription,
        *,
        once: bool = False,
        endless: bool = False,
    ) -> None:
        self.source, self.max_frames = cfg.frames, cfg.max_frames
        self.reference = read_reference(cfg.reference, sensor, cfg.reference_frames)
        self._sensor, self._once = sensor, once
        if self.is_camera and self.max_frames is None and not endless:
            raise ConfigError(f"frames={self.source} is a camera; give max_frames too.")
        self.zero_unix_s: float | None = None  # time of a camera's first frame since 1970
        self._first = self._read()  # a missing source is an error at once

    def __iter__(self) -> Iterator[Frame]:
        """Iterate over the frames from the first."""
        if self._once:
            return self._first
        if not self.is_camera:
            return self._read()
        self._first, frames = tee(self._first)  # keeps the frames
        return frames

    @property
    def is_camera(self) -> bool:
        """Whether the source is a camera."""
        return isinstance(self.source, int)

    @property
    def total(self) -> int:
        """Expected number of frames."""
        if isinstance(self.source, int):
            return self.max_frames or 1
        count = 1
        if self.source.is_dir():
            count = sum(p.suffix.lower() in IMAGE_SUFFIXES for p in self.source.iterdir())
        elif self.source.suffix.lower() in VIDEO_SUFFIXES:
            count = video_length(self.source)
        return count if self.max_frames is None else min(count, self.max_frames)

    def process(self, label: str, function: Callable[[Frame], _T]) -> list[_T]:
        """Apply a function to all frames, with a progress bar; none with an image is an error."""
        results: list[_T] = []
        faults: list[str] = []
        with progress(label, "frames") as report:
            for frame in self:
                results.append(function(frame))
                faults += [frame.fault] if frame.image is None else []
                report(len(results), self.total)
        if faults and len(faults) == len(results):
            raise FileError(f"frames={self.source}: no frame can be used; the first: {faults[0]}")
        return results

    def _read(self) -> Iterator[Frame]:
        frames = read_frames(self.source, self._sensor, self.reference)
        return map(self._note_start, islice(frames, self.max_frames))

    def _note_start(self, frame: Frame) -> Frame:
        if self.zero_unix_s is None and frame.unix_s is not None and frame.time_s is not None:
            self.zero_unix_s = frame.unix_s - frame.time_s
        return frame


def load_sensor_settings(cfg: SensorSettings) -> SensorDescription:
    """Return the sensor description, with the scale of the settings if they have one."""
    sensor = load_sensor(str(cfg.sensor))
    scale = getattr(cfg, "mm_per_px", None)
    return sensor if scale is None else replace(sensor, mm_per_px=scale)


def load_calibrated(cfg: CalibratedSettings) -> tuple[SensorDescription, Calibration]:
    """Read sensor and calibration, and use the scale of the calibration.

    A calibration without markers may be used for a gel with markers, which are then masked.
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
    cfg: ForceSettings | RecordSettings, *, once: bool = False, endless: bool = False
) -> tuple[FrameSequence, SensorChain]:
    """Return the frames of the settings, see `FrameSequence`, and the processing chain for them."""
    sensor, calibration = load_calibrated(cfg)
    frames = FrameSequence(cfg, sensor, once=once, endless=endless)
    model = GelModel(sensor.gel, cfg)
    chain = SensorChain(sensor, calibration, frames.reference, model, cfg)
    if cfg.contact_edge_mm is None or sensor.markers is None:
        with progress("preparing the gel (once for a mesh)", "nodes") as report:
            chain.forces.prepare(report)
    return frames, chain
