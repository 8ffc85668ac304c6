"""Presses of a tactile sensor, and grasps between two, as equilibria of gels and object.

The window of the gel has a known pose, and the markers on the gel's face show how it is deformed.
Nodal forces are no data: they follow from the equilibrium. The traction, which is singular where
the contact ends, is that of the finite elements of both, see `tactorch.touch.coupled`. The total
force is a datum where it is measured.
"""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from tactorch.errors import ConfigError, ConvergenceError
from tactorch.fem import EquilibriumResult, Newton, Sensitivity, Supports
from tactorch.fem.contact.pair import PairContact, Pairs
from tactorch.fem.linearization import ReadingRates
from tactorch.inverse.data.nuisance import Nuisance
from tactorch.inverse.data.observations import DataModel, Observation
from tactorch.inverse.forward.problem import (
    Changes,
    Columns,
    Evaluation,
    InverseProblem,
    Moduli,
    NodalField,
)
from tactorch.linalg import map_cases
from tactorch.mesh import TetMesh
from tactorch.mesh.closest import closest_points
from tactorch.mesh.refine import Sizing
from tactorch.recording import GelReading, Press, Recording
from tactorch.sensor.description import GelLayer
from tactorch.sensor.gel import GelMesh
from tactorch.sensor.gel.face import edge_sizing
from tactorch.sensor.poses import Pose, transform_points
from tactorch.touch.coupled import Coupled, CoupledState, along_axis, check_material
from tactorch.touch.pairing import Facing, face_each_other

_Data = Float[np.ndarray, " data"]  # of a press, mm or N

_log = logging.getLogger(__name__)
#: Constitutive law of gel and object.
GEL_LAW = "neo_hookean"
_APART = 0.01  # distance of points that touch, over the depth
_RING = 40  # points along half of the shorter side of a gel, around it
_MIN_MARKERS = 6  # within a contact
_DIGITS = 6  # of rest positions (mm) by which markers are the same
# Share of the variance of a marker's error that all presses have in common: that of the marker at
# rest, whose place among the pixels it has in each of them. Half of it in rendered images.
_AT_REST = 0.5
_MAX_TURN = np.deg2rad(1.0)  # of the sensor between first contact and a press


@dataclass(frozen=True, eq=False)
class _Readings:
    """Displacements of the markers, then the measured components of the force on the gel."""

    markers: sp.csr_matrix  # from the displacements of all nodes (flat, mm) to those of markers
    axes: Float[np.ndarray, "k 3"]  # components, in the frame of the sensor
    opposed: Bool[np.ndarray, " p"]  # pairs of another gel
    turn: Float[np.ndarray, "3 3"]  # from the frame of the sensor to that of the object

    def predicted(
        self, contact: PairContact, u: Float[np.ndarray, "nodes 3"]
    ) -> Float[np.ndarray, " data"]:
        """Return the data at displacements (mm)."""
        force = -contact.pair_forces(u)[~self.opposed].sum(axis=0)
        return np.concatenate([self.markers @ u.ravel(), self.axes @ force])

    def rates(self, newton: Newton, result: EquilibriumResult) -> ReadingRates:
        """Return their derivatives by displacements; pairs remain in contact."""
        contact = newton.contact
        assert isinstance(contact, PairContact)
        pairs, springs = contact.pairs, self._springs(contact, result.displacement)
        columns, size = 3 * pairs.discretisation.coupled.ravel(), 3 * pairs.discretisation.n_nodes
        total = [
            np.bincount(columns + i, (springs[:, i, None] * pairs.values).ravel(), minlength=size)
            for i in range(3)
        ]
        return ReadingRates.of_displacements(
            sp.vstack([self.markers, sp.csr_matrix(self.axes @ np.array(total))], format="csr")
        )

    def by_motion(
        self, contact: PairContact, u: Float[np.ndarray, "nodes 3"]
    ) -> Float[np.ndarray, "data 3"]:
        """Return the derivatives by the motions of `CoupledState` at constant displacements."""
        total = np.zeros((3, 3))
        total[2] = -self._springs(contact, u)[:, 2] @ along_axis(contact.pairs.points).T
        return np.concatenate([np.zeros((self.markers.shape[0], 3)), self.axes @ total])

    def _springs(
        self, contact: PairContact, u: Float[np.ndarray, "nodes 3"]
    ) -> Float[np.ndarray, "p 3"]:
        """Stiffness of the pairs of this gel, N/mm."""
        return np.where(self.opposed[:, None], 0.0, contact.springs(u))


