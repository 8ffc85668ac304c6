"""How a session of frames becomes presses."""

from dataclasses import dataclass, field

from tactorch.errors import ConfigError
from tactorch.mesh.values import Real, positive
from tactorch.sensor.contact import ContactOptions
from tactorch.sensor.recorder.hold import Fixture

FIRST_TOUCH = ("shape", "depth")


@dataclass(frozen=True)
class RecordOptions:
    """How a session of frames becomes presses.

    Attributes:
        steps: Frames kept of each contact, evenly spaced in depth up to its deepest.
        min_frames: A contact of fewer frames is passed over: it was a flicker.
        first_touch: What tells where the sensor was when it first touched: the object's "shape"
            (where the gel's face and the object's meet by their poses), or the "depth" in the
            first frames, as for objects whose shape is not known.
        noise_mm: Standard deviation of the displacements; None takes what the frames without
            contact show, and no less than the chain allows for.
        hold: What holds the object.
        touching: Which parts of it may be touched; None leaves nodes without contact unseen, but
            in a virtual cube lets them move with the sensor, as the paper does.
    """

    steps: int = 3
    min_frames: int = 1
    first_touch: str = "shape"
    noise_mm: Real | None = None
    hold: Fixture = field(default_factory=Fixture)
    touching: ContactOptions | None = None

    def __post_init__(self) -> None:
        for name in ("steps", "min_frames"):
            if getattr(self, name) < 1:
                raise ConfigError(f"{name}={getattr(self, name)} must be at least 1.")
        if self.first_touch not in FIRST_TOUCH:
            raise ConfigError(
                f"first_touch={self.first_touch!r}: choose one of {', '.join(FIRST_TOUCH)}."
            )
        if self.noise_mm is not None:
            positive("noise_mm", self.noise_mm)
