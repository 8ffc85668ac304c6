"""From a frame to the contact that it shows: markers, depth, the gel's deformation, forces."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import binary_dilation, map_coordinates

from tactorch.errors import ConfigError
from tactorch.mesh.values import Real, positive
from tactorch.sensor.calibration import Calibration
from tactorch.sensor.contact import carry_displacements
from tactorch.sensor.depth import STEEP, Height, height_of
from tactorch.sensor.description import SensorDescription
from tactorch.sensor.frames import Frame, Image
from tactorch.sensor.gel import Contact, GelModel
from tactorch.sensor.markers import MarkerLook, MarkerTracker, TrackOptions, displacement_mm

_OUT = np.array([0.0, 0.0, 1.0])  # of the sensor
_SCALE_OFF = 0.02  # by which a pixel may be of another size than when calibrated


@dataclass(frozen=True)
class ChainOptions:
    """How frames become contacts.

    Attributes:
        noise_mm: Standard deviation of the displacements that markers and depth tell.
        around_mm: By how much the touched region is widened beyond what depth shows.
        min_depth_mm: Depth below which a frame is taken to be without contact.
        steep: Slope from which the face counts as deformed, see `height_of`.
        track: How strictly markers are followed.
    """

    noise_mm: Real = 0.01
    around_mm: Real = 0.5
    min_depth_mm: Real = 0.03
    steep: Real = STEEP
    track: TrackOptions = field(default_factory=TrackOptions)

    def __post_init__(self) -> None:
        for name in ("noise_mm", "around_mm", "min_depth_mm", "steep"):
            positive(name, getattr(self, name))


@dataclass(frozen=True, eq=False)
class Deformed:
    """How a frame shows the gel's face to have moved.

    Attributes:
        frame: The frame.
        markers_px: Its markers in the reference's order; NaN where one is not seen.
        height: How far the face moved along z; None where there is no image.
        moved: Displacement of the nodes of the gel's face, NaN where unknown, mm; None without
            contact.
        touched: Nodes of the gel's face that are touched.
    """

    frame: Frame
    markers_px: Float[np.ndarray, "n 2"]
    height: Height | None
    moved: Float[np.ndarray, "k 3"] | None
    touched: Bool[np.ndarray, " k"]


@dataclass(frozen=True, eq=False)
class Seen:
    """What a frame shows.

    Attributes:
        frame: The frame.
        markers_px: Its markers in the reference's order; NaN where one is not seen.
        height: How far the face moved along z; None where there is no image.
        contact: Forces and displacements of the gel's face; None without contact.
        touched: Nodes of the gel's face that are touched.
    """

    frame: Frame
    markers_px: Float[np.ndarray, "n 2"]
    height: Height | None
    contact: Contact | None
    touched: Bool[np.ndarray, " k"]


class SensorChain:
    """A calibrated sensor that tells the forces on its gel, frame by frame.

    Args:
        sensor: The sensor.
        calibration: From colours to slopes.
        reference: The gel without contact.
        model: The gel; None makes one with cells of 1 mm.
        options: How frames become contacts.

    Raises:
        ConfigError: The sensor has no markers, the reference shows too few, or sensor, calibration
            and reference are not of one image size and scale.
    """

    def __init__(
        self,
        sensor: SensorDescription,
        calibration: Calibration,
        reference: Image,
        model: GelModel | None = None,
        options: ChainOptions | None = None,
    ) -> None:
        if sensor.markers is None:
            raise ConfigError(
                f"sensor '{sensor.name}' has no markers, which tell how it is sheared; give markers"
                " in its description."
            )
        _check_sizes(sensor, calibration, reference)
        self.sensor, self.calibration, self.reference = sensor, calibration, reference
        self.model = model or GelModel(sensor.gel)
        self.options = options or ChainOptions()
        x, y = sensor.mm_per_px
        self.mm_per_px = (float(x), float(y))
        pixel = float(np.sqrt(x * y))
        diameter = float(sensor.markers.diameter_mm) / pixel
        self.look = calibration.look or MarkerLook(diameter)
        self.tracker = MarkerTracker(reference, self.look, self.options.track)

    def follow(self, frames: Iterable[Frame]) -> Iterator[Seen]:
        """Yield what each frame shows; frames without an image show nothing."""
        for frame in frames:
            yield self.see(frame)

    def see(self, frame: Frame) -> Seen:
        """Return what the next frame shows.

        Raises:
            ConfigError: The frame has another size than the reference.
            ConvergenceError: The gel collapses under what it shows.
        """
        look = self.deformed(frame)
        return Seen(frame, look.markers_px, look.height, self.contact(look), look.touched)

    def deformed(self, frame: Frame) -> Deformed:
        """Follow the markers into the next frame and return how the face moved, without forces.

        Raises:
            ConfigError: The frame has another size than the reference.
        """
        none = np.zeros(len(self.model.points), dtype=bool)
        if frame.image is None:
            return Deformed(frame, np.full(self.tracker.begin.shape, np.nan), None, None, none)
        found = self.tracker.follow(frame.image).places
        slopes = self.calibration.slopes(frame.image, self.reference)
        height = height_of(slopes, self.mm_per_px, self.options.steep)
        if -height.height_mm.min() < float(self.options.min_depth_mm):
            return Deformed(frame, found, height, None, none)
        moved = self._moved(found, height)
        touched = self._touched(height, moved)
        return Deformed(frame, found, height, moved if touched.any() else None, touched)

    def contact(self, look: Deformed) -> Contact | None:
        """Return the forces behind a deformation; None without contact.

        Raises:
            ConvergenceError: The gel collapses under it.
        """
        if look.moved is None:
            return None
        # Slopes leave depth's constant open, and where nothing is touched the gel moves too.
        noise = float(self.options.noise_mm)
        return self.model.smooth_forces(look.moved, noise, look.touched, tilted=True)

    def _moved(self, places_px: np.ndarray, height: Height) -> Float[np.ndarray, "k 3"]:
        """How the gel's nodes moved: along the face as markers tell, across it as depth does."""
        points, told = displacement_mm(self.sensor, self.tracker.begin, places_px, height.height_mm)
        nodes = self.model.points
        found, _ = carry_displacements(points, told, nodes, _OUT)
        now = nodes[:, :2] + np.nan_to_num(found[:, :2])
        risen = self._at(height.free_mm, now)
        found[:, 2] = risen + self.sensor.gel.height_mm(now) - nodes[:, 2]
        found[np.isnan(found[:, 0])] = np.nan  # beyond the markers nothing is known along the face
        return found

    def _touched(self, height: Height, moved: Float[np.ndarray, "k 3"]) -> Bool[np.ndarray, " k"]:
        sizes = [max(1, round(float(self.options.around_mm) / size)) for size in self.mm_per_px]
        rows, columns = np.mgrid[-sizes[1] : sizes[1] + 1, -sizes[0] : sizes[0] + 1]
        disc = (rows / sizes[1]) ** 2 + (columns / sizes[0]) ** 2 <= 1
        wide = binary_dilation(height.contact, disc).astype(float)
        now = self.model.points[:, :2] + np.nan_to_num(moved[:, :2])
        return np.asarray(np.nan_to_num(self._at(wide, now)) > 0.5)

    def _at(
        self, field: Float[np.ndarray, "h w"], places_mm: Float[np.ndarray, "k 2"]
    ) -> Float[np.ndarray, " k"]:
        """Values of the image's pixels at places; NaN outside the image."""
        columns, rows = self.sensor.to_px(places_mm).T
        return map_coordinates(field, [rows, columns], order=1, cval=np.nan)


def _check_sizes(sensor: SensorDescription, calibration: Calibration, reference: Image) -> None:
    for name, image in (("reference", reference), ("calibration", calibration.reference)):
        if image.shape[:2] != sensor.shape:
            raise ConfigError(
                f"the {name} is of images of {image.shape[1]} x {image.shape[0]} px, but those of"
                f" the sensor '{sensor.name}' are {sensor.shape[1]} x {sensor.shape[0]}; give that"
                " of this sensor."
            )
    told = np.array(sensor.mm_per_px, dtype=float)
    if np.abs(np.array(calibration.mm_per_px) / told - 1).max() > _SCALE_OFF:
        raise ConfigError(
            f"the sensor '{sensor.name}' was calibrated with mm_per_px={calibration.mm_per_px}, its"
            f" description has {tuple(told.tolist())}; calibrate again, or correct one of them."
        )