@dataclass(frozen=True, eq=False)
class _GelPress:
    """The equilibrium of one press, as `Evaluation` needs it."""

    coupled: Coupled
    state: CoupledState
    readings: _Readings

    @property
    def newton(self) -> Any:
        return self.state.newton

    @property
    def equilibrium(self) -> Any:
        return self.state.result

    def predicted(self, observation: Observation) -> Float[np.ndarray, " data"]:
        return self.readings.predicted(self.state.contact, self.state.displacement)

    def by_motions(self, case: Sensitivity) -> Float[np.ndarray, "data 3"]:
        """Return the changes of the data by motions of the gels, see `CoupledState`."""
        moved = case.linearization.force_response(self.state.motion_forces())
        columns = np.column_stack([case.observe(field) for field in moved])
        return columns + self.readings.by_motion(self.state.contact, self.state.displacement)


class GelEvaluation(Evaluation):
    """All presses of a sensor at one field of moduli of the object."""

    _presses: list[_GelPress]  # type: ignore[assignment]

    def _of_press(self, changes: Changes, number: int) -> Changes:
        return self._presses[number].coupled.body_changes(changes)

    @property
    def on_object(self) -> list[NodalField]:
        """Displacement of the object's nodes in each press, mm, in the frame of the object."""
        return [
            press.state.displacement[press.coupled.body_rows] @ press.readings.turn.T
            for press in self._presses
        ]

    def jacobian(self) -> Float[np.ndarray, "data moduli"]:
        """Return d residuals / d youngs of the object, 1/MPa."""
        cases, data, size = self.sensitivities, self.data.observations, self.youngs.size

        def work(i: int) -> np.ndarray:
            return cases[i].matrix()[:, :size] * data[i].scale[:, None]  # without the gels

        return self._of_residuals(np.concatenate(map_cases(work, len(cases))))

    def log_rates(self) -> Float[np.ndarray, "data m"]:
        """Return the derivatives of the data (mm or N) by the log-modulus of each element."""
        cases, m = self.sensitivities, len(self.youngs)

        def work(i: int) -> np.ndarray:  # without an array of all quadrature points and presses
            rates = cases[i].matrix()[:, : self.youngs.size]
            rates *= self.youngs.ravel()
            return rates.reshape(len(rates), m, -1).sum(axis=2)

        return np.concatenate(map_cases(work, len(cases)))

    def transpose_times(self, weights: Float[np.ndarray, " data"]) -> Moduli:
        """Return the transpose of d residuals / d youngs of the object times `weights`."""
        own, cases = self._split(weights), self.sensitivities
        parts = map_cases(lambda i: cases[i].transpose_times(own[i]), len(cases))
        rows = np.sum([part[: self.youngs.size] for part in parts], axis=0)
        return np.asarray(rows.reshape(self.youngs.shape))

    def uncertain(self, contacts: Sequence[int], readings: Sequence[GelReading]) -> Columns:
        """Return errors that data have in common, each of unit deviation, in deviations of data.

        They are of the modulus of each sensor's gel, on which the distance of two gels may depend,
        and of the position along the axis and the tilts of each contact.

        Args:
            contacts: Contact of each press.
            readings: Gel of each press.
        """
        cases = self.sensitivities

        def work(i: int) -> np.ndarray:
            press, (modulus, position, turn) = self._presses[i], readings[i].uncertain.tolist()
            column, _ = cases[i].times_each(press.coupled.gel_change[None])
            motions = press.by_motions(cases[i])
            if readings[i].is_grasp:  # both move by half of the change of their distance
                column = column - 0.5 * float(readings[i].opposed[1]) * motions[:, :1]
            return np.hstack([modulus * column, motions * [position, turn, turn]])

        parts = map_cases(work, len(cases))
        layers = [reading.layer.tobytes() for reading in readings]
        gels = list(dict.fromkeys(layers))
        columns = np.zeros((len(self.data.values), len(gels) + 3 * (max(contacts) + 1)))
        for i, (begin, part) in enumerate(zip(self._begins, parts, strict=True)):
            rows, first = slice(begin, begin + len(part)), len(gels) + 3 * contacts[i]
            columns[rows, gels.index(layers[i])] = part[:, 0]
            columns[rows, first : first + 3] = part[:, 1:]
        return columns * self.data.scale[:, None]


