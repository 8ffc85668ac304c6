"""Presses by a robot's driver as presses over the nodes of the mesh of the inversion."""

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from concurrent.futures import TimeoutError as FutureTimeoutError
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from jaxtyping import Bool

from tactorch.errors import RobotError, RobotTimeoutError
from tactorch.fem import SoftBody, Supports, make_material
from tactorch.fem.transfer import Transfer
from tactorch.inverse.search.draft_errors import Prediction
from tactorch.mesh import TetMesh
from tactorch.recording import MaterialSpec, Press
from tactorch.recording.refine import prolong_fixed
from tactorch.robot.contact import Seen, across, loads, refined_at_rim
from tactorch.robot.driver import PressCommand, PressReport, Robot
from tactorch.sampling import Patch
from tactorch.sampling.candidates import all_directions, planned_press

_MIN_NODES = 3  # observed, of a press that is used
_STEP = 0.1  # of the position in derivatives, over the radius


@dataclass(frozen=True, eq=False)
class RobotPresser:
    """Presser that commands a robot and turns its reports into presses.

    The pressure is uniform over the contact area at the reported pose, and its resultant is the
    measured force. Displacements are interpolated to the nodes within the measured points.

    Attributes:
        robot: Driver of the robot.
        mesh: Mesh of the inversion.
        held: Mask of its fixed nodes.
        material: Constitutive law of the object.
        pressure_mpa: Mean pressure that is commanded, MPa.
        noise_mm: Standard deviation of the displacements that is expected of a press, mm.
        timeout_seconds: Time after which a press is given up, s.
        seen: Reported pose and measured points of each press, by its name.
    """

    robot: Robot
    mesh: TetMesh
    held: Bool[np.ndarray, " n"]
    material: MaterialSpec
    pressure_mpa: float
    noise_mm: float
    timeout_seconds: float = 120.0
    seen: dict[str, Seen] = field(default_factory=dict)
    _calls: list[Any] = field(default_factory=list)

    def plan(self, patch: Patch) -> Press:
        """Return the press as it would be reported, with displacement 0."""
        plan = planned_press(patch, self.mesh, self.held, self.pressure_mpa, self.noise_mm)
        inside = patch.coordinates(self.mesh.points)[0] <= patch.radius_mm
        return replace(plan, observed=plan.observed & inside[:, None])

    def press(self, patch: Patch) -> Press:
        """Carry the press out.

        Raises:
            RobotError: the robot failed, or its report cannot be used.
            RobotTimeoutError: it took longer than `timeout_seconds`.
        """
        force = self.pressure_mpa * np.pi * patch.radius_mm**2
        command = PressCommand(patch.center, patch.inward, patch.radius_mm, force)
        report = self._call(command)
        if not isinstance(report, PressReport):
            raise RobotError(
                f"the robot's press returned {type(report).__name__}; return a PressReport."
            )
        report.check()
        return self._as_press(report, patch.radius_mm)

    def _call(self, command: PressCommand) -> Any:
        """Call the driver in a separate thread, so that one that hangs can be left."""
        if self._calls and not self._calls[-1].done():
            self._wait(self._calls[-1], "the press before it")
        executor = ThreadPoolExecutor(1, thread_name_prefix="robot")
        call = executor.submit(self.robot.press, command)
        executor.shutdown(wait=False)
        self._calls[:] = [call]
        return self._wait(call, "the press")

    def _wait(self, call: Any, what: str) -> Any:
        try:
            return call.result(timeout=self.timeout_seconds)
        except FutureTimeoutError as error:
            if call.done():  # the driver's own error
                raise RobotError(f"the robot failed: {error or type(error).__name__}") from error
            raise RobotTimeoutError(
                f"{what} did not end within {self.timeout_seconds:g} s; check the robot, or raise "
                "robot.timeout_seconds."
            ) from None
        except RobotError:
            raise
        except Exception as error:  # whatever code of another package raises
            raise RobotError(f"the robot failed: {type(error).__name__}: {error}") from error

    def _as_press(self, report: PressReport, radius_mm: float) -> Press:
        patch = Patch(
            np.asarray(report.center_mm, float), np.asarray(report.inward, float), radius_mm
        )
        seen = Seen.of(patch, np.asarray(report.points_mm, float), self.mesh)
        if len(seen.nodes) < _MIN_NODES:
            raise RobotError(
                f"only {len(seen.nodes)} nodes of the mesh are within the "
                f"{len(report.points_mm)} measured points; use a finer mesh, or report points over "
                "the whole contact area."
            )
        name = _press_name(report)
        self.seen[name] = seen
        observed = np.zeros(self.mesh.n_points, dtype=bool)
        observed[seen.nodes] = True
        weights = np.ones((self.mesh.n_points, 3))
        mean = float(np.sqrt(np.mean(seen.noise**2)))
        weights[seen.nodes] = (mean / seen.noise)[:, None]
        return Press(
            forces=loads(patch, self.mesh, np.asarray(report.force_n, float)),
            observed=all_directions(observed),
            displacement=seen.smoothed(np.asarray(report.displacements_mm), self.mesh),
            fixed=all_directions(self.held),
            noise_mm=mean * float(report.noise_mm),
            weights=weights,
            direction=patch.inward,
            name=name,
        )

    def fine_prediction(self, press: Press, youngs_mpa: float) -> Prediction | None:
        """Return predictions of a mesh that is fine at the rim of the contact, and of the mesh.

        See `tactorch.inverse.search.draft_errors.FinePrediction`. Displacements of the finer mesh
        are taken at the measured points and smoothed as the measured ones are. The reported
        position may be wrong across the push.
        """
        seen = self.seen.get(press.name)
        if seen is None:
            return None
        force = press.total_force
        better = self._fine(seen, force, youngs_mpa)
        per_mm = []
        middle = self.mesh.points.mean(axis=0) - seen.patch.center
        for axis in across(seen.patch.inward):
            step = _STEP * seen.patch.radius_mm * (axis if axis @ middle > 0 else -axis)
            moved = self._fine(seen.moved(step, self.mesh), force, youngs_mpa)
            per_mm.append((moved - better) / float(np.linalg.norm(step)))
        forces = loads(seen.patch, self.mesh, force)
        _, present = self._solve(self.mesh, all_directions(self.held), forces, youngs_mpa)
        return Prediction(better, present[: self.mesh.n_points], np.array(per_mm))

    def _fine(self, seen: Seen, force_n: np.ndarray, youngs_mpa: float) -> np.ndarray:
        """Return what would be seen at the nodes of a uniform body, by a finer mesh, mm."""
        refinement = refined_at_rim(self.mesh, seen.patch)
        fine, fixed = refinement.mesh, prolong_fixed(all_directions(self.held), refinement)
        body, moved = self._solve(fine, fixed, loads(seen.patch, fine, force_n), youngs_mpa)
        at_points = Transfer.between(body.discretisation, seen.points_mm)(moved)
        return seen.smoothed(at_points, self.mesh)

    def _solve(
        self, mesh: TetMesh, fixed: np.ndarray, forces: np.ndarray, youngs_mpa: float
    ) -> tuple[SoftBody, np.ndarray]:
        spec = self.material
        law = make_material(spec.name, spec.poisson, **spec.parameters)
        body, youngs = SoftBody(mesh, law, element="tet10"), np.full(mesh.n_tets, youngs_mpa)
        result = body.equilibrate(youngs, forces, Supports(fixed=fixed)).require()
        return body, result.displacement

    def plain(self) -> dict[str, Any]:
        """Return poses and points as plain values, from which `restore` continues."""
        return {name: seen.plain() for name, seen in self.seen.items()}

    def restore(self, plain: Mapping[str, Any]) -> None:
        """Take over the poses and points of presses of a continued run."""
        for name, values in plain.items():
            self.seen[name] = Seen.restored(values, self.mesh)


def _press_name(report: PressReport) -> str:
    center = ", ".join(f"{x:.4f}" for x in np.asarray(report.center_mm))
    stopped = f", stopped: {report.stopped}" if report.stopped else ""
    return f"robot at ({center}) mm{stopped}"
