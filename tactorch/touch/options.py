"""Settings of simulated touch."""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import ClassVar, Literal

from tactorch.config import Options, option
from tactorch.errors import ConfigError
from tactorch.mesh.tetmesh import FaceName
from tactorch.phantoms.draws import Range, check_ranges
from tactorch.sensor.description import GelLayer, SensorDescription, load_sensor
from tactorch.sensor.gel import GelMesh
from tactorch.sensor.render import RenderOptions

_CENTER = 0.6  # edge length of the gel's cells at the center of the face, over the mean


@dataclass(frozen=True)
class TouchOptions(Options):
    """Sensor and distribution of its presses; without a sensor presses are pressures."""

    section: ClassVar[str] = "dataset.touch"
    sensor: str | None = option(
        None, "Sensor that is pressed on the bodies, a name or a file; null: none, pressures act"
    )
    image_width_px: int | None = option(
        160, "Width of the images; null: that of the sensor", unit="px", ge=16, le=4000
    )
    presses: tuple[int, int] = option((1, 2), "Fewest and most pressed places of a body", ge=1)
    depth_mm: Range = option(
        (0.3, 1.0), "Range of the motion of the sensor from first touch", unit="mm", gt=0
    )
    steps: int = option(1, "Equal steps of the motion at each place; each is a press", ge=1)
    shear_mm: Range = option(
        (0.0, 0.0), "Range of the motion across the axis, in a random direction", unit="mm", ge=0
    )
    max_slope_deg: float = option(
        60.0, "Largest angle of the surface at a place to the side opposite the held one",
        unit="deg", gt=0, le=120,
    )  # fmt: skip
    tilt_deg: float = option(
        3.0, "Largest angle of the sensor's axis to the surface's normal", unit="deg", ge=0, le=30
    )
    friction: Literal["stick", "none"] = option(
        "stick", "stick: points in contact do not slip; none: they slip freely"
    )
    held_side: FaceName = option("z-", "Side of the bounding box at which the body is held")
    held: float = option(
        0.02, "Height above that side up to which the body is held, in its extent", ge=0, lt=0.5
    )
    gel_edge_mm: float = option(1.6, "Mean edge length of the gel's cells", unit="mm", gt=0)
    gel_layers: int = option(2, "Number of cells through the gel", ge=1)
    heights: bool = option(True, "Store the height of the gel's face at each pixel")
    render: RenderOptions = option(factory=RenderOptions, help="Appearance of the sensor")

    def __post_init__(self) -> None:
        super().__post_init__()
        check_ranges(self, "presses", "depth_mm", "shear_mm")

    def description(self) -> SensorDescription:
        """Return the sensor with rectified images of `image_width_px`.

        Raises:
            ConfigError: The description is not valid, or there is none.
            FileError: The description cannot be read.
        """
        if self.sensor is None:
            raise ConfigError("dataset.touch.sensor is null; give a name or a sensor.yaml.")
        sensor = load_sensor(self.sensor)
        width, height = sensor.image_size_px
        size = (width, height)
        if self.image_width_px is not None:
            size = (self.image_width_px, max(8, round(height * self.image_width_px / width)))
        scale = width / size[0], height / size[1]
        x, y = sensor.mm_per_px
        return replace(
            sensor, image_size_px=size, mm_per_px=(x * scale[0], y * scale[1]), raw_size_px=size,
            intrinsics_px=None, distortion=(), warp_corners_px=None, warped_size_px=None,
            crop_px=None,
        )  # fmt: skip

    def gel_mesh(self, gel: GelLayer) -> GelMesh:
        """Return the mesh of a gel, with smaller cells at the center.

        Raises:
            ConfigError: There are too few cells across the gel, or too many.
        """
        return _gel_mesh(gel, self.gel_edge_mm, self.gel_layers, _CENTER)


_gel_mesh = lru_cache(maxsize=4)(GelMesh)