@dataclass(frozen=True, eq=False)
class _Contact:
    """A contact: gel and object in the pose of first contact."""

    numbers: tuple[int, ...]  # of its presses
    coupled: Coupled
    facing: Facing
    gel: GelMesh
    motions: list[Float[np.ndarray, "3"]]

    def motion(self, number: int) -> Float[np.ndarray, "3"]:
        """Motion of the sensor in a press from first touch, mm."""
        return self.motions[self.numbers.index(number)]


class GelProblem(InverseProblem):
    """Presses of a sensor as an inverse problem for the modulus of the object.

    There are no nuisance parameters: errors of gel and pose are errors of the data, see
    `GelEvaluation.uncertain`.

    Args:
        recording: Presses, all of which have a `gel`.
        youngs_mpa: Typical modulus of the object, MPa.
        cells: Cells of elements across the shorter side of the gel.
        layers: The same through the gel.
        gel_sizing: Longest edges (mm) of the gel's elements at points (mm) in the frame of the
            sensor, for each contact.
        surface: Mesh before a refinement, which adds nodes on its flat triangles; by default that
            of the recording.
        rtol: Residual of equilibria over the forces.

    Attributes:
        data: Displacements of the markers, and the statistics of their errors.
        contact_of: Contact of each press.

    Raises:
        ConfigError: A press has no gel, the gel is over no part of the object, the sensor turns
            during a contact, supports differ along axes, or material or weight are not those for
            which gel and object can be solved together.
    """

    def __init__(
        self,
        recording: Recording,
        youngs_mpa: float,
        *,
        cells: int = 10,
        layers: int = 2,
        gel_sizing: Sequence[Sizing] | None = None,
        surface: TetMesh | None = None,
        rtol: float = 1e-7,
    ) -> None:
        self.recording, self.assumed = recording, Nuisance(recording.material.poisson)
        self.evaluations = 0
        # Pairs of each press that do not slip, by the first evaluation: a set that changes from one
        # evaluation to the next would change the predictions by leaps.
        self._sticking: dict[int, Bool[np.ndarray, " p"]] = {}
        self._last: dict[int, NodalField] = {}  # displacements of `predicted_alone`
        check_material(recording.material, GEL_LAW)
        if recording.density:
            raise ConfigError("the object has weight, which gel and object do not account for.")
        self.readings = [_reading(press) for press in recording.presses]
        groups = _group(recording.presses)
        self.contact_of = [0] * len(recording.presses)
        for k, numbers in enumerate(groups):
            for number in numbers:
                self.contact_of[number] = k
        sizings: Sequence[Sizing | None] = gel_sizing or [None] * len(groups)
        self._touched = [
            _make_contact(recording, numbers, youngs_mpa, (cells, layers), sizing, surface, rtol)
            for numbers, sizing in zip(groups, sizings, strict=True)
        ]
        self.data = DataModel(tuple(_observation(press) for press in recording.presses))
        self._readings_of = [
            _make_readings(self._touched[k], press)
            for k, press in zip(self.contact_of, recording.presses, strict=True)
        ]

    def with_data(self, data: DataModel) -> "GelProblem":
        """Return the problem with other data."""
        problem = super().with_data(data)
        assert isinstance(problem, GelProblem)
        return problem

    def evaluate(
        self,
        youngs: Moduli,
        near: Evaluation | None = None,
        nuisance: Nuisance | None = None,
        take_over: bool = False,
        chained: bool = False,
        starts: Sequence[NodalField | None] | None = None,
    ) -> GelEvaluation:
        """Solve all presses at moduli of the object's quadrature points, MPa.

        Of the other arguments of `InverseProblem.evaluate`, `starts` is used.

        Raises:
            ConvergenceError: a press has no equilibrium; names the press.
        """
        self.evaluations += 1
        count = len(self.readings)
        given = [None] * count if starts is None else list(starts)
        presses: list[Any] = map_cases(lambda i: self._solve(i, youngs, given), count)
        return GelEvaluation(youngs, self.assumed, np.zeros((0, 3)), presses, self.data)

    def take_over(
        self, evaluation: GelEvaluation, numbers: Sequence[int]
    ) -> list[NodalField | None]:
        """Return displacements to start from, those of the same presses of another problem.

        Pairs that stick there stick here. `numbers` are those of the presses there.
        """
        starts = list[NodalField | None]()
        for i, number in enumerate(numbers):
            state, contact = evaluation._presses[number].state, self._touched[self.contact_of[i]]
            own = contact.coupled.contact.pairs
            # Those that may touch depend on the deepest press of a contact.
            if np.array_equal(state.contact.pairs.points, own.points):
                self._sticking[i] = state.contact.sticking
            same = len(state.displacement) == own.discretisation.n_nodes
            starts.append(state.displacement if same else None)
        return starts

    @property
    def marker_errors(self) -> sp.csr_matrix:
        """Errors of unit deviation that presses have in common by their markers at rest.

        They are in deviations of the data, whose white noise is that of the other errors: a column
        for each component of a marker of a sensor.
        """
        keys = [
            (reading.layer.tobytes(), *np.round(marker, _DIGITS), axis)
            for reading in self.readings for marker in reading.markers_mm for axis in (0, 1)
        ]  # fmt: skip
        numbers = {key: column for column, key in enumerate(dict.fromkeys(keys))}
        columns = [numbers[key] for key in keys]
        values = np.full(len(keys), (_AT_REST / (1.0 - _AT_REST)) ** 0.5)
        begins, counts = self.data.begins, [2 * len(r.markers_mm) for r in self.readings]
        rows = [begin + np.arange(n) for begin, n in zip(begins, counts, strict=True)]
        shape = (len(self.data.values), len(numbers))
        return sp.csr_matrix((values, (np.concatenate(rows), columns)), shape)

    def motion(self, number: int) -> Float[np.ndarray, "3"]:
        """Return the motion of the sensor in a press from first touch, in its frame, mm."""
        return self._touched[self.contact_of[number]].motion(number)

    @property
    def deepest_of_contacts(self) -> list[int]:
        """Number of the deepest press of each contact."""
        return [
            max(contact.numbers, key=lambda i: float(self.motion(i)[2]))
            for contact in self._touched
        ]

    @property
    def deepest(self) -> list[tuple[int, float]]:
        """For each press the deepest one of its contact, and its own depth over that one's."""
        last, found = self.deepest_of_contacts, []
        for number, k in enumerate(self.contact_of):
            share = float(self.motion(number)[2] / self.motion(last[k])[2])
            found.append((last[k], min(max(share, 0.0), 1.0)))
        return found

    def predicted_alone(
        self,
        youngs: Moduli,
        numbers: Sequence[int],
        check: Callable[[], None] = lambda: None,
    ) -> dict[int, _Data]:
        """Return the data (mm or N) of some presses by number, without what derivatives need.

        Equilibria are searched from those of the last call. `check` is called before each.
        """
        starts = [self._last.get(i) for i in range(len(self.readings))]

        def predicted(number: int) -> _Data:
            check()
            press = self._solve(number, youngs, starts)
            self._last[number] = press.state.displacement
            press.coupled.forget()
            return press.predicted(self.data.observations[number])

        # Presses of a contact share a solver, which is forgotten: one after the other.
        groups = [[i for i in numbers if i in contact.numbers] for contact in self._touched]
        parts = map_cases(lambda k: {i: predicted(i) for i in groups[k]}, len(groups))
        return {i: data for part in parts for i, data in part.items()}

    def forget(self) -> None:
        """Free solvers that no evaluation uses, which take gigabytes."""
        for contact in self._touched:
            contact.coupled.forget()

    def _solve(self, number: int, youngs: Moduli, starts: Sequence[NodalField | None]) -> _GelPress:
        contact, sticking = self._touched[self.contact_of[number]], self._sticking.get(number)
        moduli, motion = contact.coupled.youngs(youngs), contact.motion(number)
        try:
            state = contact.coupled.solve(moduli, motion, starts[number], sticking)
        except ConvergenceError as error:
            label = self.recording.presses[number].label
            raise ConvergenceError(f"{label} (index {number}): {error}") from error
        self._sticking[number] = state.contact.sticking
        return _GelPress(contact.coupled, state, self._readings_of[number])

    def rims(self, evaluation: GelEvaluation) -> list["Rim"]:
        """Return where the contact ends in each press.

        Raises:
            ConfigError: gel and object are apart in a press; names the press.
        """
        found = []
        for i, press in enumerate(evaluation._presses):
            contact, reading = press.state.contact, self.readings[i]
            # Between meshes that do not match, single points within a contact are just apart.
            least = _APART * float(self.motion(i)[2])
            touching = contact.offsets(press.state.displacement)[:, 2] < least
            if not touching.any():
                label = self.recording.presses[i].label
                raise ConfigError(f"{label}: gel and object are apart; check the pose.")
            owner = self._touched[self.contact_of[i]]
            found.append(Rim.of(owner, contact.pairs, touching, reading.first_pose))
        return found


