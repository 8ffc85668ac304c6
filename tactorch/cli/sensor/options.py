"""Settings of the commands of `tactorch sensor`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from tactorch.cli.settings import CommandOptions
from tactorch.config import Options, option
from tactorch.fem import MATERIALS  # noqa: F401  (registry of a section)
from tactorch.sensor.calibration import FitOptions
from tactorch.sensor.chain import ChainOptions, DepthOptions
from tactorch.sensor.gel import GelOptions
from tactorch.sensor.recorder import RecordOptions


@dataclass(frozen=True, kw_only=True)
class SensorSettings(CommandOptions):
    """The sensor and its reference image."""

    sensor: Path = option(help="A sensor.yaml, or the name of a sensor that tactorch includes")
    reference: int | Path = option(
        help="Image of the gel without contact, or a folder or video that starts with it"
    )
    reference_frames: int = option(1, "Frames of the reference that are averaged", ge=1)


@dataclass(frozen=True, kw_only=True)
class SequenceSettings(SensorSettings):
    """A sequence of frames."""

    frames: int | Path = option(help="Folder of images, image, video or number of a camera")
    max_frames: int | None = option(None, "Largest number of frames; required for a camera", ge=1)


@dataclass(frozen=True, kw_only=True)
class PictureSettings(Options):
    """Pictures of a sequence."""

    pictures: int = option(6, "Frames that are drawn as PNG, evenly spaced", ge=0)
    video: bool = option(True, "Write a video")


@dataclass(frozen=True, kw_only=True)
class MarkerSettings(SensorSettings):
    """Scale and markers of images without a calibration."""

    mm_per_px: tuple[float, float] | None = option(
        None, "Scale along x and y; null: the sensor's", unit="mm", gt=0
    )
    marker_diameter_px: float | None = option(
        None, "Diameter of the markers; null: the sensor's, where it has markers", unit="px", gt=0
    )


@dataclass(frozen=True, kw_only=True)
class CalibratedSettings(SensorSettings):
    """A calibrated sensor."""

    calibration: Path = option(help="Result of tactorch sensor calibrate; its scale is used")


@dataclass(frozen=True, kw_only=True)
class BallSettings(SensorSettings):
    """Presses of a ball."""

    images: Path = option(help="Folder of images, each of a press of the ball")
    ball_radius_mm: float = option(help="Radius of the ball", unit="mm", gt=0)
    labels: Path | None = option(
        None, "CSV with image,center_x_px,center_y_px,radius_px; null: contacts are detected"
    )


@dataclass(frozen=True, kw_only=True)
class CalibrateSettings(FitOptions, BallSettings, MarkerSettings):
    """Settings of `tactorch sensor calibrate`."""

    map: str = option(  # type: ignore[assignment]
        "auto",
        "Map from colour to slope (mlp, mlp_colour, lookup, camera); auto: least error on held-out"
        " presses, without camera",
    )
    held_out: int | None = option(
        None,
        "Presses that are never fitted to, for the report; null: a quarter; 0: the report is on the"
        " fitted presses",
        ge=0,
    )
    folds: int | None = option(
        None, "Cross-validation instead: each press is left out once, in so many groups", ge=2
    )
    seed: int = option(
        0, "Seed of the map, of the drawn pixels and of the split of the presses", ge=0
    )
    camera: bool = option(False, "Fit the light of the differentiable camera too, for depth=fit")
    out: Path | None = option(None, "Calibration to write; null: calib.npz in run_dir")


@dataclass(frozen=True, kw_only=True)
class CheckSettings(BallSettings, CalibratedSettings):
    """Settings of `tactorch sensor check`."""

    reference: int | Path | None = option(  # type: ignore[assignment]
        None, "Image of the gel without contact on that day; null: the calibration's"
    )


@dataclass(frozen=True, kw_only=True)
class TrackSettings(PictureSettings, SequenceSettings, MarkerSettings):
    """Settings of `tactorch sensor track`."""

    backward: bool = option(
        False, "Track the markers back too, and report how far from their start they end"
    )
    magnify: float = option(1.0, "Magnification of arrows in pictures", gt=0)


@dataclass(frozen=True, kw_only=True)
class ReconstructSettings(DepthOptions, CalibratedSettings, PictureSettings, SequenceSettings):
    """Settings of `tactorch sensor reconstruct`."""


@dataclass(frozen=True, kw_only=True)
class ForceSettings(
    GelOptions, ChainOptions, CalibratedSettings, PictureSettings, SequenceSettings
):
    """Settings of `tactorch sensor force`."""


@dataclass(frozen=True, kw_only=True)
class RecordSettings(RecordOptions, GelOptions, ChainOptions, CalibratedSettings, SequenceSettings):
    """Settings of `tactorch sensor record`."""

    object: Any = option("box", "Object that is pressed", section="object")
    material: Any = option("neo_hookean", "Material of the object", section="material")
    poses: Path = option(help="CSV: time_s,x_mm,y_mm,z_mm,qw,qx,qy,qz of T_object_sensor")
    poses_clock: Literal["frames", "unix"] = option(
        "frames", "Zero of time_s: the first frame, or 1970 (for a camera)"
    )
    out: Path | None = option(None, "Recording to write; null: recording.h5 in the run folder")
    as_they_end: bool = option(
        False, "Append the presses of each contact once it has ended, for tactorch live"
    )
    contact_edge_mm: float | None = option(
        0.9, "Edge length of the gel's elements at the edge of each contact, for accurate forces in"
        " 10 to 60 s a press; null: the mesh of the gel",
        unit="mm", gt=0,
    )  # fmt: skip
    plots: bool = option(True, "Draw over_time.png and presses.png")
