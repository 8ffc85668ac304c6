"""Contacts from frames: markers and depth, deformation of the gel, forces.

A sensor without markers measures depth only. Contact then is taken as frictionless: forces are
along z, and tangential components are unknown (NaN).
"""

from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import binary_dilation, map_coordinates

from tactorch.config import Options, option
from tactorch.errors import ConfigError
from tactorch.sensor.calibration import Calibration
from tactorch.sensor.contact import interpolate_displacements
from tactorch.sensor.contact_edge import common_edge, image_edge
from tactorch.sensor.depth import MIN_SLOPE, HeightMap
from tactorch.sensor.description import SensorDescription
from tactorch.sensor.frames import Frame, Image
from tactorch.sensor.gel import (
    EdgeDistance,
    FaceData,
    ForceOptions,
    ForceSolver,
    GelContact,
    GelModel,
    RefinedGel,
)
from tactorch.sensor.markers import (
    MarkerTracker,
    TrackOptions,
    marker_appearance,
    marker_displacements,
)

_AXIS = np.array([0.0, 0.0, 1.0])
_MAX_SCALE_ERROR = 0.02  # between calibration and description


@dataclass(frozen=True)
class DepthOptions(Options):
    """Detection of contact from depth."""

    min_depth_mm: float = option(
        0.03, "Depth below which a frame is without contact", unit="mm", gt=0
    )
    min_slope: float = option(
        MIN_SLOPE, "Slope above which the face is deformed; smaller for wide, flat objects", gt=0
    )
    depth: Literal["lookup", "fit"] = option(
        "lookup",
        "Height by integrated slopes (lookup), or by fitting rendered colours too (fit), for a"
        " calibration with camera=true",
    )


@dataclass(frozen=True)
class ChainOptions(ForceOptions, DepthOptions):
    """Processing of frames to contacts."""

    noise_mm: float = option(
        0.01, "Standard deviation of the displacements from markers and depth", unit="mm", gt=0
    )
    marker_noise_mm: float = option(
        0.002, "Standard deviation of the displacements of markers, with contact_edge_mm",
        unit="mm", gt=0,
    )  # fmt: skip
    margin_mm: float = option(
        0.5, "Margin by which the contact region from depth is widened", unit="mm", gt=0
    )
    contact_edge_mm: float | None = option(
        None, "Edge length of the gel's elements at the edge of each contact, for accurate forces"
        " in 10 to 60 s a frame; null: the mesh of the gel",
        unit="mm", gt=0,
    )  # fmt: skip
    track: TrackOptions = option(factory=TrackOptions, help="Tolerances of marker tracking")


class ContactView(NamedTuple):
    """What an image shows of a contact, for a gel that is refined at its edge.

    Attributes:
        pixels: Pixels in contact.
        markers_mm: Rest positions of the markers, mm.
        in_plane_mm: Their displacements along x and y, mm; NaN for markers not seen.
    """

    pixels: Bool[np.ndarray, "h w"]
    markers_mm: Float[np.ndarray, "n 2"]
    in_plane_mm: Float[np.ndarray, "n 2"]


@dataclass(frozen=True, eq=False)
class Measurement:
    """Measured state of the gel in a frame.

    Attributes:
        frame: Frame.
        markers_px: Markers in the reference's order (column, row); NaN for markers not seen, none
            for a sensor without markers.
        in_contact: Nodes of the gel's face in contact.
        height: Height map of the face; None without an image.
        depth_mm: Depth of the face; NaN without an image.
        max_slope: Largest slope of the face; NaN without an image.
        displacement: Displacements of the nodes of the gel's face, mm, NaN where unknown: along
            x and y everywhere for a sensor without markers; None without contact.
        contact: Forces and displacements of the gel's face; None without contact, or before
            `SensorChain.solve_contact`.
        view: What the image shows of the contact; None without contact, or without the option
            `contact_edge_mm`.
        light_error_mm: Error of the depth from a change of the light.
    """

    frame: Frame
    markers_px: Float[np.ndarray, "n 2"]
    in_contact: Bool[np.ndarray, " k"]
    height: HeightMap | None = None
    depth_mm: float = np.nan
    max_slope: float = np.nan
    displacement: Float[np.ndarray, "k 3"] | None = None
    contact: GelContact | None = None
    view: ContactView | None = None
    light_error_mm: float = 0.0


