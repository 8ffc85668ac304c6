"""Presses from the frames of a contact, and the pose of the sensor at first contact.

On an object of known shape, points of the object move with the gel from where it meets them by the
poses. Otherwise gel and object move together from the first pose on, whose error adds to the
object's displacements.
"""

import logging
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from jaxtyping import Float, Int

from tactorch.config import Options, option
from tactorch.errors import ConfigError, ConvergenceError
from tactorch.mesh import FACE_NAMES, TetMesh, face_nodes
from tactorch.mesh.quadrature import lattice
from tactorch.recording import GelReading, Press
from tactorch.sensor.chain import Measurement, SensorChain
from tactorch.sensor.contact import MIN_FACING, ContactOptions, build_press
from tactorch.sensor.contact_edge import surface_edge
from tactorch.sensor.description import GelLayer
from tactorch.sensor.gel import EdgeDistance, GelContact
from tactorch.sensor.markers import marker_displacements
from tactorch.sensor.poses import Pose, Poses, transform_points
from tactorch.sensor.recorder.detector import ContactInterval
from tactorch.sensor.recorder.objects import VirtualCube

_log = logging.getLogger(__name__)
_MIN_ALIGNMENT = np.sqrt(0.5)  # cosine between a side's normal and the press direction
_FLATNESS = 2e-3  # of a side, over the object's diagonal
_BISECTIONS = 30
_POINT_SPACING_MM = 0.5  # on the object's face
_LAW = "neo_hookean"  # of gels that are solved together with the object
# Error of the displacement of a marker in contact over itself: of the finite elements of gel and
# object, simulated, and of the scale. That of the marker in the image, simulated, does not grow.
_MARKER_ERROR, _MIN_MARKER_NOISE_MM = 0.005, 3e-4
_MAX_GAP_MM = 0.5  # at the first frame with contact, without a warning


@dataclass(frozen=True)
class Fixture(Options):
    """Support of the object."""

    held_side: Literal["opposite", "x-", "x+", "y-", "y+", "z-", "z+"] = option(
        "opposite", "Flat side that is held; opposite: the side opposite to each press"
    )
    held_by: Literal["fixed", "springs"] = option("fixed", "Fixed nodes, or a spring on each node")
    spring_n_per_mm: float = option(1.0, "Stiffness of each spring", unit="N/mm", gt=0)

    def supports(self, mesh: TetMesh, direction: Float[np.ndarray, "3"]) -> dict[str, Any]:
        """Return the fields of a `Press` along `direction` that support the object."""
        opposite = self.held_side == "opposite"
        nodes = opposite_nodes(mesh, direction) if opposite else face_nodes(mesh, self.held_side)
        held = np.zeros(mesh.points.shape, dtype=bool)
        held[nodes] = True
        return {self.held_by: held if self.held_by == "fixed" else held * self.spring_n_per_mm}


def opposite_nodes(mesh: TetMesh, direction: Float[np.ndarray, "3"]) -> Int[np.ndarray, " k"]:
    """Nodes of the flat side of the object opposite to a press."""
    surface, position = mesh.surface, mesh.points @ direction
    distance = (position.max() - position[surface.triangles]).max(axis=1)
    aligned = np.asarray(surface.normals @ direction > _MIN_ALIGNMENT)
    selected = aligned & (distance <= _FLATNESS * mesh.diagonal)
    if not selected.any():
        raise ConfigError(
            "the object has no flat side opposite to a press along"
            f" {np.round(direction, 3).tolist()}; name the supported side: held_side="
            f"{', '.join(FACE_NAMES)}."
        )
    return np.unique(surface.triangles[selected])


@dataclass(frozen=True)
class RecordOptions(Fixture, ContactOptions):
    """Conversion of a session of frames to presses."""

    steps: int = option(3, "Frames of each contact that become presses, evenly in depth", ge=1)
    min_frames: int = option(1, "Contacts of fewer frames are ignored", ge=1)
    first_contact: Literal["shape", "depth"] = option(
        "shape",
        "Pose of first contact; shape: where gel and object meet by their poses; depth:"
        " extrapolated from the first frames, for unknown shapes",
    )
    press_noise_mm: float | None = option(
        None, "Standard deviation of the displacements; null: the larger of noise_mm and the noise"
        " of frames without contact",
        unit="mm", gt=0,
    )  # fmt: skip
    gel_deviation: float = option(
        0.05, "Standard deviation of the gel's Young's modulus, relative: that of its calibration",
        ge=0, le=1,
    )  # fmt: skip
    pose_mm: float = option(
        0.02, "Standard deviation of the sensor's position relative to the object, common to a"
        " contact", unit="mm", ge=0,
    )  # fmt: skip
    pose_deg: float = option(
        0.1, "Standard deviation of the sensor's orientation, the same way", unit="deg", ge=0
    )


