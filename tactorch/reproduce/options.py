"""Sizes of the studies behind the exhibits; the defaults take minutes."""

from dataclasses import dataclass
from typing import Literal

from tactorch.config import Options, option

_MODELS = ("4a", "4b", "4c", "4d", "4e", "4f", "4g", "5a", "5b", "5c")


@dataclass(frozen=True)
class MeshedSize(Options):
    """Size of a study on meshes of its phantoms."""

    relative_edge_length: float = option(
        0.14, "Edge length as a fraction of the bounding box's diagonal", gt=0
    )


@dataclass(frozen=True)
class CredibilitySize(Options):
    """Fig. 3."""

    divisions: int = option(6, "Divisions of the cube's side", ge=1)
    layers: int = option(6, "Layers of the curves", ge=1)


@dataclass(frozen=True)
class ModelsSize(MeshedSize):
    """Table I, Fig. 4 and 5."""

    names: tuple[str, ...] = option(_MODELS, "Models, by their panels in the paper")
    p_max_mpa: float = option(0.02, "Highest pressure, as in the paper", unit="MPa", gt=0)
    steps: int = option(2, "Load steps", ge=1)
    patches: int = option(12, "Patches on curved bodies", ge=1)
    patch_steps: int = option(1, "Load steps of each patch", ge=1)
    sensor_mm: float = option(3.0, "Radius of the sensor", unit="mm", gt=0)
    noise_relative: float = option(
        1.0e-5, "Noise that the inversion assumes, as a fraction of the signal", gt=0
    )
    tnc_evaluations: int = option(60, "Evaluations of truncated Newton", ge=1)
    tnc_patience: float = option(
        0, "Time of truncated Newton beyond those, as a multiple of Gauss-Newton's", ge=0
    )


@dataclass(frozen=True)
class DesignSize(MeshedSize):
    """Table II, Fig. 7 and 8."""

    meshes: tuple[Literal["same", "other"], ...] = option(
        ("same",), "Meshes to invert on: that of the simulation, or another one"
    )
    layers: int = option(8, "Layers of the curves", ge=1)


@dataclass(frozen=True)
class SizesSize(MeshedSize):
    """Fig. 9."""

    steps: int = option(1, "Load steps", ge=1)
    snr_db: float = option(40.0, "Signal-to-noise ratio", unit="dB")


@dataclass(frozen=True)
class DepthsSize(MeshedSize):
    """Fig. 10."""

    places: int = option(2, "Places of the ball at each depth", ge=1)
    faces: tuple[str, ...] = option(("z+", "x+", "y+"), "Pressed faces")
    p_max_mpa: float = option(0.2, "Highest pressure", unit="MPa", gt=0)
    steps: int = option(1, "Load steps", ge=1)
    support: Literal["springs", "fixed", "roller"] = option("fixed", "Support of the opposite face")
    snr_db: float = option(40.0, "Signal-to-noise ratio", unit="dB")
    seed: int = option(10, "Seed of the places and of the noise", ge=0)
    estimate: Literal["shapes", "map"] = option(
        "shapes", "Whether the ball is a fitted shape, or a lump of the map"
    )


@dataclass(frozen=True)
class RecognitionSize(MeshedSize):
    """Fig. 11."""

    count: int = option(60, "Objects", ge=1)
    reconstruct: bool | Literal["linear"] = option(
        "linear", "Inversion of each object; linear: the linear image, for a tenth of the time"
    )
    splits: int = option(2, "Trainings, each on another split", ge=1)
    epochs: int = option(20, "Epochs of each training", ge=1)


@dataclass(frozen=True)
class SamplingSize(MeshedSize):
    """Fig. 12."""

    load: float = option(0.05, "Pressure divided by the modulus of the background", gt=0)
    sensor_mm: float = option(3.0, "Radius of the sensor", unit="mm", gt=0)
    candidates: int = option(24, "Places that are compared", ge=1)
    presses: int = option(5, "Presses", ge=1)


@dataclass(frozen=True)
class StudySizes(Options):
    """Size of each study."""

    name: str = option("quick", "Name of the size, and of the folder of the files")
    credibility: CredibilitySize = option(factory=CredibilitySize, help="Fig. 3")
    models: ModelsSize = option(factory=ModelsSize, help="Table I, Fig. 4 and 5")
    design: DesignSize = option(factory=DesignSize, help="Table II, Fig. 7 and 8")
    sizes: SizesSize = option(factory=SizesSize, help="Fig. 9")
    depths: DepthsSize = option(factory=DepthsSize, help="Fig. 10")
    recognition: RecognitionSize = option(factory=RecognitionSize, help="Fig. 11")
    sampling: SamplingSize = option(factory=SamplingSize, help="Fig. 12")
