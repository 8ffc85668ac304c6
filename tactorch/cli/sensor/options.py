"""Settings of the commands of `tactorch sensor`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from tactorch.cli.settings import CommandOptions
from tactorch.config import Options, option
from tactorch.fem import MATERIALS  # noqa: F401  (registries of the sections)
from tactorch.sensor.chain import ChainOptions, DepthOptions
from tactorch.sensor.gel import GelOptions
from tactorch.sensor.recorder import OBJECTS  # noqa: F401


@dataclass(frozen=True, kw_only=True)
class SensorSettings(CommandOptions):
    """The sensor and its reference image."""

    sensor: Path = option(help="A sensor.yaml, or the name of a sensor that tactorch includes")
    reference_frames: int = option(1, "Frames of the reference that are averaged", ge=1)


@dataclass(frozen=True, kw_only=True)
class SequenceSettings(SensorSettings):
    """A sequence of frames."""

    frames: int | Path = option(help="Folder of images, image, video or number of a camera")
    reference: int | Path = option(
        help="Image of the gel without contact, or a folder or video that starts with it"
    )
    max_frames: int | None = option(None, "Largest number of frames; required for a camera", ge=1)


@dataclass(frozen=True, kw_only=True)
class PictureSettings(Options):
    """Pictures of a sequence."""

    pictures: int = option(6, "Frames that are drawn as PNG, evenly spaced", ge=0)
    video: bool = option(True, "Write a video")


@dataclass(frozen=True, kw_only=True)
class CalibratedSettings(SensorSettings):
    """A calibrated sensor."""

    calibration: Path = option(help="Result of tactorch sensor calibrate; its scale is used")


@dataclass(frozen=True, kw_only=True)
class BallSettings(SensorSettings):
    """Presses of a ball."""

    images: Path = option(help="Folder of presses of the ball, one an image")
    ball_radius_mm: float = option(help="Radius of the ball", unit="mm", gt=0)
    labels: Path | None = option(
        None, "CSV with image,center_x_px,center_y_px,radius_px; null: contacts are detected"
    )


@dataclass(frozen=True, kw_only=True)
class CalibrateSettings(BallSettings):
    """Settings of `tactorch sensor calibrate`."""

    reference: int | Path = option(
        help="Image of the gel without contact, or a folder or video that starts with it"
    )
    mm_per_px: tuple[float, float] | None = option(
        None, "Scale along x and y; null: the sensor's", unit="mm", gt=0
    )
    marker_diameter_px: float | None = option(
        None, "Diameter of the markers; null: the sensor's, where it has markers", unit="px", gt=0
    )
    map: str = option(
        "auto",
        "Map from colour to slope (mlp, mlp_colour, lookup); auto: least error on held-out presses",
    )
    rounds: int = option(
        6, "Alternations of fitting the map and the contacts; 0: contacts are exact", ge=0
    )
    held_out: int | None = option(
        None, "Presses that are never fitted to, for the report; null: a quarter", ge=1
    )
    folds: int | None = option(
        None, "Cross-validation instead: each press is left out once, in so many groups", ge=2
    )
    seed: int = option(0, "Seed of the map, and of the choice of held-out presses", ge=0)
    out: Path | None = option(None, "Calibration to write; null: calib.npz in run_dir")


@dataclass(frozen=True, kw_only=True)
class CheckSettings(BallSettings, CalibratedSettings):
    """Settings of `tactorch sensor check`."""

    reference: int | Path | None = option(
        None, "Image of the gel without contact on that day; null: the calibration's"
    )


@dataclass(frozen=True, kw_only=True)
class TrackSettings(PictureSettings, SequenceSettings):
    """Settings of `tactorch sensor track`."""

    mm_per_px: tuple[float, float] | None = option(
        None, "Scale along x and y; null: the sensor's", unit="mm", gt=0
    )
    marker_diameter_px: float | None = option(
        None, "Diameter of the markers; null: the sensor's", unit="px", gt=0
    )
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
class RecordSettings(GelOptions, ChainOptions, CalibratedSettings, SequenceSettings):
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
    steps: int = option(3, "Frames kept of each contact, evenly spaced in depth", ge=1)
    min_frames: int = option(1, "Fewest frames of a contact; shorter ones are skipped", ge=1)
    first_contact: Literal["shape", "depth"] = option(
        "shape",
        "First contact by the poses (where the shapes meet), or by the first frames' depth",
    )
    reach_mm: float = option(
        3.0, "Distance from the gel at first contact up to which the object may be touched",
        unit="mm", gt=0,
    )  # fmt: skip
    untouched: Literal["unseen", "sensor", "auto"] = option(
        "auto", "Untouched face: unseen, moving with the sensor, or auto (sensor in a virtual cube)"
    )
    held_side: Literal["opposite", "x-", "x+", "y-", "y+", "z-", "z+"] = option(
        "opposite", "Side that is held; opposite: to each press"
    )
    held_by: Literal["fixed", "springs"] = option("fixed", "Support of the held side")
    spring_n_per_mm: float = option(1.0, "Stiffness of each spring", unit="N/mm", gt=0)
    plots: bool = option(True, "Draw over_time.png and presses.png")