@dataclass(frozen=True, eq=False)
class Rim:
    """Where the contact of a gel ends, in the plane of its face.

    Attributes:
        inside: Points in contact, (x, y), mm.
        outside: Points of the face that are not, and points around it.
        pose: T_object_sensor at first contact.
        size_mm: Side of a square of the area of the contact, mm.
        layer: The gel.
    """

    inside: cKDTree
    outside: cKDTree
    pose: Float[np.ndarray, "4 4"]
    size_mm: float
    layer: GelLayer

    @staticmethod
    def of(
        contact: "_Contact", pairs: Pairs, touching: Bool[np.ndarray, " p"], pose: Pose
    ) -> "Rim":
        """Return the rim of a contact by the points of the gel's face that touch."""
        inside, facing = cKDTree(pairs.points[touching, :2]), contact.facing
        face = np.concatenate([facing.points, facing.others])[:, :2]
        half = np.array(contact.gel.layer.half_size_mm)
        step = float(half.min()) / _RING
        axes = [np.arange(-h - 2.0 * step, h + 3.0 * step, step) for h in half]
        around = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
        apart = face[inside.query(face)[0] > 1e-6 * step]
        outside = np.concatenate([apart, around[~contact.gel.layer.covers(around)]])
        size = float(np.sqrt(pairs.areas_mm2[touching].sum()))
        return Rim(inside, cKDTree(outside), pose, size, contact.gel.layer)

    def sizing(self, shortest: float) -> Sizing:
        """Return longest edges (mm) at points (mm) of the sensor's frame.

        They grow with the distance from the rim, from `shortest` times the size of the contact.
        """
        return edge_sizing(self.distances, shortest * self.size_mm, self.layer)

    def distances(self, points: Float[np.ndarray, "k 2"]) -> Float[np.ndarray, " k"]:
        """Return the distances of points of the face from the rim, mm."""
        return np.asarray(np.maximum(self.inside.query(points)[0], self.outside.query(points)[0]))

    def on_object(self, sizing: Sizing) -> Sizing:
        """Return the same at points of the frame of the object."""
        inverse = np.linalg.inv(self.pose)
        return lambda points: sizing(transform_points(inverse, points))