class PressBuilder:
    """Builder of presses from the frames of contacts.

    The `mesh` of a virtual cube is placed under the first contact, and None before.
    """

    def __init__(
        self, chain: SensorChain, target: TetMesh | VirtualCube, options: RecordOptions
    ) -> None:
        self.chain, self.target, self.options = chain, target, options
        self.mesh = target if isinstance(target, TetMesh) else None
        if options.untouched == "auto" and self.mesh is None:
            self.options = replace(options, untouched="sensor")

    def build(
        self, contact: ContactInterval, number: int, poses: Poses, measured_noise_mm: float | None
    ) -> Iterator[tuple[Measurement, Press | ConfigError | ConvergenceError]]:
        """Yield the measurement of each selected frame with its press, or with the error.

        `number` counts contacts from 1, for the names of the presses. `measured_noise_mm` is that
        of frames without contact.
        """
        free_s, times_s, depths_mm = contact.free_s, contact.times_s, contact.depths_mm
        if isinstance(self.target, TetMesh) and self.options.first_contact == "shape":
            gel = self.chain.sensor.gel
            first_pose = first_pose_by_shape(poses, free_s, times_s[0], self.target, gel)
        else:
            first_pose = first_pose_by_depth(poses, free_s, times_s, depths_mm)
        if isinstance(self.target, VirtualCube) and self.mesh is None:
            deepest = contact.measurements[int(np.argmax(depths_mm))]
            center_mm = self.chain.model.points[deepest.in_contact, :2].mean(axis=0)
            self.mesh = self.target.mesh_under(first_pose, center_mm)
        assert self.mesh is not None
        step, outline, apart_mm = 0, self._outline(first_pose), self._apart_mm(first_pose)
        for index in contact.select_frames(self.options.steps):
            measurement, pose = contact.measurements[index], poses.at([times_s[index]])[0]
            name = measurement.frame.name
            try:
                forces = self.chain.solve_contact(measurement, outline)
                assert forces is not None
                in_contact = measurement.in_contact
                if forces.in_contact is not None:
                    in_contact = forces.in_contact
                press = build_press(
                    forces, pose, first_pose, self.mesh, in_contact,
                    options=self.options, step=step, apart_mm=apart_mm,
                    noise_mm=self._noise_mm(
                        forces, measured_noise_mm, measurement.light_error_mm
                    ),
                    name=f"contact {number}, {name}",
                    gel=self._gel(
                        measurement, contact.rest_mm, pose, first_pose, measured_noise_mm
                    ),
                    **self.options.supports(self.mesh, pose[:3, 2]),
                )  # fmt: skip
            except (ConfigError, ConvergenceError) as error:
                _log.warning("Frame '%s' is skipped: %s", name, error)
                yield measurement, error
            else:
                step += 1
                yield measurement, press

    def _apart_mm(self, first_pose: Pose) -> float | None:
        """Return the distance of gel and object in the pose of first contact, see `build_press`."""
        if not isinstance(self.target, TetMesh):
            return None
        gap = axial_gap(first_pose, *sample_surface(self.target), self.chain.sensor.gel)
        if not np.isfinite(gap):
            return 0.0
        return gap if self.options.first_contact == "depth" else max(gap, 0.0)

    def _noise_mm(
        self, forces: GelContact, measured_mm: float | None, light_error_mm: float
    ) -> float:
        """Standard deviation of the displacements of a press, besides errors that are given."""
        if self.options.press_noise_mm is not None:
            return self.options.press_noise_mm
        if forces.errors is not None:
            return self.chain.options.marker_noise_mm
        noise_mm = max(self.chain.options.noise_mm, measured_mm or 0.0)
        return float(np.hypot(noise_mm, light_error_mm))

    def _gel(
        self,
        measurement: Measurement,
        rest_mm: Float[np.ndarray, "n 2"] | None,
        pose: Pose,
        first_pose: Pose,
        noise_mm: float | None,
    ) -> GelReading | None:
        """Return the gel and its markers; None where it is not known where it touches the object.

        Displacements of the markers are those from frames without contact, `rest_mm`, which are
        more, and closer in time, than the reference image.

        That is without markers, on an object of unknown shape, with a limit of friction, and for
        gels of a law for which objects are not solved together with them.
        """
        tracker, options = self.chain.tracker, self.options
        unknown = not isinstance(self.target, TetMesh) or options.friction is not None
        if tracker is None or unknown or self.chain.sensor.gel.material != _LAW:
            return None
        at, moved = marker_displacements(
            self.chain.sensor, tracker.reference_px, measurement.markers_px
        )
        if rest_mm is not None:
            moved[:, :2] -= rest_mm
        seen = np.isfinite(moved).all(axis=1) & self.chain.sensor.gel.covers(at[:, :2])
        if not seen.any():
            return None
        moved = moved[seen, :2]
        noise = noise_mm or self.chain.options.marker_noise_mm
        noise = max(noise, _MIN_MARKER_NOISE_MM)
        relative = _MARKER_ERROR * np.linalg.norm(moved, axis=1)
        return GelReading(
            self.chain.sensor.gel.numbers, pose, first_pose, at[seen, :2], moved,
            np.hypot(noise, relative),
            np.array([options.gel_deviation, options.pose_mm, np.deg2rad(options.pose_deg)]),
        )  # fmt: skip

    def _outline(self, first_pose: Pose) -> EdgeDistance | None:
        """Distance from the outline of the object under the gel; None if unknown or not needed."""
        if not isinstance(self.target, TetMesh) or self.chain.options.contact_edge_mm is None:
            return None
        surface = self.target.surface
        points = transform_points(np.linalg.inv(first_pose), self.target.points)
        facing = surface.normals @ first_pose[:3, 2] < -MIN_FACING
        level = np.abs(points[surface.triangles, 2].mean(axis=1)) <= self.options.reach_mm
        triangles = surface.triangles[np.asarray(facing & level)]
        return surface_edge(points, triangles) if len(triangles) else None


