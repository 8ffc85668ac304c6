"""Probes, gels of sensors, data that are not of nodes, and correlated errors of a press."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from tactorch.errors import RecordingError
from tactorch.recording.arrays import make_array, require_finite

if TYPE_CHECKING:
    from tactorch.fem.contact import Probe

_ORTHONORMAL = 1e-5  # error of the products of the columns of a rotation
_RESOLUTION = 1e-3  # of a depth, over the largest distance within a probe


@dataclass(frozen=True, eq=False)
class ProbePose:
    """A rigid probe at a prescribed pose, in the axes of the mesh.

    Attributes:
        probe: The probe, such as `tactorch.fem.contact.Ball`.
        position_mm: Its position, (3,), mm: of a ball the centre.
        rotation: Rotation from the axes of the probe to those of the mesh, (3, 3); none by
            default. The probe pushes along its -z axis.
        deviation_mm: Standard deviation of the position along the push, mm, common to the presses
            of a place.

    Raises:
        RecordingError: A value is not finite, `rotation` is not a rotation, or `deviation_mm` is
            negative.
    """

    probe: "Probe"
    position_mm: Float[np.ndarray, "3"]
    rotation: Float[np.ndarray, "3 3"] = field(default_factory=lambda: np.eye(3))
    deviation_mm: float = 0.0

    def __post_init__(self) -> None:
        if not (np.isfinite(self.deviation_mm) and self.deviation_mm >= 0.0):
            raise RecordingError(
                f"probe: deviation_mm is {self.deviation_mm}; give a standard deviation of at "
                "least 0 mm"
            )
        _set(self, "probe", position_mm=(3,), rotation=(3, 3))
        errors = np.abs(self.rotation @ self.rotation.T - np.eye(3))
        if errors.max() > _ORTHONORMAL or np.linalg.det(self.rotation) < 0.0:
            raise RecordingError("probe: rotation is not a rotation; give an orthonormal matrix")

    def distances(self, points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        """Return the signed distances of points (mm) from the probe, negative within it."""
        import torch

        local = torch.from_numpy((points - self.position_mm) @ self.rotation)
        sizes = torch.tensor(self.probe.sizes, dtype=torch.float64)
        distances: np.ndarray = self.probe.distance(local, sizes).numpy()
        return distances

    def depths(self, points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        """Return how far points (mm) must move along the push to leave the probe; 0 outside it.

        By sphere tracing (J. C. Hart, The Visual Computer 12, 1996, p. 527), to a thousandth of
        the largest depth.
        """
        push, depths = -self.rotation[:, 2], np.zeros(len(points))
        inside = np.flatnonzero(self.distances(points) < 0.0)
        resolution = -_RESOLUTION * float(self.distances(points[inside]).min(initial=0.0))
        while len(inside):
            distances = self.distances(points[inside] + depths[inside, None] * push)
            still = distances < 0.0
            inside, distances = inside[still], distances[still]
            depths[inside] += np.maximum(-distances, resolution)
        return depths


@dataclass(frozen=True, eq=False)
class ForceReading:
    """Measured components of the force and moment on the probe, in the axes of the mesh.

    Without a probe they are those on the fixed nodes whose prescribed displacement is not zero.

    Attributes:
        axes: Components, (k, 6); each row has the weights of the force (N) and of the moment about
            `about_mm` (N mm).
        values: Measured components, (k,), N or N mm.
        deviations: Standard deviations of their noise, (k,), N or N mm.
        about_mm: Point of the moment, (3,), mm; the origin by default.

    Raises:
        RecordingError: Shapes differ, a value is not finite, or a deviation is not positive.
    """

    axes: Float[np.ndarray, "k 6"]
    values: Float[np.ndarray, " k"]
    deviations: Float[np.ndarray, " k"]
    about_mm: Float[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        count = len(np.atleast_1d(self.values))
        _set(self, "force", axes=(count, 6), values=(count,), deviations=(count,), about_mm=(3,))
        _require_deviations(self.deviations, "force")
        if not self.axes.any(axis=1).all():
            raise RecordingError("force: axes has a row of zeros; give the measured components")

    @staticmethod
    def along(
        direction: Sequence[float] | Float[np.ndarray, "3"], value_n: float, deviation_n: float
    ) -> "ForceReading":
        """Return the reading of a load cell that measures the force along one direction."""
        axes = np.zeros((1, 6))
        axes[0, :3] = direction
        return ForceReading(axes, np.array([value_n]), np.array([deviation_n]))

    @staticmethod
    def vector(
        force_n: Sequence[float] | Float[np.ndarray, "3"], deviation_n: float
    ) -> "ForceReading":
        """Return the reading of a sensor that measures the three components of the force."""
        values = np.array(force_n, dtype=np.float64)
        return ForceReading(np.eye(3, 6), values, np.full(3, deviation_n))


@dataclass(frozen=True, eq=False)
class SurfaceReading:
    """Measured displacements along given directions at any points of the surface.

    A depth along the normal is one; at points between nodes the displacement is interpolated.

    Attributes:
        points_mm: Rest positions, (k, 3), mm; the nearest points of the surface are taken.
        directions: Unit vectors, (k, 3).
        displacement_mm: Measured displacements along them, (k,), mm.
        deviations_mm: Standard deviations of their noise, (k,), mm.

    Raises:
        RecordingError: Shapes differ, a value is not finite, a direction has not unit length, or a
            deviation is not positive.
    """

    points_mm: Float[np.ndarray, "k 3"]
    directions: Float[np.ndarray, "k 3"]
    displacement_mm: Float[np.ndarray, " k"]
    deviations_mm: Float[np.ndarray, " k"]

    def __post_init__(self) -> None:
        count = len(np.atleast_1d(self.displacement_mm))
        shapes = {"points_mm": (count, 3), "directions": (count, 3)}
        _set(self, "surface", **shapes, displacement_mm=(count,), deviations_mm=(count,))
        _require_deviations(self.deviations_mm, "surface")
        lengths = np.linalg.norm(self.directions, axis=1)
        if (np.abs(lengths - 1.0) > 1e-6).any():
            worst = int(np.abs(lengths - 1.0).argmax())
            raise RecordingError(
                f"surface: directions[{worst}] has length {lengths[worst]:g}; give unit vectors"
            )


@dataclass(frozen=True, eq=False)
class PressErrors:
    """Correlated errors of the recorded forces and displacements of a press.

    Forces that are computed from displacements, as those of the gel of a sensor, have errors that
    follow from those of the displacements. The recorded values are the true ones plus a sum of
    patterns, each multiplied by an independent standard normal number.

    Attributes:
        nodes: Numbers of the nodes of the patterns, (l,).
        forces: Errors of the nodal forces, (q, l, 3), N.
        displacement: Errors of the displacements of the nodes, (q, l, 3), mm; those of components
            that are not observed are ignored.

    Raises:
        RecordingError: Shapes differ, a value is not finite, or nodes are negative or repeated.
    """

    nodes: Int[np.ndarray, " l"]
    forces: Float[np.ndarray, "q l 3"]
    displacement: Float[np.ndarray, "q l 3"]

    def __post_init__(self) -> None:
        nodes = make_array(self.nodes, (None,), "errors: nodes", "iu").astype(np.int64)
        object.__setattr__(self, "nodes", nodes)
        shape = (len(np.atleast_1d(self.forces)), len(nodes), 3)
        for name in ("forces", "displacement"):
            array = make_array(getattr(self, name), shape, f"errors: {name}")
            require_finite(array, f"errors: {name}")
            object.__setattr__(self, name, array)
        if len(nodes) and (nodes.min() < 0 or len(np.unique(nodes)) < len(nodes)):
            raise RecordingError(
                "errors: nodes has a negative or repeated number; give each node of the mesh once"
            )

    @property
    def total_force_covariance(self) -> Float[np.ndarray, "3 3"]:
        """Covariance of the sum of the nodal forces, (3, 3), N^2."""
        totals = self.forces.sum(axis=1)
        return totals.T @ totals


@dataclass(frozen=True, eq=False)
class GelReading:
    """A gel that is pressed on the object, and what its markers show.

    Vectors and positions are in the frame of the sensor, whose origin is the centre of the gel's
    face at rest and whose z axis points to the object. In a grasp an equal gel is on the other side
    of the object, which is free between them.

    Attributes:
        layer: Thickness (mm), Young's modulus (MPa), Poisson's ratio, width and height of a
            rectangular outline, radius of a round one, and radius of curvature of the face (mm);
            NaN for those it does not have. See `tactorch.sensor.description.GelLayer.of_numbers`.
        pose: T_object_sensor in this press, (4, 4), mm.
        first_pose: T_object_sensor at first contact, from which points of gel and object that
            touch do not slip, (4, 4), mm.
        markers_mm: Rest positions of the markers, (k, 2), mm; none where the force of the press is
            measured.
        displacement_mm: Their displacements along x and y, (k, 2), mm.
        deviations_mm: Standard deviations of these, (k,), mm.
        uncertain: Standard deviations of errors that presses have in common: of the logarithm of
            the gel's modulus, and of position (mm) and turn (rad) of the pose of a contact.
        opposed: Distance of the faces of both gels of a grasp at first contact, mm, and how much
            farther apart they are in the press for each unit of the logarithm of the gels' modulus
            where a calibration depends on it, mm; NaN where there is one gel. Both move by as much
            from first contact.

    Raises:
        RecordingError: Shapes differ, a value is not finite, or a deviation is negative.
    """

    layer: Float[np.ndarray, "7"]
    pose: Float[np.ndarray, "4 4"]
    first_pose: Float[np.ndarray, "4 4"]
    markers_mm: Float[np.ndarray, "k 2"]
    displacement_mm: Float[np.ndarray, "k 2"]
    deviations_mm: Float[np.ndarray, " k"]
    uncertain: Float[np.ndarray, "3"]
    opposed: Float[np.ndarray, "2"] = field(default_factory=lambda: np.full(2, np.nan))

    def __post_init__(self) -> None:
        count = len(np.atleast_1d(self.markers_mm))
        shapes = {
            "markers_mm": (count, 2),
            "displacement_mm": (count, 2),
            "deviations_mm": (count,),
        }
        if count:
            _set(self, "gel", **shapes)
        for name, shape in shapes.items():
            object.__setattr__(self, name, make_array(getattr(self, name), shape, f"gel: {name}"))
        _set(self, "gel", pose=(4, 4), first_pose=(4, 4), uncertain=(3,))
        _require_deviations(self.deviations_mm, "gel")
        for name, length in (("layer", 7), ("opposed", 2)):
            array = make_array(getattr(self, name), (length,), f"gel: {name}")
            object.__setattr__(self, name, array)
        self._check_opposed()
        require_finite(self.layer[:3], "gel: thickness, Young's modulus and Poisson's ratio")
        if (self.uncertain < 0.0).any():
            raise RecordingError(
                f"gel: uncertain has {self.uncertain.min():g}; give standard deviations of at "
                "least 0"
            )

    def _check_opposed(self) -> None:
        both = np.isfinite(self.opposed)
        if both.any() and not (both.all() and self.opposed[0] > 0.0):
            raise RecordingError(
                f"gel: opposed is {self.opposed.tolist()}; give a positive distance and its change,"
                " or NaN for both"
            )

    @property
    def is_grasp(self) -> bool:
        """Whether a second gel is on the other side of the object."""
        return bool(np.isfinite(self.opposed[0]))


def _set(reading: object, what: str, **shapes: tuple[int, ...]) -> None:
    """Convert and check the arrays of a reading."""
    for name, shape in shapes.items():
        array = make_array(getattr(reading, name), shape, f"{what}: {name}")
        require_finite(array, f"{what}: {name}")
        if not len(array):
            raise RecordingError(f"{what}: {name} is empty; leave the reading out")
        object.__setattr__(reading, name, array)


def _require_deviations(values: Float[np.ndarray, " k"], what: str) -> None:
    if (values <= 0.0).any():
        raise RecordingError(
            f"{what}: a standard deviation is {values.min():g}; give positive ones, of the "
            "instrument's noise"
        )