def is_of_grasps(recording: Recording) -> bool:
    """Whether forces on gels are measured, and no markers.

    Raises:
        ConfigError: they are in some presses only.
    """
    gels = [press.gel for press in recording.presses]
    without = [gel is not None and not len(gel.markers_mm) for gel in gels]
    if any(without) and not all(without):
        raise ConfigError(
            f"{recording.presses[without.index(True)].label} has a force on a gel, and other "
            "presses have none; give grasps as a separate recording."
        )
    return all(without)


def has_markers(recording: Recording) -> bool:
    """Whether all presses are of a sensor with markers; a warning is logged where some are not."""
    without = [press.label for press in recording.presses if press.gel is None]
    if without and len(without) < len(recording.presses):
        _log.warning(
            "Forces are those of the gel alone: %s and %d others have no markers of a gel.",
            without[0], len(without) - 1,
        )  # fmt: skip
    return not without


def pressed(recording: Recording, youngs_mpa: float) -> tuple[Recording, list[int]]:
    """Return the presses in which, by their poses, gel and object touch, and their numbers."""
    problem = GelProblem(recording, youngs_mpa)
    numbers = [i for i in range(len(recording.presses)) if problem.motion(i)[2] > 0.0]
    presses = tuple(recording.presses[i] for i in numbers)
    return replace(recording, presses=presses, check_units=False), numbers