def first_pose_by_shape(
    poses: Poses, free_s: float | None, contact_s: float, mesh: TetMesh, gel: GelLayer
) -> Pose:
    """Return T_object_sensor at which the gel's face meets the object's, both at rest.

    `free_s` is the time of the last frame without contact, if any, `contact_s` that of the first
    with contact.
    """
    surface = sample_surface(mesh)

    def gap_at(time_s: float) -> float:
        return axial_gap(poses.at([time_s])[0], *surface, gel)

    pose = poses.at([contact_s])[0]
    gap = gap_at(contact_s)
    if gap >= 0:
        if _MAX_GAP_MM < gap < np.inf:
            _log.warning(
                "At %.3f s the images show contact, but by the poses gel and object are %.2f mm"
                " apart: check T_object_sensor and the object's mesh.", contact_s, gap,
            )  # fmt: skip
        return pose
    earlier = [] if free_s is None else [free_s, *poses.time_s[poses.time_s < free_s][::-1]]
    low = next((float(time_s) for time_s in earlier if gap_at(float(time_s)) >= 0), None)
    if low is None:  # without an approach in the poses, retract along the sensor's axis
        retracted = pose.copy()
        retracted[:3, 3] += gap * pose[:3, 2]
        return retracted
    high = contact_s
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if gap_at(middle) >= 0 else (low, middle)
    return poses.at([low])[0]


def first_pose_by_depth(
    poses: Poses,
    free_s: float | None,
    times_s: Float[np.ndarray, " f"],
    depths_mm: Float[np.ndarray, " f"],
) -> Pose:
    """Return the pose at which the depth starts, extrapolated from the first two frames."""
    first = times_s[0]
    earliest = first if free_s is None else free_s
    if len(times_s) < 2 or depths_mm[1] <= depths_mm[0]:
        return poses.at([0.5 * (earliest + first)])[0]
    rate = (depths_mm[1] - depths_mm[0]) / (times_s[1] - times_s[0])
    start = first - depths_mm[0] / rate
    return poses.at([float(np.clip(start, earliest, first))])[0]


def axial_gap(
    pose: Pose, points: Float[np.ndarray, "p 3"], normals: Float[np.ndarray, "p 3"], gel: GelLayer
) -> float:
    """Return the smallest distance along the sensor's axis from gel to object, both at rest, mm.

    It is negative for an overlap, infinite if the gel is not over the object. `points` and their
    outward `normals` are those of `sample_surface`.
    """
    facing = np.asarray(normals @ pose[:3, 2] < -MIN_FACING)
    in_sensor = transform_points(np.linalg.inv(pose), points[facing])
    # A face farther behind than the gel is thick is another part of the object.
    near = gel.covers(in_sensor[:, :2]) & (in_sensor[:, 2] > -gel.thickness_mm)
    if not near.any():
        return np.inf
    return float((in_sensor[near, 2] - gel.height_mm(in_sensor[near, :2])).min())


def sample_surface(mesh: TetMesh) -> tuple[Float[np.ndarray, "p 3"], Float[np.ndarray, "p 3"]]:
    """Return points on the object's surface and the normals at them."""
    surface = mesh.surface
    corners = mesh.points[surface.triangles]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max()
    n = max(2, int(np.ceil(longest / _POINT_SPACING_MM)))
    grid = lattice(n + 1, 0.0, 3)
    points = np.einsum("pc,tcd->tpd", grid, corners).reshape(-1, 3)
    return points, np.repeat(surface.normals, len(grid), axis=0)