class SensorChain:
    """Processing chain of a calibrated sensor, frame by frame.

    The `reference` is the image of the gel without contact; the model of the gel has cells of 1 mm
    unless one is given.

    Attributes:
        tracker: Tracker of the markers; None for a sensor without markers.
        forces: Solver for the forces.

    Raises:
        ConfigError: The reference shows too few markers, or the image size or scale differs between
            sensor, calibration and reference.
    """

    def __init__(
        self,
        sensor: SensorDescription,
        calibration: Calibration,
        reference: Image,
        model: GelModel | None = None,
        options: ChainOptions | None = None,
    ) -> None:
        _check_consistency(sensor, calibration, reference)
        self.sensor, self.calibration, self.reference = sensor, calibration, reference
        self.model = model or GelModel(sensor.gel)
        self.options = options or ChainOptions()
        self.forces = ForceSolver(self.model, self.options)
        self.tracker: MarkerTracker | None = None
        if (expected := marker_appearance(sensor)) is not None:
            appearance = calibration.markers or expected
            self.tracker = MarkerTracker(reference, appearance, self.options.track)

    def measure(self, frame: Frame) -> Measurement:
        """Return the measurement of the next frame, including forces; no contact without an image.

        Raises:
            ConfigError: The frame has another size than the reference.
            ConvergenceError: No contact has these deformations; see `ForceSolver.solve`.
        """
        measurement = self.measure_deformation(frame)
        return replace(measurement, contact=self.solve_contact(measurement))

    def measure_deformation(self, frame: Frame) -> Measurement:
        """Track the markers into the next frame and measure the deformation, without forces."""
        no_markers = np.zeros((0, 2))
        markers_px = no_markers if self.tracker is None else self.tracker.track(frame.image)
        tracked = "" if self.tracker is None else self.tracker.fault
        found = Measurement(frame, markers_px, np.zeros(len(self.model.points), dtype=bool))
        if frame.image is None:
            return found
        height = self.calibration.height(
            frame.image,
            self.reference,
            depth=self.options.depth,
            min_slope=self.options.min_slope,
            mm_per_px=self.sensor.mm_per_px,
        )
        depth_mm, max_slope = height.depth_mm, height.max_slope
        frame = frame.with_faults(tracked, "" if height.light is None else height.light.fault)
        found = replace(found, frame=frame, height=height, depth_mm=depth_mm, max_slope=max_slope)
        found = replace(found, light_error_mm=height.light_error_mm)
        if depth_mm < self.options.min_depth_mm:
            return found
        displacement = self._face_displacement(markers_px, height)
        in_contact = self._contact_nodes(height, displacement)
        if not in_contact.any():
            return found
        view = None
        if self.options.contact_edge_mm is not None and self.tracker is not None:
            at, moved = marker_displacements(
                self.sensor, self.tracker.reference_px, markers_px, height.height_mm
            )
            view = ContactView(height.contact, at[:, :2], moved[:, :2])
        return replace(found, displacement=displacement, in_contact=in_contact, view=view)

    def solve_contact(
        self, measurement: Measurement, outline: EdgeDistance | None = None
    ) -> GelContact | None:
        """Return the contact forces behind a measured deformation; None without contact.

        `outline` is the distance from the outline of the object; None where its shape is unknown.
        """
        if measurement.displacement is None:
            return None
        if measurement.view is not None:
            return self._solve_refined(measurement, measurement.view, outline)
        known, in_contact = measurement.displacement, measurement.in_contact
        noise_mm = float(np.hypot(self.options.noise_mm, measurement.light_error_mm))
        # Slopes determine depth up to a constant, and the gel also moves outside the contact.
        return self.forces.solve(known, noise_mm, in_contact, free_plane=True)

    def _solve_refined(
        self, measurement: Measurement, view: ContactView, outline: EdgeDistance | None
    ) -> GelContact:
        """Contact forces by a gel that is refined at the edge of the contact."""
        known, points, options = measurement.displacement, self.model.points, self.options
        assert known is not None
        assert options.contact_edge_mm is not None
        noise_mm = float(np.hypot(options.noise_mm, measurement.light_error_mm))
        edge = image_edge(self.sensor, view.pixels, points, known, options.margin_mm)
        edge = edge if outline is None else common_edge(edge, outline)
        data = FaceData.of(
            view.markers_mm, view.in_plane_mm, options.marker_noise_mm,
            points[:, :2], known[:, 2], noise_mm,
        )  # fmt: skip
        gel = RefinedGel(self.model, edge, options.contact_edge_mm)
        return gel.solve(data.with_depth_errors(edge, gel.edge_mm), free_plane=True)

    def _face_displacement(self, markers_px: np.ndarray, height: HeightMap) -> np.ndarray:
        """Displacements of the gel's nodes: in the plane from markers, along z from depth."""
        nodes = self.model.points
        if self.tracker is None:
            rise = self._sample(height.zero_mean_mm, nodes[:, :2])
            return np.column_stack([np.full((len(nodes), 2), np.nan), rise])
        points, in_plane = marker_displacements(
            self.sensor, self.tracker.reference_px, markers_px, height.height_mm
        )
        displacement = interpolate_displacements(points, in_plane, nodes, _AXIS)
        current = nodes[:, :2] + np.nan_to_num(displacement[:, :2])
        rise = self._sample(height.zero_mean_mm, current)
        displacement[:, 2] = rise + self.sensor.gel.height_mm(current) - nodes[:, 2]
        displacement[np.isnan(displacement[:, 0])] = np.nan  # outside the hull of the markers
        return displacement

    def _contact_nodes(self, height: HeightMap, displacement: np.ndarray) -> np.ndarray:
        """Nodes of the gel's face in the widened contact region."""
        radii = [max(1, round(self.options.margin_mm / size)) for size in self.sensor.mm_per_px]
        rows, columns = np.mgrid[-radii[1] : radii[1] + 1, -radii[0] : radii[0] + 1]
        disc = (rows / radii[1]) ** 2 + (columns / radii[0]) ** 2 <= 1
        widened = binary_dilation(height.contact, disc).astype(float)
        current = self.model.points[:, :2] + np.nan_to_num(displacement[:, :2])
        return np.asarray(np.nan_to_num(self._sample(widened, current)) > 0.5)

    def _sample(self, field: np.ndarray, positions_mm: np.ndarray) -> np.ndarray:
        """Interpolate an image at positions; NaN outside the image."""
        columns, rows = self.sensor.to_px(positions_mm).T
        return map_coordinates(field, [rows, columns], order=1, cval=np.nan)


def _check_consistency(
    sensor: SensorDescription, calibration: Calibration, reference: Image
) -> None:
    for name, image in (("reference", reference), ("calibration", calibration.reference)):
        if image.shape[:2] != sensor.shape:
            raise ConfigError(
                f"the {name} is of images of {image.shape[1]} x {image.shape[0]} px, but those of"
                f" the sensor '{sensor.name}' are {sensor.shape[1]} x {sensor.shape[0]}; give that"
                " of this sensor."
            )
    ratio = np.array(calibration.mm_per_px) / np.array(sensor.mm_per_px)
    if np.abs(ratio - 1).max() > _MAX_SCALE_ERROR:
        raise ConfigError(
            f"the sensor '{sensor.name}' was calibrated with mm_per_px={calibration.mm_per_px}, its"
            f" description has {sensor.mm_per_px}; calibrate again, or correct one of them."
        )