def within_contacts(
    recording: Recording, rims: Sequence[Rim], margin: float
) -> tuple[Recording, list[int]]:
    """Return the presses with those markers only that are within their contact, and their numbers.

    Beside it, the face of the gel depends on where exactly the contact ends, and at its end the
    displacement changes within a marker. `margin` is the distance from there over the size. Presses
    with less than six markers are left out.

    Raises:
        ConfigError: no press has as many markers.
    """
    presses, numbers = list[Press](), list[int]()
    for number, (press, rim) in enumerate(zip(recording.presses, rims, strict=True)):
        reading = _reading(press)
        kept = rim.outside.query(reading.markers_mm)[0] > margin * rim.size_mm
        if kept.sum() >= _MIN_MARKERS:
            arrays = ("markers_mm", "displacement_mm", "deviations_mm")
            left = {name: getattr(reading, name)[kept] for name in arrays}
            presses.append(replace(press, gel=replace(reading, **left)))
            numbers.append(number)
    if not presses:
        raise ConfigError(f"no press has {_MIN_MARKERS} markers within its contact.")
    return replace(recording, presses=tuple(presses), check_units=False), numbers


def _reading(press: Press) -> GelReading:
    if press.gel is None:
        raise ConfigError(f"{press.label} has no gel; give presses of a sensor with markers.")
    return press.gel


def _group(presses: Sequence[Press]) -> list[tuple[int, ...]]:
    """Return the numbers of the presses of each contact."""
    groups: dict[bytes, list[int]] = {}
    for i, press in enumerate(presses):
        reading = _reading(press)
        arrays = reading.layer, reading.first_pose, press.fixed, press.springs
        groups.setdefault(b"".join(array.tobytes() for array in arrays), []).append(i)
    return [tuple(numbers) for numbers in groups.values()]


def _make_contact(
    recording: Recording,
    numbers: tuple[int, ...],
    youngs_mpa: float,
    cells: tuple[int, int],
    sizing: Sizing | None,
    surface: TetMesh | None,
    rtol: float,
) -> _Contact:
    first, mesh = recording.presses[numbers[0]], recording.mesh
    reading = _reading(first)
    supports = _supports(first)
    layer = GelLayer.of_numbers(reading.layer, recording.material.name)
    shorter = 2.0 * min(layer.half_size_mm)
    gel = GelMesh(layer, shorter / cells[0], cells[1])
    if sizing is not None:
        gel = gel.refined(sizing)
    facing = face_each_other(
        mesh, surface or mesh, gel, reading.first_pose, opening_mm=float(reading.opposed[0])
    )
    if facing is None:
        raise ConfigError(f"{first.label}: the gel is over no part of the object; check its pose.")
    motions = [_motion(recording.presses[i], facing) for i in numbers]
    depth = max(float(motion[2]) for motion in motions)
    if depth <= 0.0:
        raise ConfigError(f"{first.label}: the gel does not touch the object; check its pose.")
    coupled = Coupled(
        facing, mesh, gel, recording.material, supports, body_mpa=youngs_mpa, depth_mm=depth,
        rtol=rtol,
    )  # fmt: skip
    return _Contact(numbers, coupled, facing, gel, motions)


def _supports(press: Press) -> Supports:
    """Return the supports in any frame."""
    if press.prescribed.any():
        raise ConfigError(f"{press.label}: prescribed moves the supports; move the gel instead.")
    for name in ("fixed", "springs"):
        values = getattr(press, name)
        if (values != values[:, :1]).any():
            raise ConfigError(f"{press.label}: {name} differ along axes; give the same along all.")
    return Supports(fixed=press.fixed, springs=press.springs if press.springs.any() else None)


def _motion(press: Press, facing: Facing) -> Float[np.ndarray, "3"]:
    """Return the motion of the sensor from first touch, in its frame, mm."""
    reading = _reading(press)
    relative = np.linalg.inv(reading.first_pose) @ reading.pose
    turn = float(Rotation.from_matrix(relative[:3, :3]).magnitude())
    if turn > _MAX_TURN:
        raise ConfigError(
            f"{press.label}: the sensor turns by {np.rad2deg(turn):.1f} degrees after first "
            "contact; keep its orientation during a contact."
        )
    motion: Float[np.ndarray, 3] = relative[:3, 3].copy()
    motion[2] -= facing.first_touch[1]
    return motion


def _observation(press: Press) -> Observation:
    """Return the data of a press: of markers that part of their error which is its own."""
    reading, apart = _reading(press), (1.0 - _AT_REST) ** -0.5
    values = [reading.displacement_mm.ravel()]
    scales = [np.repeat(apart / reading.deviations_mm, 2)]
    if press.force is not None:
        values.append(press.force.values)
        scales.append(1.0 / press.force.deviations)
    none = np.zeros(0, dtype=np.int64)
    return Observation(none, np.concatenate(values), np.concatenate(scales), press.force)


def _make_readings(contact: _Contact, press: Press) -> _Readings:
    reading, axes = _reading(press), np.zeros((0, 3))
    if press.force is not None:
        if press.force.axes[:, 3:].any():
            raise ConfigError(f"{press.label}: moments on a gel are not known; give its force.")
        axes = press.force.axes[:, :3] @ reading.pose[:3, :3]
    turn = reading.first_pose[:3, :3]
    return _Readings(_marker_rows(contact, reading), axes, contact.coupled.opposed, turn)


def _marker_rows(contact: _Contact, reading: GelReading) -> sp.csr_matrix:
    """Return the map from displacements of all nodes (flat, mm) to those of the markers."""
    gel, parts = contact.gel, contact.coupled.parts
    if not len(reading.markers_mm):
        return sp.csr_matrix((0, 3 * parts.n_nodes))
    flat, queries = (
        np.pad(at[:, :2], ((0, 0), (0, 1))) for at in (gel.face_points, reading.markers_mm)
    )
    closest = closest_points(flat, gel.face_triangles, queries)
    triangles = gel.face[gel.face_triangles[closest.triangles]] + contact.coupled.n_body
    nodes, values = parts.surface_nodes(triangles), parts.surface_values(closest.barycentric)
    numbers: Int[np.ndarray, " r"] = np.repeat(np.arange(2 * len(nodes)), nodes.shape[1])
    columns = np.stack([3 * nodes, 3 * nodes + 1], axis=1).ravel()
    entries = np.repeat(values, 2, axis=0).ravel()
    return sp.csr_matrix((entries, (numbers, columns)), (2 * len(nodes), 3 * parts.n_nodes))
